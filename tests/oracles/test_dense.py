"""Tests of the dense oracle: Lagrange's equations of its energies, momentum, forces from their definitions."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings

import flexman_gym as fm

from oracles.chains import QUICK, random_payload, samples
from oracles.dense import Chain, payload_points


def spinning(sample):
    """Return the chain of a sample with spinning rotors."""
    chain = replace(sample).chain  # a copy: the sample keeps its own
    chain.spinning_rotors = True
    return chain


def slope(function, step):
    """Return the derivative of a function at 0: central differences with Richardson extrapolation, error O(step^4)."""
    differences = [(function(h) - function(-h)) / (2 * h) for h in (step, 2 * step)]
    return (4 * differences[0] - differences[1]) / 3


@pytest.mark.slow
@settings(QUICK)
@given(samples(most_links=4, stiffening=None))
def test_accelerations_are_those_of_lagranges_equations(sample):
    """In one random direction u: u . (d/dt dT/dv - dT/dx + dV/dx) = u . (motors, springs and dampers)."""
    (x, v), torque, chain = sample.state(), sample.torque(), spinning(sample)
    mass = chain.mass_matrix(x)
    scale = np.sqrt(np.diag(mass))
    u = np.random.default_rng(sample.seed).uniform(-1.0, 1.0, len(x)) / scale
    u *= np.abs(v).max() / np.abs(u).max()

    def momentum(place, rates):  # u . dT/dv, exactly, as T is quadratic in v
        return (chain.energy(place, rates + u)[0] - chain.energy(place, rates - u)[0]) / 2

    def lagrangian(place):
        kinetic, _, gravitational = chain.energy(place, v)
        return kinetic - gravitational

    acceleration = chain.acceleration(x, v, torque)
    step = 1e-3 / np.abs(v).max()
    forces = slope(lambda t: momentum(x + t * v, v), step) - slope(lambda t: lagrangian(x + t * u), step)
    result = u @ (sample.applied(x, v, torque) - mass @ acceleration)
    masses, positions, _ = chain.points(x, v)
    energy = sum(chain.energy(x, rates)[0] for rates in (v, u)) + np.abs(masses) @ np.abs(positions @ chain.gravity)
    rounding = 1e-13 * np.abs(scale * u).sum() * np.abs(scale * acceleration).max()
    assert abs(forces - result) <= 1e-7 * energy * np.abs(v).max() + rounding
    assert momentum(x, v) == pytest.approx(u @ mass @ v, abs=1e-11 * energy)


@pytest.mark.slow
@settings(QUICK)
@given(samples(flexible_links=False))
def test_the_first_motor_alone_gives_momentum_about_its_axis(sample):
    sample = replace(sample, arm=replace(sample.arm, gravity=(0.0, 0.0, 0.0)))
    (x, v), torque, chain = sample.state(), sample.torque(), spinning(sample)
    a, axis = chain.acceleration(x, v, torque), chain.axes[0]
    fastest = np.abs(v).max() + np.sqrt(np.abs(a).max())
    result = slope(lambda t: axis @ chain.angular_momentum(x + t * v + t**2 / 2 * a, v + t * a), 1e-3 / fastest)
    size = np.trace(chain.mass_matrix(x)) * fastest**2
    assert result == pytest.approx(torque[0], abs=1e-7 * size)


def test_a_spinning_rotor_is_turned_by_joints_along_its_axis_only():
    joints = [fm.Joint((0.0, 0.0, 1.0), 0.2), fm.Joint((1.0, 0.0, 0.0), 0.3, 50.0), fm.Joint((0.0, 0.0, 1.0), 0.5)]
    arm = fm.Arm(fm.catalog.paper_rrr().links, joints)
    plain, chain = (Chain(arm, flexible_links=False, spinning_rotors=on) for on in (False, True))
    extra = chain.mass_matrix(np.zeros(4)) - plain.mass_matrix(np.zeros(4))
    expected = np.zeros((4, 4))
    expected[0, 0] = expected[0, 2] = expected[2, 0] = 0.5  # the third along the first, the second across it
    assert extra == pytest.approx(expected, abs=1e-12)


@pytest.mark.slow
@settings(QUICK)
@given(samples(most_links=4, stiffening=None))
def test_forces_on_tip_and_base_do_their_power(sample):
    sample = replace(sample, amplitude=min(sample.amplitude, 0.05))  # so that elastic forces do not drown the others
    (x, v), torque, chain = sample.state(), sample.torque(), spinning(sample)
    push, shake = np.random.default_rng(sample.seed).uniform(-30.0, 30.0, (2, 3))
    rest, mass = chain.acceleration(x, v, torque), chain.mass_matrix(x)
    masses, _, velocities = chain.points(x, v)
    noise = 1e-13 * np.abs(v) @ np.abs(mass) @ np.abs(rest)
    pushed = v @ mass @ (chain.acceleration(x, v, torque, tip_force=push) - rest)
    assert pushed == pytest.approx(push @ chain.tip_velocity(x, v), rel=1e-9, abs=noise)
    shaken = v @ mass @ (chain.acceleration(x, v, torque, base_acceleration=shake) - rest)
    assert shaken == pytest.approx(-masses @ velocities @ shake, rel=1e-9, abs=noise)


@pytest.mark.slow
@settings(QUICK)
@given(samples(most_links=4))
def test_prescribed_motors_take_the_torque_that_moves_them_so(sample):
    (x, v), torque, chain = sample.state(), sample.torque(), sample.chain
    motors = sample.model.motor_columns
    free = chain.acceleration(x, v, torque)
    held = {i: free[motors[i]] for i in range(0, chain.n, 2)}
    unknown = np.where(np.isin(np.arange(chain.n), list(held)), np.nan, torque)
    result, needed = chain.driven(x, v, unknown, held)
    scale = np.sqrt(np.diag(chain.mass_matrix(x)))
    size = np.abs(chain.mass_matrix(x) * free).sum(axis=1)[motors] + np.abs(sample.applied(x, v, torque))[motors]
    assert np.abs(scale * (result - free)).max() <= 1e-7 * np.abs(scale * free).max()
    assert (np.abs(needed - torque) <= 1e-7 * (size + np.abs(torque))).all()


def test_friction_acts_on_the_motor():
    arm = fm.catalog.planar_2r(joint_stiffness=80.0)
    arm = replace(arm, joints=[replace(joint) for joint in arm.joints])  # its two joints are one object
    x, v, torque = np.zeros(4), np.array([0.3, -0.2, 0.5, -0.04]), np.zeros(2)
    chain = Chain(arm, flexible_links=False)
    before = chain.acceleration(x, v, torque)
    for name, value in (("viscous_friction", 2.0), ("coulomb_friction", 3.0), ("coulomb_rate", 0.05)):
        object.__setattr__(arm.joints[1], name, value)
    force = chain.mass_matrix(x) @ (chain.acceleration(x, v, torque) - before)
    assert force == pytest.approx([0.0, 0.0, 0.0, 0.08 + 3.0 * np.tanh(0.8)], abs=1e-12)


@pytest.mark.parametrize("seed", range(5))
def test_the_points_of_a_payload_have_its_inertia(seed):
    payload = random_payload(np.random.default_rng(seed), True, True)
    points = payload_points(payload)
    arms = points.r0 - payload.offset
    inertia = np.einsum("p,pi,pi->", points.masses, arms, arms) * np.eye(3) - arms.T * points.masses @ arms
    assert points.masses.sum() == pytest.approx(payload.mass)
    assert points.masses @ arms == pytest.approx(np.zeros(3), abs=1e-14)
    assert inertia == pytest.approx(np.array(payload.inertia), abs=1e-14)

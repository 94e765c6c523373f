"""Lumped masses on a link against a payload at its tip and a short heavy section."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

import flexman_gym as fm
from flexman_gym.model.dynamics import inertial_forces
from flexman_gym.scene.serialization import find_arm, to_plain

from oracles.assertions import refusal
from oracles.chains import QUICK, random_link

INERTIA = ((3e-3, 2e-4, -1e-4), (2e-4, 2e-3, 1e-4), (-1e-4, 1e-4, 4e-3))
STRIP = fm.Link.strip(0.5, 0.04, 0.003)
HUB = fm.Joint((0.0, 0.0, 1.0), rotor_inertia=0.01)
GRAVITY = (1.0, -2.0, -9.0)


def tip_loaded(link, joints, mass, inertia=None, offset=None, **switches):
    """Models of a chain with a body on its last tip, as a lumped mass and as a payload."""
    turn = np.array(link.orientation)  # the payload lies in the frame of a next joint
    if inertia is not None:
        own = turn.T @ inertia @ turn
        own = (own + own.T) / 2.0
    lump = fm.LumpedMass(
        mass, link.length, None if inertia is None else own, None if offset is None else turn.T @ offset
    )
    links = [link] * (len(joints) - 1)
    arms = (
        fm.Arm([*links, replace(link, masses=[lump])], joints, gravity=GRAVITY),
        fm.Arm([*links, link], joints, fm.Payload(mass, inertia, offset), gravity=GRAVITY),
    )
    return [fm.build_model(arm, **switches) for arm in arms]


@settings(QUICK, max_examples=15)
@given(st.integers(0, 10**6), st.booleans(), st.booleans())
def test_a_point_mass_at_the_tip_is_a_payload_at_any_state(seed, stiffening, rotary):
    rng = np.random.default_rng(seed)
    joints = [replace(HUB, axis=Rotation.random(random_state=rng).as_matrix()[0]) for _ in range(2)]
    lumped, loaded = tip_loaded(
        random_link(rng), joints, rng.uniform(0.1, 5.0), stiffening=stiffening, rotary_inertia=rotary
    )
    x, v, rates = rng.uniform(-1.0, 1.0, (3, lumped.n_dof))
    x[2:], v[2:], rates[2:] = 0.05 * x[2:], 0.1 * v[2:], 0.1 * rates[2:]
    mine, theirs = (inertial_forces(model)(x, v, rates) for model in (lumped, loaded))
    np.testing.assert_allclose(mine, theirs, rtol=1e-9, atol=1e-10 * np.abs(theirs).max())


@settings(QUICK, max_examples=15)
@given(st.integers(0, 10**6))
def test_a_body_at_the_tip_of_straight_links_is_a_payload(seed):
    rng = np.random.default_rng(seed)
    joints = [replace(HUB, axis=Rotation.random(random_state=rng).as_matrix()[0]) for _ in range(2)]
    lumped, loaded = tip_loaded(random_link(rng), joints, 0.7, np.array(INERTIA), rng.uniform(-0.1, 0.1, 3))
    x, v, rates = rng.uniform(-1.0, 1.0, (3, lumped.n_dof))
    x[2:] = v[2:] = 0.0
    mine, theirs = (inertial_forces(model)(x, v, rates) for model in (lumped, loaded))
    np.testing.assert_allclose(mine, theirs, rtol=1e-9, atol=1e-10 * np.abs(theirs).max())


@pytest.mark.parametrize(("plane", "aside"), [((2, 4), (0.02, 0.05, 0.0)), ((1, 5), (-0.03, 0.0, 0.04))])
@pytest.mark.parametrize("stiffening", [False, True])
def test_a_body_beside_a_link_that_bends_in_a_plane_is_a_payload(plane, aside, stiffening):
    """A rotation about an axis preserves an offset along it, so both are exact, except for transverse moments."""
    rng, axis = np.random.default_rng(3), Rotation.random(random_state=5).as_matrix()[0]
    offset = (0.0, *aside[1:])
    lumped, loaded = tip_loaded(STRIP, [replace(HUB, axis=axis)], 0.4, offset=np.array(offset), stiffening=stiffening)
    moves = 1 + np.array([node + 6 * i for i in range(2) for node in plane])
    x, v, rates = np.zeros((3, lumped.n_dof))
    for vector in (x, v, rates):
        vector[0], vector[moves] = rng.uniform(-1.0, 1.0), 0.1 * rng.uniform(-1.0, 1.0, len(moves))
    mine, theirs = (inertial_forces(model)(x, v, rates) for model in (lumped, loaded))
    same = np.setdiff1d(np.arange(lumped.n_dof), 1 + 6 + np.setdiff1d([3, 4, 5], plane))
    np.testing.assert_allclose(mine[same], theirs[same], rtol=1e-9, atol=1e-11)


def test_a_lumped_mass_is_the_limit_of_a_short_heavy_section():
    """Bending converges with the square of the width; twist, whose slope jumps at the mass, with the width."""
    mass, at, whole = 0.3, 0.2, replace(STRIP, outline=None)
    about_y, about_z = whole.second_moment_y, whole.second_moment_z
    lump = fm.LumpedMass(mass, at, mass / whole.area * np.diag([about_y + about_z, about_y, about_z]))
    pieces = fm.NonUniformLink([replace(whole, length=at), replace(whole, length=0.5 - at)], masses=[lump])
    expected, errors = fm.frequencies(fm.build_model(fm.Arm([pieces], [HUB]), 4))[1:6], []
    for width in (0.02, 0.005):
        heavy = replace(whole, length=width, density=whole.density + mass / (whole.area * width))
        ends = [replace(whole, length=part - width / 2) for part in (at, 0.5 - at)]
        stepped = fm.Arm([fm.NonUniformLink([ends[0], heavy, ends[1]])], [HUB])
        errors.append(np.abs(fm.frequencies(fm.build_model(stepped, 4))[1:6] / expected - 1.0))
    bending, twist = [0, 1, 2, 4], [3]
    assert (errors[1][bending] < errors[0][bending] / 12.0).all() and (errors[1][bending] < 4e-4).all()
    assert errors[1][twist] < errors[0][twist] / 3.5 and errors[1][twist] < 1.1e-3


def test_a_rigid_link_with_bodies_is_a_pendulum():
    """I = m L^2 / 3 of the line, m (x^2 + y^2) and I_zz of each body; its torque balances their weights."""
    bodies = [fm.LumpedMass(0.5, 0.1, INERTIA, (0.01, 0.03, 0.2)), fm.LumpedMass(0.2, 0.5)]
    link = replace(STRIP, masses=bodies)
    arm = fm.Arm([link], [replace(HUB, rotor_inertia=0.0)], gravity=(0.0, -9.81, 0.0))
    model = fm.build_model(arm, flexible_links=False)
    beam = STRIP.mass * (0.5**2 / 3 + 0.003**2 / 12)
    inertia = beam + 0.5 * (0.11**2 + 0.03**2) + INERTIA[2][2] + 0.2 * 0.5**2
    assert fm.mass_matrix(model, model.initial_state([0.3]))[0, 0] == pytest.approx(inertia, rel=1e-12)
    assert fm.holding_torques(model, [0.0])[0] == pytest.approx(9.81 * (STRIP.mass / 4 + 0.5 * 0.11 + 0.2 * 0.5))
    assert link.mass == pytest.approx(STRIP.mass + 0.7)
    assert fm.NonUniformLink([STRIP], masses=bodies).mass == pytest.approx(link.mass)


@pytest.mark.parametrize("stiffening", [False, True])
def test_bodies_keep_energy_and_angular_momentum(stiffening):
    """Without gravity and torques, the energy and the angular momentum about the axis of the hub are constant."""
    bodies = [fm.LumpedMass(0.2, 0.21, INERTIA, (0.01, 0.04, -0.03)), fm.LumpedMass(0.1, 0.5, None, (0.0, -0.02, 0.05))]
    second = replace(fm.Link.strip(0.4, 0.02, 0.004, "z"), masses=[replace(bodies[1], position=0.3)])
    links = [replace(STRIP, masses=bodies), second]
    arm = fm.Arm(links, [HUB, fm.Joint((0.0, 1.0, 0.0), stiffness=30.0, rotor_inertia=0.01)])
    model = fm.build_model(arm, elements=1, stiffening=stiffening)
    scene = fm.Scene(arm, fm.ModelChoice(True, 1, stiffening=stiffening), fm.ConstantTorque([0.0, 0.0]),
                     fm.Initial([0.0, 0.4], [6.0, -2.0]), 0.2, 0.05)  # fmt: skip
    run = fm.simulate(scene, model=model, rtol=1e-9, atol=1e-11)
    assert np.abs(run.energy / run.energy[0] - 1.0).max() < 1e-7
    momentum = [(fm.mass_matrix(model, state) @ state[model.n_dof :])[0] for state in run.states]
    assert np.ptp(momentum) < 1e-7 * momentum[0]
    assert np.abs(run.states[:, 3 : model.n_dof]).max() > 1e-3  # it bends


def test_arms_abreast_have_the_bits_of_one():
    lump = fm.LumpedMass(0.2, 0.3, INERTIA, (0.0, 0.04, 0.0))
    arm = fm.Arm([replace(STRIP, masses=[lump])], [HUB], gravity=GRAVITY)
    choice = fm.ModelChoice(True, 2, stiffening=True)
    scenes = [
        fm.Scene(arm, choice, fm.ConstantTorque([torque]), fm.Initial([0.1], [0.2]), 0.1, 0.02)
        for torque in (0.05, -0.05, 0.1)
    ]
    together = fm.simulate_all(scenes, method="midpoint_3", step=0.005)
    for scene, run in zip(scenes, together, strict=True):
        alone = fm.simulate(scene, method="midpoint_3", step=0.005)
        assert (alone.states == run.states).all() and alone.status == "ok"


def test_lumped_masses_come_back_from_a_mapping():
    bodies = [fm.LumpedMass(0.5, 0.1, INERTIA, (0.01, 0.03, 0.2)), fm.LumpedMass(0.2, 0.5)]
    stepped = fm.NonUniformLink([STRIP, replace(STRIP, outline=None)], masses=bodies)
    arm = fm.Arm([replace(STRIP, masses=bodies), stepped], [HUB, HUB])
    data = to_plain(arm)
    assert find_arm(data) == arm and data["links"][0]["masses"][1] == {"mass": 0.2, "position": 0.5}
    data["links"][1]["masses"][0]["position"] = 1.2
    line = refusal(lambda: find_arm(data))
    assert line.startswith("arm.links[1].masses[0].position: 1.2 is not allowed; give at most")

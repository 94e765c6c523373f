"""Inverse dynamics and tip acceleration: consistency with the forward dynamics, and closed forms."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import assume, given, settings

import flexman_gym as fm

from oracles.chains import QUICK, samples


def undamped(sample):
    """The same chain without dampers in its joints."""
    joints = [replace(joint, damping=0.0) for joint in sample.arm.joints]
    return replace(sample, arm=replace(sample.arm, joints=joints))


def link_motion(model, state, torque):
    """Angles, rates, accelerations, jerks and snaps (5, n) of the joints under constant torques."""
    n, d = model.n_joints, model.n_dof
    rates = np.r_[state[d:], fm.acceleration(model, state, torque)]

    def along(t, bend):
        return fm.acceleration(model, state + t * rates + t**2 / 2 * bend, torque)

    h = 0.01 / np.abs(rates).max() ** 0.5
    parts = ((1, 1.5), (2, -0.6), (3, 0.1))  # central differences of order six
    jerks = sum(w * (along(k * h, 0.0) - along(-k * h, 0.0)) / (2 * k * h) for k, w in parts)
    bend = np.r_[rates[d:], jerks]
    middle = along(0.0, 0.0)
    snaps = sum(w * (along(k * h, bend) - 2 * middle + along(-k * h, bend)) / (k * h) ** 2 for k, w in parts)
    return np.array([state[:n], state[d : d + n], rates[d : d + n], jerks[:n], snaps[:n]])


@pytest.mark.slow
@settings(QUICK, max_examples=40)
@given(samples(flexible_links=False, flexible_joints=False))
def test_rigid_forward_and_inverse_dynamics_undo_each_other(sample):
    (x, v), torque = sample.state(), sample.torque()
    rates = fm.acceleration(sample.model, np.r_[x, v], torque)
    result = fm.inverse_dynamics(sample.model, x, v, rates)
    size = np.abs(fm.mass_matrix(sample.model, np.r_[x, v]) * rates).max()
    assert np.abs(result - torque).max() <= 1e-11 * max(size, np.abs(torque).max())


@pytest.mark.slow
@settings(QUICK, max_examples=40)
@given(samples(flexible_links=False, flexible_joints=None))
def test_with_springs_forward_and_inverse_dynamics_undo_each_other(sample):
    sample = undamped(sample)
    (x, v), torque, model = sample.state(), sample.torque(), sample.model
    assume(model.n_motors > 0)
    motion = link_motion(model, np.r_[x, v], torque)
    result = fm.inverse_dynamics(model, *motion)
    springs = [joint.rotor_inertia / joint.stiffness for joint in sample.arm.joints if joint.stiffness is not None]
    size = np.abs(fm.mass_matrix(model, np.r_[x, v])[: model.n_joints, : model.n_joints]).max()
    size *= np.abs(motion[2]).max() + max(springs) * np.abs(motion[4]).max()
    assert np.abs(result - torque).max() <= 1e-7 * max(size, np.abs(torque).max())


def test_one_elastic_joint_has_its_closed_form():
    """Spong: torque = (J + I) theta'' + J I / K theta'''' for a link of inertia I without gravity."""
    arm = fm.catalog.one_link(rotor_inertia=0.4, joint_stiffness=90.0)
    model, link = fm.build_model(arm, flexible_links=False), arm.links[0]
    inertia = link.mass * link.length**2 / 3 + link.density * link.length * link.second_moment_z
    result = fm.inverse_dynamics(model, [0.3], [-2.0], [5.0], [-30.0], [700.0])
    expected = (0.4 + inertia) * 5.0 + 0.4 * inertia / 90.0 * 700.0
    assert result == pytest.approx([expected], rel=1e-9)


def test_friction_of_the_motors_is_added_to_what_the_links_ask_for():
    """At any rate; Coulomb friction depends on little more than its sign."""
    smooth, rates = fm.catalog.paper_rrr(joint_stiffness=None), np.array([1.5, -0.004, 0.3])
    numbers = {"viscous_friction": (3.0, 5.0, 7.0), "coulomb_friction": (20.0, 40.0, 60.0), "coulomb_rate": (0.01,) * 3}
    rough = [replace(joint, **dict(zip(numbers, each, strict=True)))
             for joint, each in zip(smooth.joints, zip(*numbers.values(), strict=True), strict=True)]  # fmt: skip
    result, without = (
        fm.inverse_dynamics(fm.build_model(arm, flexible_links=False), [0.3, -0.4, 0.5], rates, [2.0, -3.0, 4.0])
        for arm in (replace(smooth, joints=rough), smooth)
    )
    viscous, coulomb, width = (np.array(each) for each in numbers.values())
    assert result - without == pytest.approx(viscous * rates + coulomb * np.tanh(rates / width), rel=1e-9)


def test_a_motor_at_rest_carries_the_weight():
    gravity = 9.81
    for stiffness in (None, 50.0):
        arm = fm.catalog.one_link((0.0, -1.0, 0.0), 0.1, stiffness, gravity=(0.0, 0.0, -gravity))
        model = fm.build_model(arm, flexible_links=False)
        weight = arm.links[0].mass * gravity * arm.links[0].length / 2 * np.cos(0.4)
        assert fm.inverse_dynamics(model, [0.4], [0.0], [0.0], [0.0], [0.0]) == pytest.approx([weight], rel=1e-12)


def test_stiff_joints_approach_rigid_ones_as_one_over_stiffness():
    motion = np.random.default_rng(3).uniform(-1.0, 1.0, (5, 3))
    build = lambda stiffness: fm.build_model(  # noqa: E731
        fm.catalog.paper_rrr(joint_stiffness=stiffness, gravity=(0.0, 0.0, -9.81)), flexible_links=False
    )
    rigid = fm.inverse_dynamics(build(None), *motion)
    gaps = [np.abs(fm.inverse_dynamics(build(stiffness), *motion) - rigid).max() for stiffness in (1e5, 1e6, 1e7)]
    assert np.divide(gaps[:-1], gaps[1:]) == pytest.approx([10.0, 10.0], rel=1e-4)
    assert gaps[-1] < 1e-3 * np.abs(rigid).max()


# Tip acceleration


@pytest.mark.slow
@settings(QUICK, max_examples=40)
@given(samples())
def test_tip_acceleration_is_the_bend_of_the_tips_path(sample):
    """Along x + v t + a t^2 / 2, in the dense oracle's positions."""
    (x, v), torque, model = sample.state(), sample.torque(), sample.model
    rates = fm.acceleration(model, np.r_[x, v], torque)
    jacobian = fm.linearize(model, state=np.r_[x, v]).C[:, : model.n_dof]
    size = np.abs(jacobian * rates).max() + np.abs(jacobian).max() * np.abs(v).max() ** 2
    quickest = max(np.abs(jacobian * v).max(), np.abs(v).max(), np.sqrt(size))
    result, h = fm.tip_acceleration(model, np.r_[x, v], torque), 0.02 / quickest
    middle = 2 * sample.chain.tip(x)

    def bend(step):
        ends = [sample.chain.tip(x + t * v + t**2 / 2 * rates) for t in (step, -step)]
        return (ends[0] - middle + ends[1]) / step**2

    expected = 1.5 * bend(h) - 0.6 * bend(2 * h) + 0.1 * bend(3 * h)
    assert np.abs(result - expected).max() <= 1e-7 * quickest**2


def test_tip_acceleration_is_the_second_difference_of_a_simulated_tip():
    arm = fm.catalog.paper_rrr(gravity=(0.0, 0.0, -9.81), payload=fm.Payload(2.0))
    h, torque = 1e-4, np.array([400.0, 300.0, -200.0])
    for stiffening in (False, True):
        model = fm.build_model(arm, modes=4, stiffening=stiffening)
        simulator = fm.Simulator(model, "dop853", step=None, control_period=h, rtol=1e-13, atol=1e-15)
        simulator.reset((0.2, 0.4, -0.6), (1.0, -0.5, 2.0))
        for _ in range(100):
            simulator.step(torque)
        tips, states = [], []
        for _ in range(5):
            tips.append(simulator.tip.copy())
            states.append(simulator.state.copy())
            assert simulator.step(torque) == "ok"
        expected = np.array([-1.0, 16.0, -30.0, 16.0, -1.0]) / (12 * h**2) @ tips
        result = fm.tip_acceleration(model, states[2], torque)
        assert np.abs(result - expected).max() < 1e-5 * np.abs(expected).max()


def test_a_turning_link_pulls_its_tip_inward():
    model = fm.build_model(fm.catalog.one_link(), flexible_links=False)
    rate, torque, angle = 3.0, 0.7, 0.4
    outward, forward = np.array([np.cos(angle), np.sin(angle), 0.0]), np.array([-np.sin(angle), np.cos(angle), 0.0])
    state = model.initial_state([angle], [rate])
    turning = torque / fm.mass_matrix(model, state)[0, 0]
    expected = 2.0 * (turning * forward - rate**2 * outward)
    assert fm.tip_acceleration(model, state, [torque]) == pytest.approx(expected, rel=1e-13)

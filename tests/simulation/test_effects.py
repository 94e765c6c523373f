"""Effects: spinning rotors, friction, forces on the tip, a moving base and driven joints against the dense oracle."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import flexman_gym as fm
from flexman_gym.kernels import dynamics, inverse, layout, outputs

from oracles.chains import QUICK, affected

PRECISION = 1e-12  # of the forces of a difference, where each acceleration is weighed by its mass


def gap(case, x, actual, expected):
    """Force of a difference of accelerations over the largest inertial force, both weighed by masses."""
    mass = case.chain.mass_matrix(x)
    scale = np.sqrt(np.diag(mass))
    return np.abs(mass @ (actual - expected) / scale).max() / max(np.abs(scale * expected).max(), 1e-9)


@pytest.mark.slow
@pytest.mark.parametrize("rotating", [False, True])
@settings(QUICK, max_examples=50)
@given(data=st.data())
def test_the_recursion_equals_the_dense_equations_with_every_effect(rotating, data):
    case = data.draw(affected(rotating=rotating))
    (x, v), work = case.sample.state(), layout.make_work(case.constants)
    expected, torques = case.expected(x, v)
    actual = np.zeros(case.model.n_dof)
    dynamics.accelerations(case.constants, work, x, v, case.drive(), actual)
    mass = case.chain.mass_matrix(x)
    free = np.ones(len(x), dtype=bool)
    free[case.model.motor_columns[list(case.held)]] = False
    scale = np.sqrt(np.diag(mass))
    weighed = (mass / np.outer(scale, scale))[np.ix_(free, free)]
    condition = np.linalg.cond(weighed) if free.any() else 1.0
    assert gap(case, x, actual, expected) <= max(PRECISION, np.finfo(float).eps * condition)
    largest = np.abs(scale * expected).max()
    np.testing.assert_allclose(
        scale * actual, scale * expected, rtol=0.0, atol=max(1e-9, 10 * np.finfo(float).eps * condition) * largest
    )
    for joint in case.held:
        result, size = work.motor_torque[joint], np.abs(mass @ actual).max() + np.abs(torques).max()
        assert abs(result - torques[joint]) <= max(1e-9, 10 * np.finfo(float).eps * condition) * size


@pytest.mark.slow
@settings(QUICK, max_examples=20)
@given(affected())
def test_the_ledger_balances_with_every_effect(case):
    """Work of motors, tip force and base less what dampers and friction take is the change of energy."""
    duration = min(0.1, 30.0 / max(fm.frequencies(case.model).max(), 1.0))  # some periods of the fastest mode
    simulator = fm.Simulator(case.model, "dop853", None, duration, rtol=1e-11, atol=1e-12, prescribed=case.held)
    simulator.reset(state=np.concatenate(case.sample.state()))
    n, drive = case.model.n_joints, case.drive()
    held = np.isin(np.arange(n), case.held)
    torque, acceleration = np.where(held, 0.0, drive[:n]), np.where(held, drive[:n], 0.0)
    assert simulator.step(torque, acceleration, drive[n : n + 3], drive[n + 3 :]) == "ok"
    assert abs(simulator.energy_residual) <= 1e-8 * simulator.energy_turnover


@pytest.mark.slow
@settings(QUICK)
@given(affected(held=False))
def test_kinetic_energy_and_inverse_dynamics_know_the_spinning_rotors(case):
    (x, v), d = case.sample.state(), case.model.n_dof
    mass = fm.mass_matrix(case.model, np.r_[x, v])
    np.testing.assert_allclose(mass, case.chain.mass_matrix(x), rtol=0.0, atol=1e-9 * np.abs(mass).max())
    row, work = np.zeros(layout.OUTPUTS), layout.make_work(case.constants)
    outputs.compute_outputs(case.constants, work, x, v, row)
    assert np.isclose(row[layout.KINETIC], v @ mass @ v / 2, rtol=1e-9)
    torque, demanded = case.sample.torque(), np.zeros(d)
    acceleration = fm.acceleration(case.model, np.r_[x, v], torque)
    inverse.inertial_forces(case.constants, work, x, v, acceleration, demanded)
    applied = replace(case.sample, arm=case.arm).applied(x, v, torque)
    motors = case.model.motor_columns
    for i, joint in enumerate(case.arm.joints):
        friction = joint.coulomb_friction * np.tanh(v[motors[i]] / joint.coulomb_rate)
        friction *= 1.0 + joint.static_excess / (1.0 + (v[motors[i]] / joint.stribeck_rate) ** 2)
        applied[motors[i]] -= joint.viscous_friction * v[motors[i]] + friction
    scale = np.sqrt(np.diag(mass))
    assert np.abs((demanded - applied) / scale).max() <= 1e-9 * np.abs(scale * acceleration).max()


@pytest.mark.slow
def test_angular_momentum_with_spinning_rotors_is_the_torque_times_time():
    """About the vertical first axis every rotor now takes part: the momentum of all coordinates is 400 t."""
    scene = replace(fm.catalog.paper_scene("ff"), duration=1.0)
    model = fm.build_model(scene.arm, spinning_rotors=True)
    result = fm.simulate(scene, model, rtol=1e-9, atol=1e-11)
    for time, state in zip(result.time[::20], result.states[::20], strict=True):
        rates = state[model.n_dof :]
        mass = fm.mass_matrix(model, state)
        momentum = (mass[0] + mass[model.motor_columns[0]]) @ rates
        assert abs(momentum - 400.0 * time) < 1e-7


INERTIA = 2.5  # kg m^2, of the rotor; the link below has next to none
LINK = fm.Link(0.1, 1e-6, 1e-13, 1e-13, 1e-13, 7e10, 2.6e10, 1000.0)
RATE = 3.0


def coast(joint, method="dop853", step=None):
    """A rigid link on a joint, left to itself at 3 rad/s for 2 s."""
    arm = fm.Arm([LINK], [joint])
    choice = fm.ModelChoice(False, 1, flexible_joints=False)
    scene = fm.Scene(arm, choice, fm.ConstantTorque([0.0]), fm.Initial([0.0], [RATE]), 2.0, 0.02)
    return fm.simulate(scene, method=method, step=step, rtol=1e-9, atol=1e-11)


@settings(deadline=None, max_examples=15, derandomize=True)
@given(st.just(0.0) | st.floats(1e-6, 5.0))
def test_viscous_friction_slows_a_rotor_down_exponentially(friction):
    result = coast(fm.Joint((0.0, 0.0, 1.0), INERTIA, viscous_friction=friction))
    expected = RATE * np.exp(-friction / INERTIA * result.time)
    np.testing.assert_allclose(result.states[:, 1], expected, rtol=1e-6)


@settings(deadline=None, max_examples=15, derandomize=True)
@given(st.floats(0.1, 10.0), st.floats(0.02, 1.0))
def test_coulomb_friction_slows_a_rotor_down_as_the_hyperbolic_sine(friction, rate):
    result = coast(fm.Joint((0.0, 0.0, 1.0), INERTIA, coulomb_friction=friction, coulomb_rate=rate))
    start, passed = RATE / rate, friction / (INERTIA * rate) * result.time  # sinh(r / rate) decays exponentially
    expected = np.arcsinh(np.exp(-passed) * np.sinh(start))
    np.testing.assert_allclose(result.states[:, 1], rate * expected, atol=1e-6)
    np.testing.assert_allclose(result.dissipation, result.energy[0] - result.energy, atol=1e-6)


def test_a_linearly_implicit_step_is_stable_where_friction_is_steep():
    joint = fm.Joint((0.0, 0.0, 1.0), INERTIA, coulomb_friction=50.0, coulomb_rate=1e-3)
    result = coast(joint, "ros2", 0.02)  # the steepest slope of friction times the step is 400 times the inertia
    assert result.status == "ok"
    braking = 50.0 * 0.02 / INERTIA  # in one step
    assert np.abs(result.states[len(result.time) // 2 :, 1]).max() < braking / 5.0
    assert result.states[-1, 0] == pytest.approx(coast(joint).states[-1, 0], rel=0.05)


@pytest.mark.parametrize("flexible_joints", [True, False])
def test_the_slope_of_friction_is_in_the_linear_model(flexible_joints):
    arm = fm.catalog.paper_rrr()
    joints = [replace(joint, viscous_friction=4.0, coulomb_friction=9.0, coulomb_rate=0.5) for joint in arm.joints]
    model = fm.build_model(replace(arm, joints=joints), modes=3, flexible_joints=flexible_joints)
    state = model.initial_state([0.1, -0.3, 0.6], [0.2, -0.5, 0.4])
    slopes = fm.linearize(model, state=state, friction="at rest").A[model.n_dof :]
    for column in model.n_dof + model.motor_columns:
        shift = 1e-6 * np.eye(len(state))[column]
        ahead, behind = (fm.acceleration(model, state + sign * shift, [0.0] * 3) for sign in (1.0, -1.0))
        expected = (ahead - behind) / 2e-6
        np.testing.assert_allclose(slopes[:, column], expected, atol=1e-6 * np.abs(expected).max())


def test_inverse_dynamics_adds_what_friction_takes():
    arm = fm.catalog.paper_rrr(joint_stiffness=None)
    joints = [replace(joint, viscous_friction=4.0, coulomb_friction=9.0) for joint in arm.joints]
    model = fm.build_model(replace(arm, joints=joints), flexible_links=False)
    angles, rates, wanted = [0.1, -0.3, 0.6], [0.5, -0.01, 0.0], [1.0, -2.0, 3.0]
    torque = fm.inverse_dynamics(model, angles, rates, wanted)
    result = fm.acceleration(model, model.initial_state(angles, rates), torque)
    np.testing.assert_allclose(result, wanted, atol=1e-9)


def test_inverse_dynamics_of_flexible_joints_refuses_friction_by_name():
    arm = fm.catalog.paper_rrr()
    joints = [replace(joint, coulomb_friction=9.0) for joint in arm.joints]
    model = fm.build_model(replace(arm, joints=joints), flexible_links=False)
    with pytest.raises(ValueError, match=r"model.arm.joints\[0\].coulomb_friction: 9.0 is not allowed"):
        fm.inverse_dynamics(model, *np.zeros((5, 3)))

"""Friction: a link that slows down follows the closed forms, and every part of the package knows the same torque."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import flexman_gym as fm

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


@pytest.mark.parametrize(
    ("field", "value", "allowed"),
    [("viscous_friction", -1.0, ">= 0"), ("coulomb_friction", -1.0, ">= 0"), ("coulomb_rate", 0.0, "> 0")],
)
def test_friction_that_gives_energy_is_refused(field, value, allowed):
    with pytest.raises(ValueError, match=f"Joint.{field}: {value} is not allowed; give a finite number {allowed}"):
        fm.Joint((0.0, 0.0, 1.0), 1.0, **{field: value})

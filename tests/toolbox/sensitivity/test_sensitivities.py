"""Tests of sensitivities: differences extrapolated to zero, Taylor remainders, closed forms, and equal values."""

from dataclasses import replace
from functools import partial

import numpy as np
import pytest

import flexman_gym as fm
from flexman_gym.simulation.methods import IteratedGauss
from flexman_gym.toolbox.sensitivity.differentiation import INPUTS
from studies.derivatives.differences import allowed, deviations, remainder_orders
from studies.derivatives.scenes import OUTPUTS, ChangedScene, reduced, scene

Z = (0.0, 0.0, 1.0)
METHODS = ("midpoint_corrected_3", "midpoint_2", "gauss_2", "ros2", "extrapolated_euler_3")
# methods whose arms are simulated one after the other, with their steps, s; differences need a converged solution
CONVERGED = replace(fm.METHODS["generalised_alpha"], tolerance=1e-15)
SEQUENTIAL = [("rk4", 2.5e-4), ("semi_implicit_euler", 1e-4), (CONVERGED, 0.005)]
CHANGED = ChangedScene(scene(), "midpoint_corrected_3", 0.005)
EVERY = dict(CHANGED.parameters())  # name -> size


def test_every_parameter_is_differentiated():
    """Of the physical parameters and inputs none is missing from this test."""
    assert {name.partition("[")[0] for name in EVERY} == {*INPUTS}


@pytest.mark.slow
@pytest.mark.parametrize("method, step", [*((method, 0.005) for method in METHODS), *SEQUENTIAL])
def test_derivatives_are_those_of_extrapolated_differences(method, step):
    changed, names = replace(CHANGED, method=method, step=step), list(EVERY)[:: 1 if step == 0.005 else 7]
    found = fm.sensitivities(scene(), OUTPUTS, names, method=method, step=step)
    for column, name in enumerate(names):
        exact = reduced(found.jacobian[:, :, column])
        deviation, error = deviations(exact, partial(changed.outputs, name), EVERY[name])
        assert (deviation <= allowed(error)).all(), name


@pytest.mark.parametrize("method, step", [*((method, 0.005) for method in METHODS), *SEQUENTIAL])
def test_values_have_the_bits_of_a_simulation(method, step):
    found = fm.sensitivities(scene(), ("tip", "joint_angles"), ("payload_mass",), method=method, step=step)
    run = fm.simulate(scene(), method=method, step=step)
    assert np.array_equal(found.values, np.column_stack([run.tip, run.joint_angles]))


@pytest.mark.parametrize("name, size", [("payload_mass", 0.1), ("joint_stiffness[0]", 60.0),
                                        ("initial_joint_angles[0]", 1.0)])  # fmt: skip
def test_the_taylor_remainder_is_of_second_order(name, size):
    """It falls by a hundred over a decade of the change, over two decades."""
    found, changed = fm.sensitivities(scene(), OUTPUTS, name, step=0.005), partial(CHANGED.outputs, name)
    base, slope = reduced(found.values), reduced(found.jacobian[:, :, 0])
    orders = remainder_orders(base, slope, changed, size, np.geomspace(1e-2, 1e-4, 3))
    assert ((orders > 1.9) & (orders < 2.1)).all(), orders


def test_iterations_to_a_tolerance_tend_to_the_derivative_of_the_implicit_function():
    """That of the midpoint rule, which a fixed number of iterations beyond convergence gives to rounding."""
    to = ("joint_stiffness[0]", "payload_mass", "initial_joint_angles[1]")
    exact = fm.sensitivities(scene(), OUTPUTS, to, method=IteratedGauss("midpoint", 2, "", 25), step=0.005).jacobian
    scale, deviations = np.abs(exact).max(axis=0) + 1e-300, []
    for tolerance in (1e-3, 1e-6, 1e-9, 1e-12):
        method = replace(fm.METHODS["implicit_midpoint"], tolerance=tolerance)
        found = fm.sensitivities(scene(), OUTPUTS, to, method=method, step=0.005).jacobian
        deviations.append((np.abs(found - exact).max(axis=0) / scale).max())
    assert (np.diff(deviations) < 0.0).all() and deviations[0] > 1e-4 and deviations[-1] < 1e-9


def test_a_step_that_does_not_converge_ends_the_motion():
    fast = replace(scene(), initial=fm.Initial((0.4, -0.6), (20.0, -60.0)))
    found, run = (each(fast, method="implicit_midpoint", step=0.02) for each in (fm.sensitivities, fm.simulate))
    assert run.status == "not converged" and found.status == "diverged" and len(found.time) == len(run.time)


def test_a_rotor_under_constant_torque_has_its_closed_form():
    """Of the angle tau t^2 / (2 J) the derivative by the torque is t^2 / (2 J), of the rate by J it is -tau t / J^2."""
    inertia, torque = 0.4, 3.0
    light = fm.Link.rod(1.0, 1e-4)
    arm = fm.Arm([light], [fm.Joint(Z, inertia)])
    choice, start = fm.ModelChoice(flexible_links=(False,), elements=(1,)), fm.Initial((0.0,), (0.0,))
    one = fm.Scene(arm, choice, fm.ConstantTorque((torque,)), start, duration=1.0, output_step=0.1)
    found = fm.sensitivities(one, ("motor_angles", "motor_rates"), ("motor_torques[0]", "rotor_inertia[0]"), step=0.05)
    total = fm.mass_matrix(fm.build_model(arm, flexible_links=False), [0.0, 0.0])[0, 0]
    np.testing.assert_allclose(found.jacobian[:, 0, 0], found.time**2 / (2.0 * total), atol=1e-12)
    np.testing.assert_allclose(found.jacobian[:, 1, 1], -torque * found.time / total**2, atol=1e-11)


def test_more_than_seven_parameters_take_several_passes():
    names = list(EVERY)
    together = fm.sensitivities(scene(), "tip", names, step=0.005)
    for column in (0, 6, 7, len(names) - 1):
        alone = fm.sensitivities(scene(), "tip", names[column], step=0.005)
        assert np.array_equal(alone.jacobian[:, :, 0], together.jacobian[:, :, column])


def test_a_motor_with_prescribed_motion_has_no_torque_to_change():
    held = replace(scene(), torque=fm.ConstantTorque((0.0, 0.4)), prescribed=[fm.Signal(), None])
    assert fm.sensitivities(held, "tip", "motor_torques", step=0.005).parameters == ("motor_torques[1] (N m)",)
    with pytest.raises(ValueError, match="with prescribed motion"):
        fm.sensitivities(held, "tip", "motor_torques[0]", step=0.005)


def test_a_divergence_is_a_status():
    strong = replace(scene(), torque=fm.ConstantTorque((1e9, 0.0)))
    found = fm.sensitivities(strong, "tip", "payload_mass", step=0.005)
    assert found.status == "diverged" and np.isfinite(found.values).all() and len(found.time) < 21


@pytest.mark.parametrize("arguments, words", [
    ({"to": "payload"}, "to: 'payload' is not allowed"),
    ({"to": "joint_stiffness[2]"}, "to: 2 is not allowed"),
    ({"to": "payload_mass[0]"}, "to: 'payload_mass[0]' is not allowed"),
    ({"to": "coulomb_friction[1]"}, "without Coulomb friction"),
    ({"of": "tip_acceleration"}, "of: 'tip_acceleration' is not allowed"),
    ({"to": ()}, "at least one name"),
    ({"method": "dop853"}, "method: 'dop853' is not allowed; give one of fixed steps"),
])  # fmt: skip
def test_bad_arguments_are_refused_in_one_line(arguments, words):
    with pytest.raises(ValueError) as raised:
        fm.sensitivities(scene(), **{"step": 0.005, **arguments})
    assert words in str(raised.value) and "\n" not in str(raised.value)


def swinging(output_step):
    """A rigid link that swings at 0.1 rad/s through a gap of 0.019 rad of the spring of a motor at rest, for 0.9 s.

    It stays beyond either end of the gap for half a period of its vibration, 0.1 s.
    """
    strip = fm.Link.strip(0.5, 0.04, 0.003)
    inertia = fm.mass_matrix(fm.build_model(fm.Arm([strip], [fm.Joint(Z)]), flexible_links=False), [0.0, 0.0])[0, 0]
    joint = fm.Joint(Z, 0.01, stiffness=inertia * (10.0 * np.pi) ** 2, backlash=0.019, knee_width=1e-5)
    choice = fm.ModelChoice(flexible_links=(False,), elements=(1,))
    start = fm.Initial((0.0,), (0.0,), state=(0.0, 0.0, 0.1, 0.0))
    return fm.Scene(fm.Arm([strip], [joint]), choice, fm.ConstantTorque((0.0,)), start, duration=0.9,
                    output_step=output_step, prescribed=[fm.Signal()])  # fmt: skip


@pytest.mark.parametrize("output_step, count", [(0.01, 6), (0.3, 0)])
def test_passages_of_a_gap_are_counted_between_outputs(output_step, count):
    """At 0.095, 0.195, 0.385, 0.485, 0.675 and 0.775 s; 0.3 s later the link is in the gap again."""
    assert fm.sensitivities(swinging(output_step), step=0.001, to="backlash").kinks == {"joint_stiffness[0]": count}


@pytest.mark.parametrize("duration, count", [(0.4, 0), (1.0, 1), (2.0, 2)])
def test_reversals_of_a_motor_with_friction_are_counted(duration, count):
    """A torque of either sign for a second turns a rotor of 1 rad/s at 0.6 s, and back at 1.4 s."""
    light, inertia = fm.Link.rod(1.0, 1e-4), 3.0
    arm = fm.Arm([light], [fm.Joint(Z, inertia, coulomb_friction=1e-9)])
    choice, start = fm.ModelChoice(flexible_links=(False,), elements=(1,)), fm.Initial((0.0,), (1.0,))
    torque = fm.SampledTorque((0.0, 1.0, 2.0), ((-inertia / 0.6,), (inertia / 0.6,), (0.0,)))
    one = fm.Scene(arm, choice, torque, start, duration=duration, output_step=0.05)
    found = fm.sensitivities(one, to="coulomb_friction", step=0.05)
    assert found.kinks == {"coulomb_friction[0]": count}
    assert (f"kinks coulomb_friction[0] {count}" in repr(found)) and found.status == "ok"

"""Tests of sensitivities: differences extrapolated to zero, Taylor remainders, closed forms, and equal values."""

from dataclasses import replace

import numpy as np
import pytest

import flexman_gym as fm
from flexman_gym.model.model import scene_model
from flexman_gym.simulation.methods import IteratedGauss
from flexman_gym.simulation.parameters import PARAMETERS, nominal_parameters

Z = (0.0, 0.0, 1.0)
OUTPUTS = ("tip", "tip_velocity", "joint_angles", "motor_rates", "root_strains", "kinetic_energy", "elastic_energy",
           "gravitational_energy")  # fmt: skip
METHODS = ("midpoint_corrected_3", "midpoint_2", "gauss_2", "ros2", "extrapolated_euler_3")
# methods whose arms are simulated one after the other, with their steps, s; differences need a converged solution
CONVERGED = replace(fm.METHODS["generalised_alpha"], tolerance=1e-15)
SEQUENTIAL = [("rk4", 2.5e-4), ("semi_implicit_euler", 1e-4), (CONVERGED, 0.005)]
ROUNDING = 1e-14  # rounding error of an output, relative to its largest value
STEPS = (4e-3, 5e-4, 6e-5)  # relative steps of the differences
TORQUE = fm.SampledTorque((0.0, 0.11, 0.25, 0.4), ((1.2, 0.4), (-0.6, -0.3), (0.5, 0.2), (0.0, 0.1)))
CHOICE = fm.ModelChoice(flexible_links=(True, True), elements=(2, 2), modes=(2, 2))


def scene():
    """A planar arm under gravity with all effects of joints, for 0.4 s."""
    strip = fm.Link.strip(0.5, 0.04, 0.003)
    motor = fm.Motor(gear_ratio=100.0, torque_constant=0.05, rotor_inertia=2e-6, torque_ripple=0.002, ripple_cycles=2.0)
    friction = {"viscous_friction": 0.05, "coulomb_friction": 0.1, "coulomb_rate": 0.3, "static_friction": 0.14,
                "stribeck_rate": 0.5}  # fmt: skip
    first = fm.Joint(Z, stiffness=60.0, damping=0.05, motor=motor, **friction)
    second = fm.Joint(Z, 0.01, stiffness=40.0, damping=0.02, backlash=1e-3, stiffness_pieces=((0.5, 0.6), (1.5, 0.8)))
    arm = fm.Arm([strip, strip], [first, second], fm.Payload(0.1, offset=(0.02, 0.0, 0.0)), gravity=(0.0, -9.81, 0.0),
                 modal_damping_ratio=0.01)  # fmt: skip
    initial = fm.Initial(joint_angles=(0.2, -0.4), joint_rates=(0.5, 0.1))
    return fm.Scene(arm, CHOICE, TORQUE, initial, duration=0.4, output_step=0.02)


MODEL = scene_model(scene())


def outputs_of(trajectory):
    """Return the outputs (T, m) of a trajectory, in the order of OUTPUTS."""
    readings, states = trajectory.readings, trajectory.states
    n = trajectory.joint_angles.shape[1]
    energies = [trajectory.moving_energy, trajectory.energy - trajectory.moving_energy]
    assert states.shape[1] > 2 * n
    return np.column_stack(
        [trajectory.tip, trajectory.tip_velocity, trajectory.joint_angles, readings["motor_rates"],
         readings["root_strains"], *energies]
    )  # fmt: skip


def reduced(values):
    """Return outputs (T, m) of sensitivities with kinetic and elastic energy added, as in `outputs_of`."""
    return np.column_stack([values[:, :-3], values[:, -3] + values[:, -2], values[:, -1]])


def changed(name, index, step):
    """Return the outputs with a parameter changed by a step, and by its opposite."""
    given, method = scene(), changed.method
    results = []
    for change in (step, -step):
        current, parameters = given, {}
        if name.startswith("initial_"):
            field = name.removeprefix("initial_")
            values = np.array(getattr(given.initial, field))
            values[index] += change
            current = replace(given, initial=replace(given.initial, **{field: tuple(values)}))
        elif name in ("tip_force", "base_acceleration"):
            signals = [fm.Signal(offset=change * (axis == index)) for axis in range(3)]
            current = replace(given, **{name: signals})
        elif name == "motor_torques":
            values = np.array(TORQUE.values)
            values[:, index] += change
            current = replace(given, torque=fm.SampledTorque(TORQUE.times, values))
        else:
            values = np.array(nominal_parameters(MODEL)[name], dtype=float)
            values[() if index is None else index] += change
            parameters = {name: np.array([values, values])}
        results.append(outputs_of(fm.simulate_all([current] * 2, method=method, step=changed.step, **parameters)[0]))
    return results


changed.step = 0.005  # s


def extrapolated(name, index, size):
    """Return derivatives (3, T, m) from central differences extrapolated to order six, and estimates (3,) of errors.

    Springs with knees have a second derivative that jumps: large steps of the differences cross knees.
    """
    results, errors = [], []
    for largest in STEPS:
        steps = largest * size * np.array([1.0, 0.5, 0.25])
        plus_and_minus = np.concatenate([changed(name, index, step) for step in steps])
        first, second, third = (
            (plus - minus) / (2.0 * step)
            for step, plus, minus in zip(steps, plus_and_minus[::2], plus_and_minus[1::2], strict=True)
        )
        finer, coarser = (4.0 * third - second) / 3.0, (4.0 * second - first) / 3.0
        results.append((16.0 * finer - coarser) / 15.0)
        rounding = ROUNDING * np.abs(plus_and_minus).max(axis=(0, 1)) / (0.25 * largest * size)
        errors.append(np.abs(results[-1] - finer).max(axis=0) + rounding)
    return np.array(results), np.array(errors)


def every_parameter():
    """Return name, index and typical size of each parameter of the arm."""
    nominal = nominal_parameters(MODEL)
    for name in ("payload_mass", "joint_stiffness[0]", "joint_damping[1]", "rotor_inertia[1]", "viscous_friction[0]",
                 "coulomb_friction[0]", "coulomb_rate[0]", "static_excess[0]", "stribeck_rate[0]", "backlash[1]",
                 "soft_stiffness[1]", "ripple_torque[0]", "link_stiffness_factor[0]", "link_damping[1]"):  # fmt: skip
        key, _, index = name.partition("[")
        value = np.ravel(nominal[key])[int(index[:-1]) if index else 0]
        yield key, int(index[:-1]) if index else None, float(value)
    yield from (("initial_joint_angles", 0, 0.1), ("initial_joint_rates", 1, 0.5), ("motor_torques", 1, 0.3))
    yield from (("tip_force", 1, 1.0), ("base_acceleration", 0, 1.0))


def label(name, index):
    return name if index is None else f"{name}[{index}]"


def test_every_parameter_is_differentiated():
    """Of the physical parameters none is missing from this test."""
    assert {name for name, _, _ in every_parameter()} >= set(PARAMETERS)


@pytest.mark.parametrize("method", METHODS)
def test_derivatives_are_those_of_extrapolated_differences(method):
    compare_with_differences(method, 0.005, list(every_parameter()))


@pytest.mark.parametrize("method, step", SEQUENTIAL)
def test_derivatives_of_other_methods_are_those_of_extrapolated_differences(method, step, monkeypatch):
    monkeypatch.setattr(changed, "step", step)
    compare_with_differences(method, step, list(every_parameter())[::7])


def compare_with_differences(method, step, names):
    """Check the derivatives with respect to parameters, given by name, index and size, to 1e-8 or rounding."""
    changed.method = method
    found = fm.sensitivities(scene(), OUTPUTS, [label(*each[:2]) for each in names], method=method, step=step)
    for column, (name, index, size) in enumerate(names):
        exact = reduced(found.jacobian[:, :, column])
        best, error = extrapolated(name, index, size)
        scale = np.abs(exact).max(axis=0) + 1e-6 * np.abs(exact).max()
        deviation = np.abs(exact - best).max(axis=1)
        assert (deviation <= np.maximum(1e-8 * scale, 3.0 * error)).any(axis=0).all(), (name, index)


@pytest.mark.parametrize("method, step", [*((method, 0.005) for method in METHODS), *SEQUENTIAL])
def test_values_have_the_bits_of_a_simulation(method, step):
    found = fm.sensitivities(scene(), ("tip", "joint_angles"), ("payload_mass",), method=method, step=step)
    run = fm.simulate(scene(), method=method, step=step)
    assert np.array_equal(found.values, np.column_stack([run.tip, run.joint_angles]))


@pytest.mark.parametrize(
    "name, size", [("payload_mass", 0.1), ("joint_stiffness[0]", 60.0), ("initial_joint_angles[0]", 1.0)]
)
def test_the_taylor_remainder_is_of_second_order(name, size):
    """It falls by a hundred over a decade of the change, over two decades."""
    changed.method = "midpoint_corrected_3"
    found = fm.sensitivities(scene(), OUTPUTS, name, step=0.005)
    key, _, index = name.partition("[")
    base, slope = reduced(found.values), reduced(found.jacobian[:, :, 0])
    remainders = []
    for step in 1e-2 * size / np.array([1.0, 10.0, 100.0]):
        plus, _ = changed(key, int(index[:-1]) if index else None, step)
        remainders.append(np.abs(plus - base - step * slope).max())
    orders = np.log10(remainders[:-1]) - np.log10(remainders[1:])
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
    names = [label(name, index) for name, index, _ in every_parameter()]
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

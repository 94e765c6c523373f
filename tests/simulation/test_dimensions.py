"""Derivatives with respect to dimensions, materials and gear ratios, against differences of simulations."""

from dataclasses import replace

import numpy as np
import pytest

import flexman_gym as fm
from flexman_gym.model.dynamics import RICHARDSON
from flexman_gym.model.model import changed_model, scene_model
from flexman_gym.simulation.dimensions import DIMENSIONS

Z, STEP = (0.0, 0.0, 1.0), 2e-3  # joint axis; relative step of the differences
NOMINAL = {
    "link_length[0]": 0.5, "link_length[1]": 0.4, "link_width[0]": 0.04, "link_thickness[0]": 0.003,
    "link_diameter[1]": 0.02, "link_wall[1]": 0.002, "link_youngs_modulus[0]": 68.9e9, "link_shear_modulus[0]": 26.0e9,
    "link_density[1]": 2700.0, "gear_ratio[0]": 100.0,
}  # fmt: skip
OUTPUTS = ("tip", "tip_velocity", "motor_rates", "root_strains", "kinetic_energy", "elastic_energy")
FULL, MODAL = {"elements": 1, "modes": None}, {"elements": 1, "modes": 6}
REDUCED = {"elements": 2, "modes": 4}


def arm(payload=0.1, **changes):
    """Return a strip and a tube, bent out of plane by gravity, with given values of parameters."""
    given = {name.partition("[")[0]: value for name, value in (NOMINAL | changes).items()}
    length, outer = (NOMINAL | changes)["link_length[0]"], given["link_length"]
    first = fm.Link.strip(length, given["link_width"], given["link_thickness"], masses=[fm.LumpedMass(0.05, length)],
                          material=(given["link_youngs_modulus"], given["link_shear_modulus"], 2700.0))  # fmt: skip
    second = fm.Link.tube(outer, given["link_diameter"], given["link_wall"],
                          material=(68.9e9, 26.0e9, given["link_density"]))  # fmt: skip
    motor = fm.Motor(given["gear_ratio"], 0.05, 2e-6, torque_ripple=0.01, ripple_cycles=0.05)
    joints = [fm.Joint(Z, stiffness=60.0, motor=motor), fm.Joint((0.0, 1.0, 0.0), 0.01, stiffness=40.0)]
    load = fm.Payload(payload, offset=(0.0, 0.02, 0.0)) if payload else None
    return fm.Arm([first, second], joints, load, gravity=(0.0, -9.81, 0.0), modal_damping_ratio=0.02)


def scene(given, **choice):
    start = fm.Initial((0.2, -0.4), (0.5, 0.1))
    return fm.Scene(given, fm.ModelChoice((True, True), **choice), fm.ConstantTorque((1.2, -0.6)), start, duration=0.1,
                    output_step=0.02)  # fmt: skip


def outputs_of(run):
    """Return the outputs (T, m) of a simulation in the order of OUTPUTS, with both energies added."""
    return np.column_stack(
        [run.tip, run.tip_velocity, run.readings["motor_rates"], run.readings["root_strains"], run.moving_energy]
    )


def differences(simulate, nominal):
    """Return the derivative of a function of a parameter by differences extrapolated to order six."""
    step = STEP * nominal
    return sum(
        weight / (2.0 * k * step) * (simulate(nominal + k * step) - simulate(nominal - k * step))
        for k, weight in RICHARDSON
    )


def moving(found):
    """Return the derivatives (T, m, p) with kinetic and elastic energy added."""
    both = found.jacobian[:, -2:].sum(axis=1, keepdims=True)
    return np.concatenate([found.jacobian[:, :-2], both], axis=1)


def check(found, column, expected):
    """Compare derivatives (T, m) with those of differences, relative to the largest of each output."""
    scale = np.abs(expected).max(axis=0)
    deviation = np.abs(moving(found)[:, :, column] - expected).max(axis=0)
    assert (deviation <= 2e-8 * scale + 1e-9 * scale.max()).all(), (NAMES[column], deviation / (scale + 1e-300))


NAMES = list(NOMINAL)


def test_every_dimension_is_differentiated():
    assert {name.partition("[")[0] for name in NAMES} == set(DIMENSIONS)


@pytest.mark.parametrize("choice", [FULL, MODAL | {"stiffening": True}])
def test_without_reduction_they_are_those_of_complete_simulations(choice):
    """With all coordinates, whether of nodes or of modes, it does not matter that the modes are held."""
    found = fm.sensitivities(scene(arm(), **choice), OUTPUTS, NAMES, step=0.005)
    for column, name in enumerate(NAMES):

        def simulate(value, name=name):
            return outputs_of(fm.simulate(scene(arm(**{name: value}), **choice), method="auto", step=0.005))

        expected = differences(simulate, NOMINAL[name])
        assert expected.any()
        check(found, column, expected)


@pytest.mark.parametrize("payload, rotary", [(0.1, True), (0.0, False)])
def test_with_few_modes_they_are_those_of_models_with_the_same_modes(payload, rotary):
    """Without payload and rotary inertia modes are orthogonal, but not those of a link with another length."""
    choice = REDUCED | {"rotary_inertia": rotary}
    given = scene(arm(payload), **choice)
    model = scene_model(given)
    found = fm.sensitivities(given, OUTPUTS, NAMES, step=0.005)
    for column, name in enumerate(NAMES):

        def simulate(value, name=name):
            other = arm(payload, **{name: value})
            held = changed_model(model, other)
            return outputs_of(fm.simulate(replace(given, arm=other), held, method="auto", step=0.005))

        check(found, column, differences(simulate, NOMINAL[name]))


def test_values_have_the_bits_of_a_simulation():
    given = scene(arm(), **REDUCED)
    found = fm.sensitivities(given, ("tip", "joint_angles"), "link_length", step=0.005)
    run = fm.simulate(given, method="auto", step=0.005)
    assert np.array_equal(found.values, np.column_stack([run.tip, run.joint_angles]))
    assert found.parameters == ("link_length[0] (m)", "link_length[1] (m)")


@pytest.mark.parametrize("name, words", [
    ("link_thickness[1]", "without an outline of shape strip"),
    ("link_wall[0]", "without an outline of shape tube"),
    ("gear_ratio[1]", "without a motor"),
    ("link_length[2]", "to: 2 is not allowed"),
])  # fmt: skip
def test_a_part_without_the_dimension_is_refused(name, words):
    with pytest.raises(ValueError, match=words.replace("[", r"\[")):
        fm.sensitivities(scene(arm(), **REDUCED), "tip", name, step=0.005)


def test_a_stepped_link_has_no_dimension_of_its_own():
    rods = [fm.Link.rod(0.3, diameter=0.012), fm.Link.rod(0.2, diameter=0.008)]
    stepped = fm.Arm([fm.NonUniformLink(rods)], [fm.Joint(Z)])
    given = fm.Scene(
        stepped, fm.ModelChoice((True,), 1), fm.ConstantTorque((0.1,)), fm.Initial((0.0,), (0.0,)), 0.1, 0.02
    )
    with pytest.raises(ValueError, match="non-uniform"):
        fm.sensitivities(given, "tip", "link_length[0]", step=0.005)

"""Derivatives with respect to dimensions, materials and gear ratios, against differences of simulations."""

from dataclasses import replace

import numpy as np
import pytest

import flexman_gym as fm
from flexman_gym.model.dynamics import RICHARDSON
from flexman_gym.model.model import changed_model, scene_model
from flexman_gym.toolbox.sensitivity.differentiation import DIMENSIONS
from studies.derivatives.dimensions import NOMINAL, OUTPUTS, arm, outputs_of, reduced, scene

STEP = 2e-3  # relative step of the differences
FULL, MODAL = {"elements": 1, "modes": None}, {"elements": 1, "modes": 6}
REDUCED = {"elements": 2, "modes": 4}


def differences(simulate, nominal):
    """Return the derivative of a function of a parameter by differences extrapolated to order six."""
    step = STEP * nominal
    return sum(
        weight / (2.0 * k * step) * (simulate(nominal + k * step) - simulate(nominal - k * step))
        for k, weight in RICHARDSON
    )


def check(found, column, expected):
    """Compare derivatives (T, m) with those of differences, relative to the largest of each output."""
    scale = np.abs(expected).max(axis=0)
    deviation = np.abs(reduced(found.jacobian)[:, :, column] - expected).max(axis=0)
    assert (deviation <= 2e-8 * scale + 1e-9 * scale.max()).all(), (NAMES[column], deviation / (scale + 1e-300))


NAMES = list(NOMINAL)


def test_every_dimension_is_differentiated():
    assert {name.partition("[")[0] for name in NAMES} == set(DIMENSIONS)


@pytest.mark.slow
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


@pytest.mark.slow
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
    ("link_thickness[1]", "no outline of shape strip"),
    ("link_wall[0]", "no outline of shape tube"),
    ("gear_ratio[1]", "no motor"),
    ("link_length[2]", "to: 2 is not allowed"),
])  # fmt: skip
def test_a_part_without_the_dimension_is_refused(name, words):
    with pytest.raises(ValueError, match=words.replace("[", r"\[")):
        fm.sensitivities(scene(arm(), **REDUCED), "tip", name, step=0.005)


def test_a_stepped_link_has_no_dimension_of_its_own():
    rods = [fm.Link.rod(0.3, diameter=0.012), fm.Link.rod(0.2, diameter=0.008)]
    stepped = fm.Arm([fm.NonUniformLink(rods)], [fm.Joint((0.0, 0.0, 1.0))])
    given = fm.Scene(
        stepped, fm.ModelChoice((True,), 1), fm.ConstantTorque((0.1,)), fm.Initial((0.0,), (0.0,)), 0.1, 0.02
    )
    with pytest.raises(ValueError, match="more than one section"):
        fm.sensitivities(given, "tip", "link_length[0]", step=0.005)


def test_the_gear_ratio_of_a_voltage_motor():
    """Its torque limit, that of the voltage at standstill, changes with the ratio."""
    arm = fm.catalog.quanser_rotary()

    def tip(ratio):
        joint = arm.joints[0]
        motor = replace(joint.motor, gear_ratio=ratio)
        changed = fm.Joint(joint.axis, viscous_friction=joint.viscous_friction, motor=motor)
        scene = fm.Scene(replace(arm, joints=[changed]), fm.ModelChoice(False, 1), fm.ConstantTorque((0.2,)),
                         fm.Initial((0.0,), (0.0,)), duration=0.1, output_step=0.02)  # fmt: skip
        return scene, fm.simulate(scene, method="midpoint_corrected_3", step=0.002).tip[-1]

    exact = fm.sensitivities(tip(70.0)[0], to="gear_ratio", step=0.002).jacobian[-1, :, 0]
    coarse, fine = ((tip(70.0 + h)[1] - tip(70.0 - h)[1]) / (2.0 * h) for h in (0.2, 0.1))
    np.testing.assert_allclose(exact, (4.0 * fine - coarse) / 3.0, rtol=1e-6, atol=1e-12)

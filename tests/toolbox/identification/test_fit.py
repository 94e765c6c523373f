"""Records: parameters from time records of made-up arms, and what is refused or told of a record that is wrong."""

from dataclasses import replace
from functools import cache, partial

import numpy as np
import pytest

import flexman_gym as fm
from flexman_gym.simulation.physical_parameters import PARAMETERS, varied_arm, varied_model
from flexman_gym.toolbox.identification.measurement import SimulatedResponse

from oracles.assertions import refusal

PERIOD, SAMPLES = 0.01, 161
TIMES = PERIOD * np.arange(SAMPLES)
TRUE = {"joint_stiffness": np.array([26.0]), "link_damping": np.array([0.02]), "payload_mass": np.array(0.08)}
LOW_PASS = fm.Filter.low_pass(4.0, 0.8)
CHOICE = {"elements": 1, "modes": 3}


def made_up(times, inputs, outputs, filters=None, **more):
    """A measurement of the true arm: what the reference method says."""
    arm = varied_arm(fm.catalog.one_joint(), TRUE)
    torque = np.array(inputs.get("torque_1", np.zeros(len(times))))
    hub = inputs.get("motor_angle_1")
    given = fm.SampledTorque(times, torque[:, None]) if torque.any() else fm.ConstantTorque([0.0])
    scene = fm.Scene(
        arm, fm.ModelChoice((True,), (1,), (3,)), given,
        fm.Initial([0.0], [0.0]), times[-1], PERIOD, prescribed=None if hub is None else [fm.SampledAngles(times, hub)],
    )  # fmt: skip
    run = fm.simulate(scene, rtol=1e-8, atol=1e-11)
    columns = {head.partition(" (")[0]: values for head, values in run.columns().items()}
    filters = filters or {}
    values = {name: columns[name] for name in outputs}
    values = {name: filters[name].applied(each, PERIOD) if name in filters else each for name, each in values.items()}
    return fm.Measurement(times, inputs, values, filters, **more)


@cache
def pushed():
    """A record of a torque that goes up and down."""
    torque = 0.2 * np.sign(np.sin(2.0 * np.pi * 1.3 * TIMES + 0.1)) * (TIMES < 1.2)
    return made_up(TIMES, {"torque_1": torque}, ("motor_angle_1", "root_strain_1_y"))


def noisy(record, part=0.005, seed=0):
    """The record with white noise, a part of the rms of each output."""
    rng = np.random.default_rng(seed)
    outputs = {
        name: values + part * np.std(values) * rng.standard_normal(len(values))
        for name, values in record.outputs.items()
    }
    return replace(record, outputs=outputs)


def test_true_parameters_come_back_within_their_deviations():
    found = fm.fit(fm.catalog.one_joint(), [*TRUE], records=[noisy(pushed())], **CHOICE)
    assert found.undetermined == ()
    assert found.warnings == ()
    assert min(found.scores.values()) > 0.9999
    for name, value in TRUE.items():
        assert found.deviations[name] < 0.1 * value
        assert abs(found.values[name] - value) < 3.0 * found.deviations[name]


@pytest.mark.slow
def test_hub_motion_in_deflection_out_with_an_unknown_gain():
    hub = 0.3 * np.sin(2.0 * np.pi * 0.9 * TIMES) ** 3
    name = "link_deflection_1_y"
    record = made_up(TIMES, {"motor_angle_1": hub}, (name,), {name: LOW_PASS}, gains=(name,), offsets=(name,))
    record = replace(record, outputs={name: 1.7 * record.outputs[name] + 2e-3})
    start = varied_arm(fm.catalog.one_joint(), {each: TRUE[each] for each in ("link_damping", "payload_mass")})
    found = fm.fit(start, "joint_stiffness", records=[record.part(0.0, 1.2)], **CHOICE)
    assert found.values["joint_stiffness"] == pytest.approx(TRUE["joint_stiffness"], rel=1e-4)
    assert found.gains[name][0] == pytest.approx(1.7, rel=1e-3)
    assert found.score(record)[name] > 0.99999
    missed = record.outputs[name] - found.predicted(record)[name]
    assert np.var(missed) < 1e-5 * np.var(record.outputs[name])
    # the same without the filter in the record: damping and stiffness are nonsense, and the filter is told
    bare = replace(record, filters={})
    found = fm.fit(start, "joint_stiffness", records=[bare], starts=0, **CHOICE)
    assert found.score(bare)[name] < 0.98
    assert any("low-pass of about" in line and name in line for line in found.warnings)


@pytest.mark.slow
def test_what_a_record_cannot_tell_is_named():
    """A held motor tells nothing of its friction, and a spring without a rotor's motion nothing of the rotor."""
    hub = 0.3 * np.sin(2.0 * np.pi * 0.9 * TIMES) ** 3
    record = made_up(TIMES, {"motor_angle_1": hub}, ("link_deflection_1_y",))
    found = fm.fit(fm.catalog.one_joint(), ["link_stiffness_factor", "viscous_friction"], records=[record], **CHOICE)
    assert found.undetermined == ("viscous_friction[0]",)
    assert found.explanation == "The data do not determine viscous_friction[0]."
    assert found.values["viscous_friction"].shape == (1,)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda r: {"motor_angle_1": r.outputs["motor_angle_1"] * 57.29578}, "is it in deg?"),
        (lambda r: {"motor_angle_1": -r.outputs["motor_angle_1"]}, "is a sign wrong?"),
        (lambda r: {"motor_angle_1": r.outputs["motor_angle_1"] + (TIMES[70] == TIMES)}, "is the record damaged?"),
    ],
)  # fmt: skip
def test_a_record_that_looks_wrong_is_told(change, words):
    record = noisy(pushed())
    record = replace(record, outputs=dict(record.outputs) | change(record))
    found = fm.fit(fm.catalog.one_joint(), "joint_stiffness", records=[record], starts=0, **CHOICE)
    assert any(words in line and "motor_angle_1" in line for line in found.warnings)


def test_bad_records_are_refused_in_one_line(tmp_path):
    outputs, good = {"motor_angle_1": np.zeros(SAMPLES)}, np.zeros(SAMPLES)
    gap = np.where(TIMES > 0.5, TIMES + 0.3, TIMES)
    for words, arguments in (
        ("there is a gap after 0.5 s", (gap, {}, outputs)),
        ("Measurement.outputs['motor_angle_1']", (TIMES, {}, {"motor_angle_1": np.where(TIMES > 1, np.nan, good)})),
        *(
            ("Measurement.inputs: 'torque", (TIMES, {f"torque{end}": good}, outputs))
            for end in ("", "_0", "_00", "_\N{SUPERSCRIPT TWO}", "_" + "9" * 5000)
        ),
        ("Measurement.outputs: {} is not allowed; give at least one", (TIMES, {}, {})),
    ):
        assert words in refusal(fm.Measurement, *arguments)
    more = (
        {"filters": {"tip_x": LOW_PASS}},
        {"gains": ("tip_x",)},
        {"filters": {"motor_angle_1": 2.0}},
        {"settling": 9.0},
    )
    for each in more:
        refusal(partial(fm.Measurement, **each), TIMES, {}, outputs)
    refusal(fm.Filter, (1.0, 0.0), (1.0,))
    refusal(fm.Filter, (1.0,), (1.0, -1.0))
    arm = fm.catalog.one_joint()
    odd = ("joint_stiffness[\N{SUPERSCRIPT TWO}]", f"joint_stiffness[{'9' * 5000}]")
    for free in ("stiffness", "joint_stiffness[1]", "payload_mass[0]", [], *odd):
        refusal(fm.fit, arm, free, [1.0])
    assert "a parameter that this arm has" in refusal(fm.fit, fm.catalog.planar_2r(), "joint_stiffness", [1.0])
    lacking = fm.Measurement(TIMES, {"torque_2": good}, outputs)
    assert "joints from 1 to 1" in refusal(partial(fm.fit, records=[lacking]), arm, "link_stiffness_factor")
    unknown = fm.Measurement(TIMES, {"torque_1": good + 1.0}, {"elbow": good})
    assert "'elbow' is not allowed" in refusal(partial(fm.fit, records=[unknown]), arm, "link_stiffness_factor")
    file = tmp_path / "run.csv"
    file.write_text("time (s),hub (deg),torque (A)\n" + "".join(f"{t},{90 * t},0\n" for t in TIMES))
    read = fm.Measurement.from_csv(file, {}, {"motor_angle_1": "hub"})
    assert read.outputs["motor_angle_1"] == pytest.approx(np.pi / 2.0 * TIMES)
    assert "torque" in refusal(fm.Measurement.from_csv, file, {"torque_1": "torque"}, {"motor_angle_1": "hub"})


def test_a_filter_is_its_transfer_function():
    """A sine comes out with gain and phase of H(i w), and a constant at once."""
    fine = 1e-3 * np.arange(6000)
    rate = 2.0 * np.pi * 3.0
    response = 1.0 / (1.0 - (3.0 / 4.0) ** 2 + 2j * 0.8 * 3.0 / 4.0)
    shown = LOW_PASS.applied(np.sin(rate * fine), 1e-3)[3000:]
    assert shown == pytest.approx(np.abs(response) * np.sin(rate * fine + np.angle(response))[3000:], abs=1e-4)
    assert LOW_PASS.applied(np.full((2, 9), 3.0), 0.1) == pytest.approx(3.0)
    assert fm.Filter((2.0,), (4.0,)).applied(np.ones(3), 0.1) == pytest.approx(0.5)


def test_the_accelerometer_of_a_record_is_that_of_the_tip():
    """The second derivative of the tip's places, and what is felt is that of an arm without weight, turned along."""
    torque = 0.2 * np.sin(2.0 * np.pi * 1.3 * TIMES)
    record = replace(pushed(), inputs={"torque_1": torque}, hold="linear")
    names = ("tip_acceleration_y", "specific_force_y", "tip_y")
    both = replace(record, outputs=dict.fromkeys(names, TIMES))
    response = SimulatedResponse(fm.catalog.one_joint(), both, 0.0025)
    model = fm.build_model(response.scene.arm, **CHOICE)
    shown = response.signals(model, {"payload_mass": np.array([0.05, 0.08])})
    bent = np.diff(shown[:, 2], 2) / PERIOD**2
    assert shown[:, 0, 20:-20] == pytest.approx(bent[:, 19:-19], abs=0.02 * np.abs(bent).max())
    assert np.abs(shown[0, 0] - shown[1, 0]).max() > 0.1 * np.abs(bent).max()
    assert np.abs(shown[:, 1]).max() > 0.5 * np.abs(bent).max()


@pytest.mark.slow
def test_the_arm_and_the_report_are_files(tmp_path):
    found = fm.fit(fm.catalog.one_joint(), [*TRUE], records=[pushed()], **CHOICE)
    found.report(tmp_path)
    text = (tmp_path / "fit.md").read_text()
    assert "joint_stiffness" in text and found.explanation in text
    assert (tmp_path / "fit.png").stat().st_size > 10_000
    assert fm.Scene.from_dict({**minimal(found.arm), "arm": arm_in(tmp_path / "arm.yaml")}).arm == found.arm


def arm_in(path):
    """The mapping of an arm in a file."""
    from flexman_gym.common.files import read_data

    return read_data(path)["arm"]


def minimal(arm):
    """A scene of an arm as a mapping."""
    scene = fm.Scene(arm, fm.ModelChoice((True,), (1,)), fm.ConstantTorque([0.0]), fm.Initial([0.0], [0.0]), 1.0, 0.1)
    return scene.to_dict()


@pytest.mark.parametrize("name", PARAMETERS)
def test_an_arm_with_a_parameter_has_the_constants_of_a_model_with_it(name):
    """Of a whole model, as modes change with the arm; the payload's mass changes how loaded modes are damped."""
    arm = replace(fm.catalog.vertical_2r(), modal_damping_ratio=(0.01, 0.02))
    worn = {"coulomb_friction": 0.1, "static_friction": 0.13, "viscous_friction": 0.2, "backlash": 1e-3}
    worn |= {"stiffness_pieces": ((0.5, 0.4), (1.0, 0.7)), "rotor_inertia": 0.0}
    motor = fm.Motor(50.0, 0.04, 4e-6, efficiency=0.8, torque_ripple=1e-3, ripple_cycles=2.0)
    arm = replace(arm, joints=[replace(joint, motor=motor, **worn) for joint in arm.joints])
    model = fm.build_model(arm, 1)
    value = np.array(PARAMETERS[name].nominal(model)) * 1.3
    changed, built = (
        varied_model(model, **{name: value}).constants,
        fm.build_model(varied_arm(arm, {name: value}), 1).constants,
    )
    for field in changed._fields:
        if not (name == "payload_mass" and field == "damping"):
            assert getattr(changed, field) == pytest.approx(getattr(built, field), rel=1e-9, abs=1e-12), field

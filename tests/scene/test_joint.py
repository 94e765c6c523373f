"""Motor: a joint has inertia, limits and resolution as its gear gives them, and keeps its motor in a file."""

import math
from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

import flexman_gym as fm
from flexman_gym.scene.serialization import find_arm, to_plain

from oracles.assertions import refusal

Z = (0.0, 0.0, 1.0)
MOTOR = fm.Motor(50.0, 0.04, 1e-5, current_limit=3.0, speed_limit=400.0, efficiency=0.8, encoder_resolution=0.002)
LINK = fm.Link(0.5, 1.2e-4, 1.6e-8, 9e-11, 3.4e-10, 70e9, 26e9, 2700.0)
sizes = st.floats(1e-3, 1e3)


@given(*[sizes] * 5, st.floats(0.01, 1.0))
def test_a_gear_keeps_power_but_for_its_loss_and_energy_of_the_rotor(
    gear, constant, inertia, current, speed, efficiency
):
    """Torque times speed shrinks by the efficiency, J w^2 / 2 is the same on both sides."""
    motor = fm.Motor(gear, constant, inertia, current, speed, efficiency)
    joint = fm.Joint(Z, motor=motor)
    assert joint.torque_limit * joint.speed_limit == pytest.approx(efficiency * constant * current * speed)
    assert joint.rotor_inertia * joint.speed_limit**2 == pytest.approx(inertia * speed**2)
    assert motor.torque_per_ampere * current == pytest.approx(joint.torque_limit)


def test_counts_of_the_encoder_are_finer_at_the_joint():
    assert MOTOR.joint_resolution == pytest.approx(0.002 / 50.0)
    bare = fm.Motor(50.0, 0.04, 1e-5)
    assert (bare.joint_resolution, bare.joint_torque_limit, bare.joint_speed_limit) == (None, None, None)
    assert fm.Joint(Z, motor=bare).torque_limit is fm.Joint(Z, motor=bare).speed_limit is None
    assert fm.Joint(Z, motor=bare, torque_limit=2.0).torque_limit == 2.0  # of a gear, say
    assert fm.Joint(Z).speed_limit is None and fm.Joint(Z, speed_limit=2.0).speed_limit == 2.0
    assert fm.Joint(Z, motor=bare, speed_limit=2.0).speed_limit == 2.0
    assert fm.Joint(Z, motor=MOTOR, speed_limit=8.0).speed_limit == MOTOR.joint_speed_limit == 8.0


def test_a_motor_on_a_joint_is_the_same_arm_as_its_numbers():
    by_motor, by_numbers = (
        fm.Arm([LINK], [joint])
        for joint in (
            fm.Joint(Z, stiffness=20.0, motor=MOTOR),
            fm.Joint(Z, rotor_inertia=MOTOR.reflected_inertia, stiffness=20.0),
        )
    )
    first, second = (fm.frequencies(fm.build_model(arm)) for arm in (by_motor, by_numbers))
    assert (first == second).all() and MOTOR.reflected_inertia == pytest.approx(0.025)


@pytest.mark.parametrize(
    "motor", [MOTOR, fm.Motor(1.0, 0.1, 0.0), replace(MOTOR, current_limit=None), replace(MOTOR, speed_limit=None)]
)
@pytest.mark.parametrize("limit", [None, 7.0])
def test_an_arm_with_motors_comes_back_from_its_mapping(motor, limit, tmp_path):
    if motor.current_limit is not None and limit is not None:
        limit = motor.joint_torque_limit
    arm = fm.Arm([LINK, LINK], [fm.Joint(Z, motor=motor, torque_limit=limit), fm.Joint(Z, rotor_inertia=0.1)])
    data = to_plain(arm)
    assert find_arm(data) == arm and "rotor_inertia" not in data["joints"][0] and "motor" not in data["joints"][1]
    still = fm.Scene(
        arm, fm.ModelChoice(True, 2), fm.ConstantTorque([0.0, 0.0]), fm.Initial([0.0, 0.0], [0.0, 0.0]), 1.0, 0.1
    )
    for name in ("scene.json", "scene.yaml"):
        still.save(tmp_path / name)
        assert fm.Scene.load(tmp_path / name) == still


def test_a_copy_of_a_joint_keeps_its_motor():
    joint = fm.Joint(Z, motor=MOTOR)
    assert replace(joint, damping=0.0) == joint
    assert replace(joint, stiffness=5.0).rotor_inertia == MOTOR.reflected_inertia


def test_friction_and_gears_come_back_from_a_mapping():
    """With pieces as lists; fields at their defaults are not written."""
    joint = fm.Joint(Z, stiffness=20.0, coulomb_friction=1.0, static_friction=1.3, stribeck_rate=0.02, backlash=1e-3,
                     stiffness_pieces=[[2.0, 0.5]], knee_width=1e-5,
                     motor=replace(MOTOR, torque_ripple=0.01, ripple_cycles=6.0, ripple_phase=-0.5))  # fmt: skip
    arm = fm.Arm([LINK], [joint])
    data = to_plain(arm)
    assert find_arm(data) == arm and data["joints"][0]["stiffness_pieces"] == [[2.0, 0.5]]
    plain = to_plain(fm.Arm([LINK], [fm.Joint(Z, motor=MOTOR)]))["joints"][0]
    assert {"backlash", "static_friction", "knee_width"}.isdisjoint(plain) and "ripple_phase" not in plain["motor"]
    assert joint.static_excess == pytest.approx(0.3) and joint.ripple_torque == pytest.approx(0.01 * 50.0 * 0.8)


@pytest.mark.parametrize(
    ("make", "line"),
    [
        (
            lambda: fm.Joint(Z, 0.1, motor=MOTOR),
            "Joint.rotor_inertia: 0.1 is not allowed; give none together with a motor",
        ),
        (lambda: fm.Joint(Z, motor=MOTOR, torque_limit=9.0), "Joint.torque_limit: 9.0 is not allowed; give none"),
        (lambda: fm.Joint(Z, motor="big"), "Joint.motor: 'big' is not allowed; give a Motor or None"),
        (lambda: replace(MOTOR, efficiency=1.2), "Motor.efficiency: 1.2 is not allowed; give a number > 0 and <= 1"),
        (lambda: replace(MOTOR, gear_ratio=0.0), "Motor.gear_ratio: 0.0 is not allowed; give a finite number > 0"),
        (lambda: replace(MOTOR, current_limit=-1.0), "Motor.current_limit: -1.0 is not allowed; give a finite number"),
        (
            lambda: replace(MOTOR, torque_ripple=0.1),
            "Motor.torque_ripple: 0.1 is not allowed; give 0 without ripple_cycles",
        ),
        (
            lambda: replace(MOTOR, ripple_cycles=0.0),
            "Motor.ripple_cycles: 0.0 is not allowed; give a finite number > 0",
        ),
        (lambda: replace(MOTOR, ripple_phase=math.inf), "Motor.ripple_phase: inf is not allowed; give a finite number"),
        (
            lambda: fm.Joint(Z, static_friction=1.0),
            "Joint.static_friction: 1.0 is not allowed; give a torque (N m) of at",
        ),
        (
            lambda: fm.Joint(Z, coulomb_friction=2.0, static_friction=1.9),
            "Joint.static_friction: 1.9 is not allowed; give",
        ),
        (lambda: fm.Joint(Z, stribeck_rate=0.0), "Joint.stribeck_rate: 0.0 is not allowed; give a finite number > 0"),
        (lambda: fm.Joint(Z, knee_width=0.0), "Joint.knee_width: 0.0 is not allowed; give a finite number > 0"),
        (
            lambda: fm.Joint(Z, 0.1, 5.0, backlash=-1e-3),
            "Joint.backlash: -0.001 is not allowed; give a finite number >= 0",
        ),
        (lambda: fm.Joint(Z, backlash=1e-3), "Joint.backlash: 0.001 is not allowed; give none with stiffness None"),
        (
            lambda: fm.Joint(Z, stiffness_pieces=[(1.0, 0.5)]),
            "Joint.stiffness_pieces: ((1.0, 0.5),) is not allowed; give none",
        ),
        (lambda: fm.Joint(Z, 0.1, 5.0, stiffness_pieces=3), "Joint.stiffness_pieces: 3 is not allowed; give "),
        (
            lambda: fm.Joint(Z, 0.1, 5.0, stiffness_pieces=[(1.0, 1.5)]),
            "Joint.stiffness_pieces[0]: (1.0, 1.5) is not allowed",
        ),
        (
            lambda: fm.Joint(Z, 0.1, 5.0, stiffness_pieces=[(2.0, 0.5), (1.0, 0.7)]),
            "Joint.stiffness_pieces[1]: (1.0, 0.7) is not allowed; give (torque, fraction) with a torque > 2",
        ),
        (lambda: fm.Joint(Z, speed_limit=0.0), "Joint.speed_limit: 0.0 is not allowed; give a finite number > 0"),
        (
            lambda: fm.Joint(Z, motor=MOTOR, speed_limit=7.0),
            "Joint.speed_limit: 7.0 is not allowed; give none together with a motor with a speed limit, which sets 8",
        ),
        (
            lambda: fm.Joint(Z, angle_range=(1.0, 1.0)),
            "Joint.angle_range: (1.0, 1.0) is not allowed; give two ascending angles (rad), at most 25.13 apart",
        ),
        (lambda: fm.Joint(Z, angle_range=(-90.0, 90.0)), "Joint.angle_range: (-90.0, 90.0) is not allowed; give two"),
        (
            lambda: fm.Joint(Z, passive=True, angle_range=(-1.0, 1.0)),
            "Joint.angle_range: (-1.0, 1.0) is not allowed; give none for a passive joint",
        ),
        (lambda: replace(MOTOR, speed_limit=math.nan), "Motor.speed_limit: nan is not allowed; give a finite number"),
    ],
)
def test_what_no_motor_is(make, line):
    assert refusal(make).startswith(line)


def test_an_error_in_a_file_names_the_motor_of_the_joint():
    data = to_plain(fm.Arm([LINK], [fm.Joint(Z, motor=MOTOR)]))
    data["joints"][0]["motor"]["gear_ratio"] = -2.0
    assert refusal(lambda: find_arm(data)).startswith("arm.joints[0].motor.gear_ratio: -2.0 is not allowed")
    data["joints"][0]["motor"] = {"gear_ratio": 2.0, "torque_constant": 0.1}
    assert refusal(lambda: find_arm(data)).startswith("arm.joints[0].motor.rotor_inertia: missing")

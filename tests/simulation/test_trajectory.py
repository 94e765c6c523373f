"""Trajectory: the audit of energy rings where an integrator invents or loses it, and only there; a file keeps it."""

import csv
from dataclasses import replace

import numpy as np
import pytest

import flexman_gym as fm
from flexman_gym.envs.env import FlexManEnv
from flexman_gym.model.dynamics import tip_jacobian
from flexman_gym.model.linearization import MEASUREMENT_UNITS, LinearMeasurements

from oracles.assertions import refusal

SCENE = fm.catalog.paper_scene("ff")


def test_the_turnover_is_the_largest_energy_work_or_loss_so_far():
    arm = replace(fm.catalog.one_link(gravity=(0.0, 0.0, -9.81), axis=(0.0, 1.0, 0.0)), modal_damping_ratio=0.1)
    choice = fm.ModelChoice(True, 2)
    scene = fm.Scene(arm, choice, fm.ConstantTorque([0.0]), fm.Initial([0.0], [0.0]), 2.0, 0.01)
    result = fm.simulate(scene)
    assert result.energy_turnover[0] == 0.0 and (np.diff(result.energy_turnover) >= 0.0).all()
    fallen = arm.links[0].mass * 9.81 * arm.links[0].length / 2.0  # of its centre, when it hangs straight
    assert result.energy_turnover[-1] == pytest.approx(fallen, rel=0.05)


@pytest.mark.slow
def test_the_reference_method_raises_no_alarm():
    result = fm.simulate(SCENE)
    assert result.energy_alarm() is None and result.energy_alarm(1e-5) is None


def test_a_method_that_eats_vibration_raises_it_when_the_loss_passes_the_level():
    result = fm.simulate(SCENE, method="ros2", step=0.02)
    assert result.status == "ok"
    lost = np.abs(result.energy_residual) / result.energy_turnover[-1]
    for level in (0.01, 0.05, 0.1):
        alarm = result.energy_alarm(level)
        assert (lost[result.time < alarm] <= level).all() and lost[result.time == alarm] > level
    assert result.energy_alarm(2.0 * lost.max()) is None


def test_the_environment_raises_it_too():
    alarms = {}
    for step, level in ((0.005, 0.01), (0.02, 1e-4)):
        env = FlexManEnv(step=step, energy_alarm=level)
        env.reset(seed=0)
        infos = [env.step(np.array([1.0, -1.0, 1.0]) * (-1) ** (i // 10))[4] for i in range(40)]
        alarms[step] = [info["energy_alarm"] for info in infos]
        residual, turnover = infos[-1]["energy_residual"], env.simulator.energy_turnover
        assert alarms[step][-1] == (abs(residual) > level * turnover)
    assert not any(alarms[0.005]) and any(alarms[0.02])


def test_a_csv_file_gives_every_number_back_under_its_name_and_unit(tmp_path):
    result = fm.simulate(replace(SCENE, duration=0.1))
    result.to_csv(tmp_path / "run.csv")
    with (tmp_path / "run.csv").open(newline="") as file:
        head, *lines = csv.reader(file)
    table = dict(zip(head, np.array(lines, dtype=float).T, strict=True))
    assert head[:4] == ["time (s)", "tip_x (m)", "tip_y (m)", "tip_z (m)"] and len(table) == len(head) == 51
    assert np.array_equal(table["time (s)"], result.time)
    assert np.array_equal(table["tip_velocity_z (m/s)"], result.tip_velocity[:, 2])
    assert np.array_equal(table["deflection_y (m)"], result.deflection[:, 1])
    for joint in range(3):
        assert np.array_equal(table[f"joint_angle_{joint + 1} (rad)"], result.joint_angles[:, joint])
        assert np.array_equal(table[f"motor_angle_{joint + 1} (rad)"], result.motor_angles[:, joint])
    for name in ("energy", "moving_energy", "work", "dissipation", "energy_residual"):
        assert np.array_equal(table[f"{name} (J)"], getattr(result, name))


@pytest.fixture(scope="module")
def trajectory():
    """A quarter of a second of the paper's arm."""
    scene = fm.catalog.paper_scene("ff")
    return fm.simulate(fm.Scene(scene.arm, scene.model, scene.torque, scene.initial, 0.25, 0.05), step=0.005)


def test_readings_are_what_the_state_says(trajectory):
    result, states, model = trajectory.readings, trajectory.states, trajectory.model
    n, d = model.n_joints, model.n_dof
    assert result.keys() == MEASUREMENT_UNITS.keys()
    assert result["motor_angles"] == pytest.approx(trajectory.motor_angles, abs=0)
    assert result["motor_rates"] == pytest.approx(states[:, d + model.motor_columns], abs=0)
    assert result["joint_twists"] == pytest.approx(trajectory.motor_angles - states[:, :n], abs=1e-15)
    assert result["joint_twist_rates"] == pytest.approx(result["motor_rates"] - states[:, d : d + n], abs=1e-15)
    speeds = np.hstack([states[:, d:], np.zeros_like(states[:, d:])])  # a reading of a linear quantity's rate
    assert LinearMeasurements(model).measure(speeds)["link_deflections"] == pytest.approx(
        result["link_deflection_rates"], abs=0
    )
    for row, state in enumerate(states):
        for link in range(n):
            radius = np.sqrt(model.arm.links[link].second_moment_y / model.arm.links[link].area)
            about_y = fm.curvature(model, state, link, 0.0)[1]
            assert result["root_strains"][row, 3 * link + 1] == pytest.approx(radius * about_y, abs=1e-15)
    assert np.abs(result["root_strains"][-1]).max() > 1e-4


def test_columns_name_all_readings_with_units(trajectory):
    columns = trajectory.columns()
    for link in (1, 2, 3):
        for part, place in (("_y", 0), ("_z", 1)):
            column = columns[f"link_deflection_{link}{part} (m)"]
            assert np.array_equal(column, trajectory.readings["link_deflections"][:, 2 * (link - 1) + place])
        assert np.array_equal(columns[f"motor_rate_{link} (rad/s)"], trajectory.readings["motor_rates"][:, link - 1])
        for part, place in (("_y", 0), ("_z", 1), ("_torsion", 2)):
            column = columns[f"root_strain_{link}{part} (1)"]
            assert np.array_equal(column, trajectory.readings["root_strains"][:, 3 * (link - 1) + place])
    assert len({len(column) for column in columns.values()}) == 1


STRIP = fm.Link.strip(0.5, 0.04, 0.003)
Z, Y = (0.0, 0.0, 1.0), (0.0, -1.0, 0.0)
INERTIA = ((3e-3, 2e-4, -1e-4), (2e-4, 2e-3, 1e-4), (-1e-4, 1e-4, 4e-3))
BODIES = [fm.LumpedMass(0.2, 0.21, INERTIA, (0.01, 0.04, -0.03)), fm.LumpedMass(0.1, 0.5)]
TURNED = ((0.0, 0.0, -1.0), (0.0, 1.0, 0.0), (1.0, 0.0, 0.0))
ARM = fm.Arm(
    [replace(STRIP, masses=BODIES), fm.Link.tube(0.4, 0.02, 0.001), replace(STRIP, orientation=TURNED)],
    [fm.Joint(Z, 0.02, 60.0, 0.01), fm.Joint(Y, 0.01, viscous_friction=0.01), fm.Joint(Y, 0.01, 30.0, 0.02)],
    fm.Payload(0.3), gravity=(1.0, -2.0, -9.0), modal_damping_ratio=0.01,
)  # fmt: skip
PUSH = [fm.Signal(1.0, 2.0, 3.0), fm.Signal(-3.0), fm.Signal(0.0, 4.0, 2.0)]
SWAY = [fm.Signal(0.0, 1.0, 2.0), fm.Signal(0.5), fm.Signal(0.0, 3.0, 1.0)]


def moved(arm=ARM, duration=0.1, **choice):
    """A trajectory of the arm under torques, a push on its tip and a base that sways."""
    n = arm.n_joints
    start = fm.Initial([0.2, 0.5, -0.7][:n], [1.0, -2.0, 1.5][:n])
    scene = fm.Scene(
        arm, fm.ModelChoice(True, 2, **choice), fm.ConstantTorque([0.5, 2.0, -1.0][:n]), start, duration, duration / 5,
        tip_force=PUSH, base_acceleration=SWAY,
    )  # fmt: skip
    return fm.simulate(scene, method="midpoint_3", step=duration / 20)


CHOICES = [{}, {"stiffening": True}, {"rotary_inertia": False}, {"spinning_rotors": True, "modes": 3}]


@pytest.mark.parametrize("choice", CHOICES)
def test_energies_of_the_parts_are_the_energy_of_the_arm(choice):
    """The payload has an inertia and a centre of mass beside the tip."""
    run = moved(replace(ARM, payload=fm.Payload(0.3, INERTIA, (0.02, 0.01, -0.01))), **choice)
    parts = run.energies()
    total = sum(values.sum(axis=1) for values in parts.values())
    sizes = sum(np.abs(values).sum(axis=1) for values in parts.values())
    assert (np.abs(total - run.energy) <= 1e-12 * sizes).all()
    assert {name: values.shape for name, values in parts.items()}["link_kinetic"] == (6, 3)


@pytest.mark.parametrize("choice", CHOICES)
def test_joints_carry_what_their_equations_say(choice):
    """About its axis: spring and damper of a flexible joint; of a rigid one the torque less friction and rotor."""
    run = moved(**choice)
    d, constants, torques = run.model.n_dof, run.model.constants, (0.5, 2.0, -1.0)
    about = np.einsum("tni,ni->tn", run.joint_reactions[:, :, 3:], constants.axis)
    rates, speeds = run.accelerations, run.states[:, d:]
    for i, joint in enumerate(ARM.joints):
        m = run.model.motor_columns[i]
        if joint.stiffness:
            expected = joint.stiffness * (run.states[:, m] - run.states[:, i])
            expected += joint.damping * (speeds[:, m] - speeds[:, i])
        elif choice.get("spinning_rotors"):
            continue  # the rotor turns with the link before, too
        else:
            expected = torques[i] - joint.viscous_friction * speeds[:, i] - joint.rotor_inertia * rates[:, i]
        assert about[:, i] == pytest.approx(expected, rel=1e-10, abs=1e-10 * np.abs(run.joint_reactions[..., 3:]).max())


@pytest.mark.parametrize("choice", [{}, {"stiffening": True}, {"rotary_inertia": False}])
def test_the_end_of_a_link_carries_what_comes_next(choice):
    """At a tip: the reaction of the next joint, turned into another frame; at the last the payload and the push."""
    run = moved(**choice)
    size = np.abs(run.joint_reactions).max()
    end = run.section_forces(1, [ARM.links[1].length])[:, 0]  # of link 0 the lumped mass at the tip is outboard
    for part in (slice(0, 3), slice(3, 6)):
        lengths = np.linalg.norm(end[:, part], axis=1), np.linalg.norm(run.joint_reactions[:, 2, part], axis=1)
        assert lengths[0] == pytest.approx(lengths[1], rel=1e-10, abs=1e-10 * size)
    end = run.section_forces(2, [0.5])[:, 0]
    for row, time in enumerate(run.time):
        push, sway = (np.array([signal_at(each, time) for each in signals]) for signals in (PUSH, SWAY))
        relative = run_tip_acceleration(run, row)
        force = 0.3 * (relative + sway - ARM.gravity) - push
        assert np.linalg.norm(end[row, :3]) == pytest.approx(np.linalg.norm(force), rel=1e-9)
    assert np.abs(end[:, 3:]).max() < 1e-10 * size


def signal_at(signal, time):
    """Value of a sine with an offset."""
    return signal.offset + signal.amplitude * np.sin(2.0 * np.pi * signal.frequency_hz * time + signal.phase)


def run_tip_acceleration(run, row):
    """The acceleration of the tip relative to the base, J a + J' v by a difference along the motion."""
    d, model, state, rate = run.model.n_dof, run.model, run.states[row], run.accelerations[row]

    def velocity(t):
        x, v = state[:d] + t * state[d:] + t * t / 2.0 * rate, state[d:] + t * rate
        return tip_jacobian(model, x) @ v

    h = 1e-4
    return sum(w * (velocity(k * h) - velocity(-k * h)) / (2.0 * k * h) for k, w in ((1, 1.5), (2, -0.6), (3, 0.1)))


def test_a_rigid_rod_that_spins_is_pulled_and_bent_by_its_own_mass():
    """N = rho A w^2 (L^2 - s^2) / 2; under its weight Q = rho A g (L - s), M = rho A g (L - s)^2 / 2."""
    rate, line, places = 5.0, STRIP.density * STRIP.area, np.array([0.0, 0.1, 0.27, 0.5])
    arm = fm.Arm([STRIP], [fm.Joint(Z)], gravity=(0.0, 0.0, -9.81))
    scene = fm.Scene(arm, fm.ModelChoice(False, 2, rotary_inertia=False), fm.ConstantTorque([0.0]),
                     fm.Initial([0.3], [rate]), 0.1, 0.1)  # fmt: skip
    loads, left = fm.simulate(scene).section_forces(0, places)[-1], 0.5 - places
    assert loads[:, 0] == pytest.approx(line * rate**2 * (0.25 - places**2) / 2.0, rel=1e-10, abs=1e-12)
    assert loads[:, 2] == pytest.approx(-line * 9.81 * left, rel=1e-10, abs=1e-12)
    assert loads[:, 4] == pytest.approx(line * 9.81 * left**2 / 2.0, rel=1e-10, abs=1e-12)
    assert np.abs(loads[:, [1, 3, 5]]).max() < 1e-10


@pytest.mark.slow
def test_bending_moments_are_those_of_the_curvature():
    """Of a light strip with a heavy tip at rest: E I v'' about z and -E I w'' about y."""
    light = replace(STRIP, density=1e-3)
    arm = fm.Arm([light], [fm.Joint(Z)], fm.Payload(0.05), gravity=(0.0, -0.6, -5.0))
    model = fm.build_model(arm)
    state = fm.rest_state(model, [0.0])
    scene = fm.Scene(arm, model.choice, fm.ConstantTorque([0.0]), fm.Initial([0.0], [0.0], state), 0.01, 0.01,
                     prescribed=[fm.Signal()])  # fmt: skip
    run = fm.simulate(scene, method="ros2", step=1e-3)
    places = [0.0, 0.12, 0.4]
    loads = run.section_forces(0, places)[0]
    for load, place in zip(loads, places, strict=True):
        _, about_y, about_z = fm.curvature(model, state, 0, place)
        bent = [
            light.youngs_modulus * light.second_moment_y * about_y,
            light.youngs_modulus * light.second_moment_z * about_z,
        ]
        assert load[4:] == pytest.approx(bent, rel=2e-3)


def test_foreshortening_is_in_the_sections_too():
    """Halfway the inboard and the outboard part of a bent link agree as well as its stations integrate."""
    run = moved(stiffening=True)
    flat = run.section_forces(1, [0.0, 1e-9, 0.2, 0.4])
    assert -flat[:, 0] == pytest.approx(run.joint_reactions[:, 1], rel=1e-9, abs=1e-9)
    assert flat[:, 1] == pytest.approx(flat[:, 0], abs=1e-5 * np.abs(flat).max())


def test_what_is_not_known_is_refused():
    run = moved()
    assert refusal(lambda: run.section_forces(3, [0.0])).startswith("link: 3 is not allowed; give a whole number")
    assert refusal(lambda: run.section_forces(0, [0.6])).startswith(
        "positions[0]: 0.6 is not allowed; give a number from"
    )
    lines = repr(run).splitlines()
    assert len(lines) <= 5 and lines[0].startswith("<Trajectory: ok, 0.1 s, 6 outputs, 3 joints")

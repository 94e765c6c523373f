"""Trajectory: the audit of energy rings where an integrator invents or loses it, and only there; a file keeps it."""

import csv
from dataclasses import replace

import numpy as np
import pytest

import flexman_gym as fm
from flexman_gym.envs.env import FlexManEnv

SCENE = fm.catalog.paper_scene("ff")


def test_the_turnover_is_the_largest_energy_work_or_loss_so_far():
    arm = replace(fm.catalog.one_link(gravity=(0.0, 0.0, -9.81), axis=(0.0, 1.0, 0.0)), modal_damping_ratio=0.1)
    choice = fm.ModelChoice(True, 2)
    scene = fm.Scene(arm, choice, fm.ConstantTorque([0.0]), fm.Initial([0.0], [0.0]), 2.0, 0.01)
    result = fm.simulate(scene)
    assert result.energy_turnover[0] == 0.0 and (np.diff(result.energy_turnover) >= 0.0).all()
    fallen = arm.links[0].mass * 9.81 * arm.links[0].length / 2.0  # of its centre, when it hangs straight
    assert result.energy_turnover[-1] == pytest.approx(fallen, rel=0.05)


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


def test_the_level_is_a_positive_number():
    with pytest.raises(ValueError, match="level: 0 is not allowed"):
        fm.simulate(replace(SCENE, duration=0.1)).energy_alarm(0)
    with pytest.raises(ValueError, match=r"energy_alarm: -1\.0 is not allowed"):
        FlexManEnv(energy_alarm=-1.0)


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

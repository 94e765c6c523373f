"""Flaws of sensors with the units of data sheets."""

import gymnasium as gym
import numpy as np
import pytest

import flexman_gym as fm
from flexman_gym.envs.config.configuration import Configuration
from flexman_gym.envs.config.plant import make_plant
from flexman_gym.envs.sensors.flaws import Flaws
from flexman_gym.model.model import build_model

from oracles.assertions import refusal


def readings(sensors, name, steps=40):
    """Return readings (T, size) of a sensor under random torques, and the true values."""
    env = gym.make("FlexPlanar-v0", sensors=sensors, info_keys=[name], horizon=1.0)
    random, found, true = np.random.default_rng(2), [], []
    observation, info = env.reset(seed=3)
    for _ in range(steps):
        found.append(observation[: len(info[name].ravel())].astype(float))
        true.append(np.ravel(info[name]).copy())
        observation, *_, info = env.step(random.uniform(-0.3, 0.3, 2))
    return np.array(found), np.array(true)


def test_an_encoder_has_its_counts_in_a_turn():
    found, true = readings([{"kind": "motor_encoders", "quantisation": "4096 counts"}], "motor_angles")
    step = 2.0 * np.pi / 4096
    angles = found[:, :2]
    assert np.abs(angles / step - np.round(angles / step)).max() < 1e-3 and np.abs(angles - true).max() < 0.51 * step


def test_counts_of_a_geared_motor_are_those_of_a_turn_of_its_shaft():
    motor = fm.Motor(50.0, 0.04, 1e-5, current_limit=3.0)
    arm = fm.Arm([fm.Link.rod(0.5, 0.02)], [fm.Joint((0, 0, 1), stiffness=60.0, motor=motor)])
    sensors = [{"kind": kind, "quantisation": "1000 counts"} for kind in ("motor_encoders", "joint_encoders")]
    configuration = Configuration("FlexOne-v0", {"arm": arm, "sensors": sensors})
    errors = make_plant(configuration, build_model(arm, 1)).measured()
    step = 2.0 * np.pi / 1000
    assert errors["motor_angles"][1] == pytest.approx(step / 50.0 / np.sqrt(12.0))
    assert errors["joint_twists"][1] == pytest.approx(step / np.sqrt(12.0))
    env = gym.make("FlexOne-v0", arm=arm, sensors=sensors)
    angles = [env.reset(seed=seed)[0][0].astype(float) * env.unwrapped.episodes.sensors.bound[0] for seed in range(5)]
    assert np.abs(np.array(angles) / (step / 50.0) % 1.0 - 0.5).min() > 0.4


def test_noise_has_the_deviation_of_the_data_sheet():
    found, true = readings([{"kind": "motor_encoders", "noise": "0.2 mrad"}], "motor_angles", steps=90)
    deviation = np.std(found[:, :2] - true)
    assert deviation == pytest.approx(2e-4, rel=0.2)


@pytest.mark.parametrize(("text", "unit", "value"), [
    ("0.2 mrad", "rad", 2e-4), ("1 deg/s", "rad/s", np.pi / 180.0), ("5 microstrain", "1", 5e-6),
    ("0.1 g", "m/s^2", 0.980665),
])  # fmt: skip
def test_an_amount_is_the_fraction_of_the_range_in_its_unit(text, unit, value):
    ranges = np.array([4.0, 0.5])
    assert Flaws(noise=text).fraction("noise", [unit, "other"], ranges) == pytest.approx([value / 4.0, 0.0])
    assert Flaws(noise=0.01).fraction("noise", [unit, "other"], ranges) == 0.01


def test_controllers_are_designed_with_the_amounts():
    configuration = Configuration("FlexPlanar-v0", {"sensors": [{"kind": "strain", "noise": "2 microstrain"}]})
    errors = make_plant(configuration, build_model(configuration.arm, 1)).measured()
    assert errors["root_strains"][1] == pytest.approx(2e-6) and not errors["motor_angles"][1].any()


@pytest.mark.parametrize("flaws", [
    {"noise": "2 kg"}, {"noise": "much"}, {"noise": "4096 counts"}, {"quantisation": "-3 counts"}, {"bias": "0 mrad"},
])  # fmt: skip
def test_an_amount_without_a_known_unit_is_refused(flaws):
    message = refusal(lambda: Flaws(**flaws))
    assert message.startswith(f"sensors.{next(iter(flaws))}: ") and "mrad" in message


def test_an_amount_in_a_unit_that_no_reading_has_is_refused():
    message = refusal(lambda: gym.make("FlexPlanar-v0", sensors=[{"kind": "strain", "noise": "0.2 mrad"}]))
    assert message.startswith("sensors.noise: '0.2 mrad' is not allowed") and message.endswith("in units of strain")


def test_files_keep_amounts_as_written(tmp_path):
    configuration = Configuration(
        "FlexPlanar-v0", {"sensors": [{"kind": "motor_encoders", "quantisation": "4096 counts"}]}
    )
    configuration.save(tmp_path / "own.yaml")
    assert "4096 counts" in (tmp_path / "own.yaml").read_text()
    assert Configuration.load(tmp_path / "own.yaml") == configuration

"""Sensors: each says what strain, tip acceleration and the view say, with the flaws that its instrument has."""

import warnings
from types import SimpleNamespace

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

import flexman_gym as fm
from flexman_gym.envs.env import FlexManEnv
from flexman_gym.envs.sensors import SENSORS, Instrument, Quantities, find_sensors, plain_sensors
from flexman_gym.envs.sensors.sensor import measurement_ranges
from flexman_gym.envs.vector_env import FlexManVectorEnv

from oracles.assertions import same_alone_and_among_others
from oracles.random_inputs import ALL_PARTS, FLAWED


def parts(env, observation):
    """The newest entries of an observation by name."""
    return {name: observation[place].astype(float) for name, place in env.unwrapped.sensors.slices.items()}


def moved(env, steps=40, seed=1):
    """Observation and last action after some random ones."""
    observation, _ = env.reset(seed=seed)
    random = np.random.default_rng(seed)
    for _ in range(steps):
        action = random.uniform(-1.0, 1.0, env.action_space.shape).astype(np.float32)
        observation = env.step(action)[0]
    return observation, action


@pytest.mark.parametrize("name", ["FlexRRR-v0", "FlexRRR-Gravity-v0", "FlexPlanar-v0"])
def test_strain_is_what_gauges_on_both_sides_of_the_root_read(name):
    env = FlexManEnv(name=name, sensors="strain")
    result = moved(env)[0].astype(float).reshape(-1, 3)
    model, state = env.simulator.model, env.simulator.state
    for link, (along_y, along_z, around) in enumerate(result):
        section = model.arm.links[link]
        y, z = np.sqrt(section.second_moment_z / section.area), np.sqrt(section.second_moment_y / section.area)
        sides = [fm.strain(model, state, link, 0.0, y=side * y) for side in (1.0, -1.0)]
        assert along_y == pytest.approx((sides[0] - sides[1]) / 2.0, rel=1e-5, abs=1e-10)
        sides = [fm.strain(model, state, link, 0.0, z=side * z) for side in (1.0, -1.0)]
        assert along_z == pytest.approx((sides[0] - sides[1]) / 2.0, rel=1e-5, abs=1e-10)
        twist = fm.curvature(model, state, link, 0.0)[0]
        assert around == pytest.approx(np.hypot(y, z) * twist, rel=1e-5, abs=1e-10)
    assert np.abs(result).max() > 1e-5


@pytest.mark.slow
@pytest.mark.parametrize("name", ["FlexRRR-v0", "FlexRRR-Gravity-v0", "FlexPlanar-v0"])
def test_the_accelerometer_says_the_acceleration_of_the_tip(name):
    env = FlexManEnv(name=name, sensors=("accelerometer", Quantities(("specific_force",))))
    observation, action = moved(env)
    result = parts(env, observation)
    torque = action.astype(float) * env.torque_limit
    expected = fm.tip_acceleration(env.simulator.model, env.simulator.state, torque)
    assert result["tip_acceleration"] == pytest.approx(expected, rel=1e-5, abs=1e-4) and np.abs(expected).max() > 0.1
    felt = expected - np.array(env.simulator.model.arm.gravity)  # the same vector along other axes
    assert np.linalg.norm(result["specific_force"]) == pytest.approx(np.linalg.norm(felt), rel=1e-5)


def test_encoders_tip_and_command_say_what_the_view_says():
    env = FlexManEnv(name="FlexRRR-Track-v0", sensors=("motor_encoders", "joint_encoders", "command"))
    result = parts(env, moved(env)[0])
    state, model, view = env.simulator.state, env.simulator.model, env.episodes.view
    joints, rates = state[:3], state[model.n_dof : model.n_dof + 3]
    assert result["motor_angles"] == pytest.approx(state[model.motor_columns], abs=1e-6)
    assert result["motor_angles"] - result["joint_twists"] == pytest.approx(joints, abs=1e-6)
    assert result["motor_rates"] - result["joint_twist_rates"] == pytest.approx(rates, abs=1e-5)
    assert result["angle_command"] == pytest.approx(view.goal_angles[0], abs=1e-6)
    assert result["tip_command"] == pytest.approx(view.target[0], abs=1e-5)
    assert result["tip_velocity_command"] == pytest.approx(view.target_velocity[0], abs=1e-5)
    assert result["rate_command"] == pytest.approx(view.goal_rates[0], abs=1e-6)
    assert np.array_equal(view.joint_angles[0], joints) and np.array_equal(view.joint_rates[0], rates)


def test_a_camera_sees_every_other_period_and_a_period_late():
    env = FlexManEnv(sensors="tip")
    observation, info = env.reset(seed=1)
    tips, seen = [info["tip"]], [observation]
    for _ in range(20):
        observation, _, _, _, info = env.step(np.full(3, 0.5))
        tips.append(info["tip"])
        seen.append(observation)
    for period in range(1, 21):
        taken = period - 1 - (period - 1) % 2
        assert seen[period] == pytest.approx(tips[taken], abs=1e-5), period
    assert np.abs(np.diff(tips, axis=0)).max() > 1e-3


# Flaws


def flawed(name="FlexRRR-v0", **flaws):
    """An environment that sees its motors through an instrument."""
    return FlexManEnv(name=name, sensors={"kind": "motor_encoders", **flaws}, horizon=100.0)


def readings(env, steps=300, seed=1):
    """What is seen (T, 6) and what is true, without torques from another start than zero."""
    seen, truth = [env.reset(seed=seed)[0].astype(float)], []
    view = env.episodes.view
    truth.append(np.concatenate([view.motor_angles[0], view.motor_rates[0]]))
    random = np.random.default_rng(0)
    for _ in range(steps):
        seen.append(env.step(0.2 * random.uniform(-1.0, 1.0, 3))[0].astype(float))
        truth.append(np.concatenate([view.motor_angles[0], view.motor_rates[0]]))
    return np.array(seen), np.array(truth)


def test_noise_of_a_part_is_normal_and_its_own():
    env = flawed(noise=0.01)
    seen, truth = readings(env)
    off = (seen - truth) / env.sensors.bound / 0.01
    assert abs(off.mean()) < 5 / np.sqrt(off.size) and off.std() == pytest.approx(1.0, abs=5 / np.sqrt(2 * off.size))
    assert np.abs(np.corrcoef(off.T) - np.eye(6)).max() < 5 / np.sqrt(len(off))
    assert not np.array_equal(seen[0], readings(env, 1, seed=2)[0][0])
    assert np.array_equal(seen, readings(flawed(noise=0.01))[0]), "the seed of a reset decides"


def test_bias_stays_throughout_an_episode_and_changes_with_the_next():
    env, result = flawed(bias=0.01), []
    for seed in range(40):
        seen, truth = readings(env, 3, seed)
        off = (seen - truth) / env.sensors.bound
        assert np.ptp(off, axis=0).max() < 1e-6
        result.append(off[0])
    assert 0.009 < np.abs(result).max() <= 0.01 + 1e-6
    assert abs(np.mean(result)) < 5 * 0.01 / np.sqrt(3 * np.size(result))


def test_quantised_numbers_are_the_nearest_multiples():
    env = flawed(quantisation=0.001)
    seen, truth = readings(env)
    step = 0.001 * env.sensors.bound
    assert np.abs(seen / step - np.round(seen / step)).max() < 1e-2
    assert (np.abs(seen - truth) <= 0.501 * step).all() and np.abs(seen - truth).max() > 0.4 * step.min()


@pytest.mark.parametrize("delay", [1, 3])
def test_a_delayed_sample_is_that_of_so_many_periods_ago(delay):
    seen, truth = readings(flawed(delay=delay), 30)
    assert seen[delay:] == pytest.approx(truth[:-delay], abs=1e-5)
    assert seen[:delay] == pytest.approx(np.repeat(truth[:1], delay, 0), abs=1e-5), "the first stands for those before"


def test_a_dropped_sample_leaves_the_one_before():
    seen, truth = readings(flawed(dropped=0.3), 600)
    fresh = np.isclose(seen, truth, atol=1e-6).all(axis=1)
    assert fresh[0] and fresh.mean() == pytest.approx(0.7, abs=5 * np.sqrt(0.21 / 600))
    for row in np.flatnonzero(~fresh):
        assert np.array_equal(seen[row], seen[row - 1])


def test_a_sample_is_dropped_whatever_its_noise_is():
    """The noise of the samples that arrive is that of all: its mean is 0 and its deviation 1, in every number."""
    env = flawed(noise=0.01, dropped=0.3)
    seen, truth = readings(env, 600)
    new = np.concatenate([[True], (np.diff(seen, axis=0) != 0.0).any(axis=1)])
    off = ((seen - truth) / env.sensors.bound / 0.01)[new]
    assert new.mean() == pytest.approx(0.7, abs=5 * np.sqrt(0.21 / 600))
    assert np.abs(off.mean(axis=0)).max() < 5 / np.sqrt(len(off))
    assert np.abs(off.std(axis=0) - 1.0).max() < 5 / np.sqrt(2 * len(off))


def test_what_is_derived_follows_what_was_measured():
    """A late full state has the posture errors and nearness of then, for the goal of now."""
    env = FlexManEnv(sensors={"kind": "full", "delay": 2})
    env.reset(seed=3)
    tips, angles = [], []
    for step in range(10):
        tips.append(env.episodes.view.tip[0].copy())
        angles.append(env.episodes.view.motor_angles[0].copy())
        observation, _, _, _, info = env.step(np.full(3, 0.8))
        if step >= 1:
            result = parts(env, observation)
            error = info["target"] - tips[step - 1]
            assert result["target_error"] == pytest.approx(error, abs=1e-5)
            assert result["target_nearness"] == pytest.approx(error / (0.1 + np.linalg.norm(error)), abs=1e-5)
            assert result["angle_errors"] == pytest.approx(info["goal_angles"] - angles[step - 1], abs=1e-5)


def test_an_instrument_ends_at_its_range_and_no_episode_with_it():
    sensors = (Instrument(Quantities(("tip_acceleration",)), noise=1.0), "strain")
    env = FlexManEnv(sensors=sensors, randomisation={"tip_impulse": (20.0, 20.0), "impulse_gap": 0.1})
    env.reset(seed=0)
    ends = measurement_ranges(env.episodes.view, env.configuration.limits)["tip_acceleration"]
    values = []
    for _ in range(100):
        observation, _, terminated, _, info = env.step(np.zeros(3))
        assert observation in env.observation_space
        values.append(parts(env, observation)["tip_acceleration"])
        if terminated:
            assert "acceleration" not in info["failure"] and "strain" not in info["failure"]
            break
    assert (np.abs(values) == ends.astype(np.float32)).any()


def test_quantities_and_instruments_read_no_further_than_their_range():
    """Of both signs: what is far beyond reads as the end of the range."""
    env = FlexManEnv(sensors={"kind": "full", "noise": 1.0})
    env.reset(seed=0)
    for _ in range(30):
        observation, *_, info = env.step(np.zeros(3))
        assert observation in env.observation_space and info["failure"] == ""
    angles = observation[env.sensors.slices["motor_angles"]]
    assert np.abs(angles).max() <= 4.0
    gauge, view = Quantities(("tip_acceleration",)), env.episodes.view
    end, out = gauge.entries(view, env.configuration.limits)[0].bound, np.zeros((1, 3))
    gauge.read(SimpleNamespace(tip_acceleration=np.array([[1e4, -1e4, 3.0]])), out)
    assert out[0].tolist() == [end[0], -end[1], 3.0]


# Names


def test_names_and_flaws_are_kept_in_files():
    for value in (*SENSORS, "lab", FLAWED, {"kind": "tip", "noise": 0.01}, {"kind": "tip", "every": 1}, ALL_PARTS):
        result = find_sensors(value)
        assert find_sensors(plain_sensors(result)) == result, value
    assert plain_sensors(find_sensors("lab")) == ["motor_encoders", "joint_encoders", "strain", "command"]
    assert plain_sensors(find_sensors({"kind": "full", "delay": 1})) == [{"kind": "full", "delay": 1}]


def test_info_tells_quantities_by_name():
    names = ("root_strains", "tip_acceleration", "joint_angles", "motor_rates", "deflection")
    env, many = FlexManEnv(info_keys=names), FlexManVectorEnv(2, info_keys=names)
    info, infos = env.reset(seed=1)[1], many.reset(seed=1)[1]
    for _ in range(3):
        for name in names:
            assert np.array_equal(info[name], infos[name][0]) and infos[f"_{name}"].all()
            assert np.array_equal(info[name], getattr(env.episodes.view, name)[0]), name
        info, infos = env.step(np.full(3, 0.3))[4], many.step(np.full((2, 3), 0.3))[4]


STILL = {"start": [0.3, 0.4, -0.5], "goal_angles": [0.3, 0.4, -0.5]}


def test_what_is_derived_is_as_uncertain_as_what_is_measured():
    """Nearness, error and the fine scale all tell of one tip, which noise has moved by centimetres."""
    env = FlexManEnv(sensors=("full", "fine"), randomisation={"sensor_noise": (0.002, 0.002)})
    observation, info = env.reset(seed=3, options=STILL)
    off = []
    for _ in range(100):
        parts = {name: observation[place].astype(float) for name, place in env.sensors.slices.items()}
        error = parts["target_error"]
        near = parts["target_nearness"]
        assert near == pytest.approx(error / (0.1 + np.sqrt(error @ error)), rel=1e-5, abs=1e-6)
        assert np.sinh(parts["fine_target_error"]) * 8.5 / 425 == pytest.approx(error, rel=1e-4, abs=1e-6)
        assert parts["angle_errors"] == pytest.approx(info["goal_angles"] - parts["motor_angles"], abs=1e-5)
        off.append(error - (info["target"] - info["tip"]))
        observation, _, _, _, info = env.step(np.zeros(3))
    spread = 0.002 * 1.25 * 8.5  # of the tip's range
    assert np.std(off) == pytest.approx(spread, rel=0.15)


SETS = {
    "full": "full", "fine": "fine", "servo": "servo", "lab": "lab", "all": ALL_PARTS,
    "flawed": (FLAWED, "accelerometer"), "state": "state",
}  # fmt: skip


@pytest.mark.feature
@pytest.mark.slow
@pytest.mark.parametrize("kind", SETS)
@pytest.mark.parametrize("name", ["FlexOne-v0", "FlexPlanar-Hold-v0", "FlexRRR-Gravity-v0", "FlexRRR-Track-v0"])
def test_every_set_keeps_the_contracts_of_both_libraries(name, kind):
    checker = pytest.importorskip("stable_baselines3.common.env_checker")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        check_env(gym.make(name, sensors=SETS[kind]).unwrapped)
        if kind != "state":  # whose bounds the checker finds too wide
            checker.check_env(gym.make(name, sensors=SETS[kind]))


@pytest.mark.slow
@pytest.mark.parametrize("history", [1, (0.1, 0.5)])
@pytest.mark.parametrize("kind", SETS)
@pytest.mark.parametrize("name", ["FlexRRR-Track-v0", "FlexPlanar-Hold-v0", "FlexRRR-Gravity-v0"])
def test_one_arm_and_many_have_the_same_bits(name, kind, history):
    settings = {
        "horizon": 0.5, "sensors": SETS[kind], "action_repeat": 2, "history": history,
        "randomisation": {"sensor_noise": (0.0, 0.01), "delay": (0, 2), "payload_mass": (0.0, 0.2)},
    }  # fmt: skip
    same_alone_and_among_others(name, **settings)


@pytest.mark.parametrize("kind", ["flawed", "all"])
def test_a_state_taken_back_goes_on_to_the_same_bits(kind):
    settings = {"sensors": SETS[kind], "history": (0.1,), "randomisation": {"sensor_noise": (0.01, 0.01)}}
    for make in (FlexManEnv, lambda **all: FlexManVectorEnv(3, **all)):
        env = make(name="FlexRRR-Hold-v0", **settings)
        env.reset(seed=4)
        action = np.full(env.action_space.shape, 0.2)
        for _ in range(7):
            env.step(action)
        other = make(name="FlexRRR-Hold-v0", **settings)
        other.set_state(env.get_state())
        for _ in range(7):
            assert np.array_equal(env.step(action)[0], other.step(action)[0])

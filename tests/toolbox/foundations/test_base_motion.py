"""Arm on a deck in a seaway: spectrum, motion of the base, targets in the world, and the same motion as a scene."""

import gymnasium as gym
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import flexman_gym as fm
from flexman_gym.envs.config.configuration import Configuration
from flexman_gym.envs.foundation import plain_foundation
from flexman_gym.simulation.foundation import base_rotation, foundation_motion, rotation_matrix
from flexman_gym.toolbox.foundations.base_motion import COMPONENTS, Sea

from oracles.assertions import refusal

ID = "FlexDeck-v0"


@pytest.fixture(scope="module")
def env():
    return gym.make(ID).unwrapped


def poses(deck, times):
    """Return the motions (T, 6) of the first arm, with rates and accelerations, at times (T,), s."""
    return deck.motion(np.zeros(len(times), dtype=int), times)


def test_significant_amplitudes_and_mean_frequency_are_those_of_the_spectrum():
    """Over many seas the standard deviation is half the significant amplitude; m0, m1 of JONSWAP set the mean period.

    With a peak factor of 3.3 the mean period is 0.834 of the peak period over all frequencies (Carter, Estimation of
    wave spectra from wave height and period, 1982); from 0.6 to 2.5 times the peak it is longer.
    """
    venv = gym.make_vec(ID, 64, "vector_entry_point").unwrapped
    venv.reset(seed=0)
    deck = venv.episodes.foundation
    times = np.linspace(0.0, 400.0, 801)
    samples = np.array([deck.motion(slice(None), np.full(64, time))[0] for time in times])
    sea = Sea()
    expected = np.array([sea.surge, sea.sway, sea.heave, sea.roll, sea.pitch, sea.yaw]) / 2.0
    np.testing.assert_allclose(samples.std(axis=(0, 1)), expected, rtol=0.03)
    rates = deck._drawn[..., 0]
    assert rates.shape == (64, 6, COMPONENTS)
    assert 2.0 * np.pi / rates.mean() / sea.period == pytest.approx(0.87, abs=0.03)
    spread = rates.reshape(64, -1)
    assert len(np.unique(spread)) == spread.size  # no two sines of equal frequency: the sea does not repeat


def test_rates_and_accelerations_of_the_deck_are_derivatives(env):
    env.reset(seed=4)
    deck, times, h = env.episodes.foundation, np.linspace(0.0, 20.0, 9), 1e-4
    _, rate, acceleration = poses(deck, times)
    ahead, behind = poses(deck, times + h), poses(deck, times - h)
    np.testing.assert_allclose(rate, (ahead[0] - behind[0]) / (2.0 * h), atol=1e-7)
    np.testing.assert_allclose(acceleration, (ahead[1] - behind[1]) / (2.0 * h), atol=1e-7)


def test_attitude_is_yaw_then_pitch_then_roll_and_its_rate_the_angular_velocity(env):
    env.reset(seed=4)
    deck, times = env.episodes.foundation, np.linspace(0.0, 20.0, 9)
    pose = poses(deck, times)[0]
    expected = Rotation.from_euler("ZYX", pose[:, [5, 4, 3]]).as_matrix()
    h = 1e-5
    later = Rotation.from_euler("ZYX", poses(deck, times + h)[0][:, [5, 4, 3]])
    spin = (Rotation.from_matrix(expected).inv() * later).as_rotvec() / h
    for k in range(len(times)):
        env.episodes.batch._periods[:] = round(times[k] / env.configuration.control_period)
        deck._set(np.array([0]), env.episodes.batch.time)
        motion = foundation_motion(env.episodes.batch.foundation[0], 0.0)
        np.testing.assert_allclose(motion[:3], expected[k].T @ [0.0, 0.0, -9.81], atol=1e-9)
        np.testing.assert_allclose(motion[3:6], spin[k], atol=1e-5)
        deck._set(np.array([0]), env.episodes.batch.time + h)
        ahead = foundation_motion(env.episodes.batch.foundation[0], 0.0)
        np.testing.assert_allclose(motion[6:], (ahead[3:6] - motion[3:6]) / h, atol=1e-5)


def test_base_acceleration_of_a_period_is_that_in_its_middle_in_the_base_frame(env):
    env.reset(seed=4)
    deck, period = env.episodes.foundation, env.configuration.control_period
    for time in (0.0, 2.0, 5.0):
        deck._set(np.array([0]), np.array([time]))
        pose, _, acceleration = poses(deck, np.array([time + period / 2.0]))
        attitude = Rotation.from_euler("ZYX", pose[:, [5, 4, 3]]).as_matrix()[0]
        np.testing.assert_allclose(deck.accelerations[0], attitude.T @ acceleration[0, :3], atol=1e-12)


def test_target_rests_in_the_world_and_goals_of_the_motors_reach_it(env):
    env.reset(seed=7)
    episodes = env.episodes
    deck, view, seen = episodes.foundation, episodes.view, []
    for _ in range(150):
        env.step(np.zeros(3, dtype=np.float32))
        pose = poses(deck, episodes.batch.time)[0]
        attitude = Rotation.from_euler("ZYX", pose[:, [5, 4, 3]]).as_matrix()[0]
        seen.append(pose[0, :3] + attitude @ view.target[0])
        reached = view.rigid_tips(view.goal_angles)[0] + deck._sag[0]
        np.testing.assert_allclose(reached, view.target[0], atol=1e-6)
    np.testing.assert_allclose(seen, np.repeat(seen[:1], len(seen), axis=0), atol=1e-9)
    assert np.abs(view.goal_rates).max() > 1e-3


def test_arm_on_a_deck_moves_as_a_scene_on_a_rotating_base(env):
    """Angular and linear accelerations of each control period as samples; the scene integrates the attitude itself."""
    env.reset(seed=3)
    episodes, count = env.episodes, 100
    period, start = env.configuration.control_period, episodes.view.state[0].copy()
    rng = np.random.default_rng(0)
    rows, shakes, torques, tips = [], [], [], []
    for _ in range(count):
        action = rng.uniform(-0.05, 0.05, 3).astype(np.float32)
        env.step(action)
        rows.append(foundation_motion(episodes.batch.foundation[0], 0.0))
        shakes.append(episodes.foundation.accelerations[0].copy())
        torques.append(episodes.motors.torques[0].copy())
        tips.append(episodes.view.tip[0].copy())
    times, end = period * np.arange(count + 1), foundation_motion(episodes.batch.foundation[0], period)

    def samples(values, last, hold):
        return [fm.SampledSignal(times, column, hold=hold) for column in np.vstack([values, last]).T]

    pose = poses(episodes.foundation, np.zeros(1))[0]
    quaternion = np.roll(Rotation.from_euler("ZYX", pose[:, [5, 4, 3]]).as_quat()[0], 1)
    configuration, model = env.configuration, episodes.batch.model
    scene = fm.Scene(
        configuration.arm, fm.ModelChoice(True, 2), fm.SampledTorque(times, np.vstack([torques, torques[-1:]])),
        fm.Initial((0.0,) * 3, (0.0,) * 3, state=tuple(start)), count * period, period,
        base_acceleration=samples(shakes, shakes[-1:], "zero"),
        base_angular_acceleration=samples(np.array(rows)[:, 6:], end[None, 6:], "linear"),
        base_attitude=tuple(quaternion), base_angular_velocity=tuple(rows[0][3:6]),
    )  # fmt: skip
    run = fm.simulate(scene, model, method=configuration.method, step=configuration.integration_step / 2.0)
    np.testing.assert_allclose(tips, run.tip[1:], atol=2e-4)
    turned = rotation_matrix(base_rotation(scene).at(times[-1:])[0])[0]
    pose = poses(episodes.foundation, times[-1:])[0]
    expected = Rotation.from_euler("ZYX", pose[:, [5, 4, 3]]).as_matrix()[0]
    np.testing.assert_allclose(turned, expected, atol=1e-6)  # accelerations are linear between the periods
    fixed = fm.Scene(configuration.arm, scene.model, scene.torque, scene.initial, count * period, period)
    still = fm.simulate(fixed, model, step=0.005)
    assert np.abs(still.tip[-1] - run.tip[-1]).max() > 0.02  # m; the deck moves the arm noticeably


@pytest.mark.slow
def test_energy_of_an_arm_on_a_deck_is_balanced():
    env = gym.make(ID, base="pd", step=0.001).unwrapped
    env.reset(seed=5)
    for _ in range(300):
        *_, info = env.step(np.zeros(3, dtype=np.float32))
    view = env.episodes.view
    assert abs(info["energy_residual"]) < 1e-6 * view.energy_turnover[0]
    assert np.abs(env.episodes.batch.rows[0, -2]) > 1.0  # J; work of motors and deck


@pytest.mark.slow
def test_controller_with_moving_goals_holds_the_tip_where_one_with_a_fixed_goal_moves_with_the_deck():
    moving, fixed = (fm.evaluate(agent, ID, seeds=range(4)) for agent in ("lqr-tracking", "lqr"))
    assert moving["rms_error"] < 0.5 * fixed["rms_error"] and moving["failed"] == fixed["failed"] == 0.0


def test_single_and_vector_environment_are_equal_and_a_state_is_restored():
    env, venv = gym.make(ID, base="pd").unwrapped, gym.make_vec(ID, 3, "vector_entry_point", base="pd")
    env.reset(seed=5)
    venv.reset(seed=[4, 5, 6])
    action, stored, tail = np.full(3, 0.01, dtype=np.float32), None, []
    for k in range(40):
        one, many = env.step(action), venv.step(np.tile(action, (3, 1)))
        assert np.array_equal(one[0], many[0][1]) and one[1] == many[1][1]
        if k == 20:
            stored, tail = env.get_state(), []
        tail.append(one[0])
    env.set_state(stored)
    again = [env.step(action)[0] for _ in tail[1:]]
    assert np.array_equal(again, tail[1:])


def test_sequential_methods_simulate_the_deck_as_those_in_lanes_do():
    tips = []
    for method in ("midpoint_corrected_3", "generalised_alpha"):
        env = gym.make(ID, method=method, step=0.001).unwrapped
        env.reset(seed=2)
        for _ in range(30):
            env.step(np.full(3, 0.02, dtype=np.float32))
        tips.append(env.episodes.view.tip[0].copy())
        assert np.isfinite(env.episodes.view.specific_force).all()
    np.testing.assert_allclose(tips[0], tips[1], atol=1e-4)


@pytest.mark.parametrize("change, field", [
    ({"foundation": {"kind": "sea", "roll": 1.0}}, "Sea.roll"), ({"safety": True}, "safety"),
    ({"foundation": {"kind": "sea", "period": 0}}, "Sea.period"), ({"task": "track"}, "task"),
    ({"foundation": {"kind": "sea", "heave": -1.0}}, "Sea.heave"),
])  # fmt: skip
def test_what_is_not_allowed_on_a_deck_is_refused(change, field):
    assert refusal(lambda: Configuration(ID, change)).startswith(field)


def test_hanging_load_on_a_deck_is_refused():
    line = refusal(lambda: Configuration("FlexCrane-v0", {"foundation": {"kind": "sea"}}))
    assert line.startswith("foundation") and "passive" in line


def test_sensor_of_the_deck_reads_attitude_rates_and_accelerations(env):
    env.reset(seed=6)
    env.step(np.zeros(3, dtype=np.float32))
    episodes = env.episodes
    pose, _, acceleration = poses(episodes.foundation, episodes.batch.time)
    episodes.sensors.read()
    readings = episodes.sensors.readings
    np.testing.assert_allclose(readings["base_angles"], pose[:, 3:], atol=1e-12)
    np.testing.assert_allclose(readings["base_accelerations"], acceleration[:, :3], atol=1e-12)
    assert (np.abs(readings["base_rates"]) < env.observation_space.high[episodes.sensors.slices["base_rates"]]).all()


def test_recorded_motion_of_a_base_passes_through_its_samples_and_rests_after_it(tmp_path):
    path, times = tmp_path / "truck.csv", np.linspace(0.0, 2.0, 41)
    heave, roll = 0.1 * np.sin(np.pi * times) ** 2, 3.0 * np.sin(np.pi * times / 2.0) ** 2
    rows = "\n".join(f"{t},{h},{r}" for t, h, r in zip(times, heave, roll, strict=True))
    path.write_text(f"time (s),heave (m),roll (deg)\n{rows}\n")
    setting = {"kind": "record", "file": str(path), "target": "base"}
    env = gym.make(ID, foundation=setting, sensors=["full", "foundation"]).unwrapped
    env.reset(seed=1)
    foundation, view = env.episodes.foundation, env.episodes.view
    pose, rate, acceleration = poses(foundation, np.array([0.5, 1.0, 3.0]))
    np.testing.assert_allclose(pose[:2, 2], 0.1 * np.sin(np.pi * np.array([0.5, 1.0])) ** 2, atol=1e-5)
    np.testing.assert_allclose(pose[:2, 3], np.radians(3.0 * np.sin(np.pi * np.array([0.25, 0.5])) ** 2), atol=1e-6)
    assert not rate[2].any() and not acceleration[2].any() and pose[2, 3] == pytest.approx(0.0, abs=1e-12)
    target, goal = view.target.copy(), view.goal_angles.copy()
    for _ in range(50):
        env.step(np.zeros(3, dtype=np.float32))
    assert np.array_equal(view.target, target) and np.array_equal(view.goal_angles, goal)  # it rests in the base frame
    assert plain_foundation(Configuration(ID, {"foundation": setting}).foundation) == setting | {"start": 0.0}
    late = refusal(lambda: Configuration(ID, {"foundation": setting | {"start": 9.0}}))
    assert late.startswith("Record.start") and "from 0 to 2" in late
    path.with_name("bad.csv").write_text("time (s),heave (rad)\n0,0\n1,1\n")
    bad = refusal(lambda: Configuration(ID, {"foundation": setting | {"file": str(path.with_name("bad.csv"))}}))
    assert bad.startswith("Record.file") and "heave in m" in bad

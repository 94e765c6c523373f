"""Servo modes: actions that are angles, speeds or currents, and drives that lag, for one arm and for many."""

import copy
import warnings
from dataclasses import replace

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

import flexman_gym as fm
from flexman_gym.envs.config.configuration import Configuration
from flexman_gym.envs.config.fidelity import resolve_fidelity
from flexman_gym.envs.config.named_environments import NAMED_ENVIRONMENTS
from flexman_gym.envs.env import FlexManEnv
from flexman_gym.envs.vector_env import FlexManVectorEnv
from flexman_gym.model.state_space import first_order_lag

from oracles.assertions import same

RRR = NAMED_ENVIRONMENTS["FlexRRR-v0"].arm
GEARED = replace(RRR, joints=[replace(joint, motor=fm.Motor(100.0, 1.0, 1e-3, 4.0)) for joint in RRR.joints])
FAST = {"control_period": 0.005, "action_repeat": 4}  # a servo at 200 Hz under an agent at 50 Hz
SETTINGS = {
    "velocity": {"actions": "velocity", **FAST},
    "position": {"actions": {"kind": "position", "range": [2.0, 1.5, 1.0]}, "drive_bandwidth": 30.0, **FAST},
    "current": {"actions": "current", "arm": GEARED, "base": "pd"},
    "torque": {"drive_bandwidth": 20.0, "randomisation": {"delay": (0, 2)}},
}
each_mode = pytest.mark.parametrize("settings", SETTINGS.values(), ids=SETTINGS)
SHORT = {"horizon": 0.4, "limits": fm.Limits(rate=4.0)}


@pytest.mark.feature
@each_mode
def test_one_environment_and_many_move_alike_to_the_bit_and_go_on_from_a_state(settings):
    ours = gym.make_vec("FlexRRR-v0", 3, "vector_entry_point", **settings, **SHORT)
    theirs = gym.make_vec("FlexRRR-v0", 3, "sync", **settings, **SHORT)
    assert ours.action_space == theirs.action_space
    for actual, expected in zip(ours.reset(seed=5), theirs.reset(seed=5), strict=True):
        same(actual, expected, "reset")
    random, ended = np.random.default_rng(0), 0
    for step in range(40):
        if step == 20:
            ours = copy.deepcopy(ours.unwrapped)
        action = random.uniform(-1.0, 1.0, (3, 3)).astype(np.float32)
        result = ours.step(action)
        ended += int(np.sum(result[2] | result[3]))
        for actual, expected in zip(result, theirs.step(action), strict=True):
            same(actual, expected, f"step {step}")
    assert ended


@pytest.mark.feature
@each_mode
def test_both_libraries_find_nothing_to_complain_about(settings):
    checker = pytest.importorskip("stable_baselines3.common.env_checker")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        check_env(gym.make("FlexRRR-v0", **settings).unwrapped)
        checker.check_env(gym.make("FlexRRR-v0", **settings))


@pytest.mark.feature
def test_a_position_servo_comes_to_rest_where_it_is_told():
    env = FlexManEnv(name="FlexOne-v0", actions={"kind": "position", "range": 2.0}, horizon=20.0)
    env.reset(options={"start": [0.5], "goal_angles": [-0.4]})
    for _ in range(600):
        env.step(np.array([-0.2], dtype=np.float32))
    assert env.episodes.view.motor_angles[0, 0] == pytest.approx(-0.4, abs=2e-3)
    assert env.episodes.agent.mode.names == ("position_1",)


@pytest.mark.feature
def test_a_velocity_servo_turns_as_fast_as_it_is_told_and_does_not_wind_up():
    env = FlexManEnv(name="FlexOne-v0", actions={"kind": "velocity", "range": [0.5]}, horizon=20.0)
    env.reset(options={"start": [-1.0], "goal_angles": [0.0]})
    angles = []
    for _ in range(250):
        env.step(np.array([0.4], dtype=np.float32))
        angles.append(env.episodes.view.motor_angles[0, 0])
    rates = np.diff(angles[150:]) / env.configuration.control_period
    assert rates.mean() == pytest.approx(0.2, rel=0.02) and np.ptp(rates) < 0.02
    env.reset(options={"start": [-1.0], "goal_angles": [0.0]})
    for _ in range(50):
        env.step(np.zeros(1, dtype=np.float32))
        assert env.episodes.view.motor_angles[0, 0] == pytest.approx(-1.0, abs=1e-9), "it stays where it starts"
    weak = FlexManEnv(name="FlexOne-v0", actions={"kind": "velocity", "range": 20.0}, torque_limit=0.01)
    weak.reset(options={"start": [0.0], "goal_angles": [0.0]})
    servo = weak.episodes.agent.mode
    for _ in range(20):
        weak.step(np.ones(1, dtype=np.float32))
    behind = servo._reference[0, 0] - weak.episodes.view.motor_angles[0, 0]
    assert 0.0 < behind <= 0.01 / NAMED_ENVIRONMENTS["FlexOne-v0"].pd["stiffness"][0] + 0.01, (
        "the torque limit over the stiffness"
    )


@pytest.mark.feature
@pytest.mark.parametrize("late", [0, 1, 2])
@pytest.mark.parametrize("bandwidth", [None, 8.0])
def test_the_environment_moves_as_the_loop_says_whose_eigenvalues_are_looked_at(late, bandwidth):
    """A rigid link on a rigid joint, under a servo whose torques come late through a drive that lags."""
    from flexman_gym.toolbox.controllers.margins import sampled_loops

    arm, gains = fm.catalog.one_link(rotor_inertia=0.1), {"stiffness": [2.0], "damping": [0.9]}
    env = FlexManEnv(
        name="FlexOne-v0", arm=arm, modes=0, torque_limit=50.0, actions={"kind": "position", **gains},
        drive_bandwidth=bandwidth, randomisation={"delay": (late, late)} if late else None,
        control_period=0.02, horizon=30.0,
    )  # fmt: skip
    env.reset(options={"start": [0.5], "goal_angles": [0.0]})
    loop = sampled_loops(env.simulator.model, [0.0], 0.02, late, bandwidth)[0]
    gain = np.zeros((1, len(loop.transition)))
    gain[0, loop.motors], gain[0, loop.rates] = gains["stiffness"], gains["damping"]
    state, closed = np.zeros(len(loop.transition)), loop.transition - loop.inputs @ gain
    state[loop.motors] = 0.5
    for _ in range(60):
        env.step(np.zeros(1, dtype=np.float32))
        state = closed @ state
        assert env.simulator.state == pytest.approx(state[:2], abs=1e-9)
    assert loop.spectral_radius(**gains) < 1.0


def test_a_lag_is_that_of_a_first_order_filter():
    from scipy.integrate import quad

    left, mean = first_order_lag(0.02, 5.0)
    assert left == pytest.approx(np.exp(-2.0 * np.pi * 5.0 * 0.02))
    assert mean == pytest.approx(quad(lambda t: np.exp(-2.0 * np.pi * 5.0 * t), 0.0, 0.02)[0] / 0.02)


@pytest.mark.feature
@pytest.mark.parametrize("name", sorted({*NAMED_ENVIRONMENTS} - {"FlexGantry-v0"}))  # no motor
def test_servos_of_all_environments_are_stable_under_delay_and_lag_and_cease_to_be(name):
    """With tuned gains: at the control period, and at a fifth of it with up to four of these periods of delay."""
    from flexman_gym.toolbox.controllers.margins import sampled_loops

    setup = Configuration.from_keywords({"name": name})
    model, gains = resolve_fidelity(setup).model, NAMED_ENVIRONMENTS[name].pd
    stiffness, damping = np.array(gains["stiffness"]), np.array(gains["damping"])
    n, period = len(stiffness), setup.control_period
    postures = ([0.0] * n, [0.5 * (-1.0) ** i for i in range(n)])
    for posture in postures:
        assert sampled_loops(model, posture, period)[0].spectral_radius(stiffness, damping) < 1.0
        for late in (0, 2, 4):
            loop = sampled_loops(model, posture, period / 5.0, late, 5.0 / period)[0]
            assert loop.spectral_radius(stiffness, damping) < 1.0, (late, posture)
    late = sampled_loops(model, postures[0], period, 4, 5.0 / period)[0]
    assert late.spectral_radius(20.0 * stiffness, 20.0 * damping) > 1.0


@pytest.mark.feature
def test_a_servo_that_is_not_stable_is_told():
    with pytest.warns(UserWarning, match="not stable with a period of 0.02 s"):
        FlexManEnv(actions={"kind": "position", "stiffness": [148.0] * 3, "damping": [1200.0] * 3})
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        FlexManEnv(
            actions={"kind": "position", "stiffness": [148.0] * 3, "damping": [1000.0] * 3}, control_period=0.002
        )


def test_currents_are_torques_by_gear_torque_constant_and_efficiency():
    arm = fm.catalog.planar_2r()
    motors = [fm.Motor(50.0, 0.02, 1e-6, 2.0, efficiency=0.9), fm.Motor(20.0, 0.05, 1e-6, 0.5)]
    joints = [replace(joint, rotor_inertia=0.0, motor=motor) for joint, motor in zip(arm.joints, motors, strict=True)]
    own = {"name": "FlexPlanar-v0", "arm": replace(arm, joints=joints)}
    for limit in (None, 1.0):
        env = FlexManEnv(**own, actions="current", torque_limit=limit)
        env.reset(seed=0)
        env.step(np.array([0.5, -1.0], dtype=np.float32))
        asked = [min(0.5 * 2.0 * 0.02 * 50.0 * 0.9, limit or 9.0), -0.5 * 0.05 * 20.0]
        assert env.episodes.motors.torques[0] == pytest.approx(asked)
        assert env.episodes.agent.mode.names == ("current_1", "current_2")


def test_drives_begin_at_rest_in_every_episode():
    venv = FlexManVectorEnv(2, drive_bandwidth=3.0, horizon=0.1)
    for seed in (0, 1):
        venv.reset(seed=seed)
        assert not venv.episodes.motors.reached.any()
        venv.step(np.ones((2, 3), dtype=np.float32))
        left, mean = first_order_lag(0.02, 3.0)
        assert venv.episodes.motors.reached == pytest.approx(1.0 - left)
        assert venv.episodes.motors.torques == pytest.approx((1.0 - mean) * 400.0)
        assert venv.episodes.view.action == pytest.approx(1.0), "what was asked for"


@pytest.mark.feature
def test_friction_hides_no_unstable_servo():
    """The loop that slides is as unstable as without friction, and a loop with stuck motors may be the worst."""
    plain = fm.catalog.planar_2r()
    rubbing = replace(plain, joints=[replace(joint, coulomb_friction=0.3) for joint in plain.joints])
    given = {"name": "FlexPlanar-v0", "torque_limit": 50.0, "randomisation": {"delay": (1, 1)}}
    servo = {"kind": "position", "stiffness": [100.0, 30.0], "damping": [10.0, 3.0]}
    for arm in (plain, rubbing):
        with pytest.warns(UserWarning, match="is not stable with a period of 0.01 s.*spectral radius"):
            FlexManEnv(**given, arm=arm, actions=servo)


def test_the_velocity_at_an_action_of_one_is_the_speed_limit_of_the_joint():
    """Also of a joint without a motor."""
    arm = Configuration("FlexOne-v0").arm
    slow = replace(arm, joints=[replace(arm.joints[0], speed_limit=0.4)])
    moved = [{"kind": "velocity"}, {"kind": "velocity", "range": 0.4}]
    states = []
    for actions in moved:
        env = FlexManEnv(name="FlexOne-v0", arm=slow, actions=actions)
        env.reset(seed=0)
        for _ in range(20):
            env.step(np.array([1.0], dtype=np.float32))
        states.append(env.simulator.state.copy())
    assert np.array_equal(*states)

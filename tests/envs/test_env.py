"""Environments: Gymnasium's contract, the same bits for the same seed, honest observations, rewards and failures."""

import subprocess
import sys
import warnings

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

import flexman_gym as fm
from flexman_gym.envs.env import FlexManEnv
from flexman_gym.envs.vector_env import FlexManVectorEnv

from oracles.random_inputs import EVERYTHING

POSTURE = (0.3, 0.4, -0.5)
INFO = {
    "tip_error", "tip_vibration", "elastic_energy", "energy_residual", "energy_alarm", "reward_terms", "status",
    "failure", "method", "tip", "target", "goal_angles",
}  # fmt: skip
FAR = fm.Limits(angle=1e9, rate=1e9, twist=1e9, deflection=1e9, deflection_rate=1e9, tip_speed=1e9)
EPISODES = """
import hashlib, sys, gymnasium, numpy
import flexman_gym
env = gymnasium.make("FlexRRR-v0", max_episode_steps=100)
digest = hashlib.sha256()
def note(*values):
    for value in values:
        items = sorted(value.items()) if isinstance(value, dict) else None
        if items is not None:
            note(*(part for item in items for part in item))
        else:
            digest.update(value.tobytes() if isinstance(value, numpy.ndarray) else repr(value).encode())
env.action_space.seed(int(sys.argv[1]))
note(*env.reset(seed=int(sys.argv[1])))
for _ in range(300):
    observation, reward, terminated, truncated, info = env.step(env.action_space.sample())
    note(observation, reward, terminated, truncated, info)
    if terminated or truncated:
        note(*env.reset())
print(digest.hexdigest())
"""


def run(env, actions):
    """Steps until an episode ends; returns what each step returned."""
    results = []
    for action in actions:
        results.append(env.step(action))
        if results[-1][2] or results[-1][3]:
            break
    return results


def full_power(steps):
    """The same action for many steps."""
    return np.ones((steps, 3), dtype=np.float32)


@pytest.mark.feature
@pytest.mark.parametrize("render_mode", [None, "rgb_array"])
def test_gymnasium_finds_nothing_to_complain_about(render_mode):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        check_env(gym.make("FlexRRR-v0", render_mode=render_mode).unwrapped)


@pytest.mark.feature
def test_stable_baselines_finds_nothing_to_complain_about():
    checker = pytest.importorskip("stable_baselines3.common.env_checker")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        checker.check_env(gym.make("FlexRRR-v0"))


@pytest.mark.slow
def test_two_processes_get_the_same_bits_from_a_seed_and_others_from_another():
    command = [sys.executable, "-c", EPISODES]
    runs = [subprocess.Popen([*command, seed], stdout=subprocess.PIPE, text=True) for seed in ("7", "7", "8")]
    first, again, other = (process.communicate(timeout=300)[0].strip() for process in runs)
    assert len(first) == 64 and first == again != other


def test_resets_continue_the_stream_of_their_seed():
    env, other = FlexManEnv(), FlexManEnv()
    starts = [env.reset(seed=3)[0], env.reset()[0], env.reset()[0]]
    again = [other.reset(seed=3)[0], other.reset()[0], other.reset()[0]]
    assert np.array_equal(starts, again)
    assert len(np.unique([*starts, env.reset(seed=4)[0]], axis=0)) == 4
    assert np.array_equal(env.reset(seed=3)[0], starts[0])


@pytest.mark.slow
@pytest.mark.parametrize(("steps", "hold"), [(50_000, 1), (20_000, 20)], ids=["random", "bang-bang"])
def test_observations_stay_in_their_space_whatever_the_motors_do(steps, hold):
    env, rng = FlexManEnv(), np.random.default_rng(0)
    actions = rng.uniform(-1.0, 1.0, (steps // hold, 3)).astype(np.float32)
    actions = actions if hold == 1 else np.sign(actions).repeat(hold, axis=0)
    seen, age, failures = np.zeros((steps, *env.observation_space.shape)), 0, set()
    env.reset(seed=0)
    for i, action in enumerate(actions):
        seen[i], reward, terminated, _, info = env.step(action)
        low = -env.task.failure_penalty if terminated else 0.0
        assert low <= reward <= low + 1.0
        age += 1
        if terminated or age == 500:
            failures.add(info["failure"].split(" ")[0])
            env.reset()
            age = 0
    assert (np.abs(seen) <= env.observation_space.high).all(), "out of the space, or not finite"
    assert failures - {""}, "no limit was ever tried"


def test_a_limit_ends_the_episode_with_the_penalty_and_says_which():
    env = FlexManEnv(limits=fm.Limits(rate=1.0))
    env.reset(seed=0)
    results = run(env, full_power(500))
    *_, (before, *_), (last, reward, terminated, truncated, info) = results
    assert terminated and not truncated and info["status"] == "ok"
    name, value, unit, *_, bound = info["failure"].split(" ")
    assert name in ("motor_rates", "joint_twist_rates") and abs(float(value)) > float(bound) == 1.0 and unit == "rad/s"
    assert np.array_equal(last, before) and env.observation_space.contains(last)
    assert info["reward_terms"]["failure"] == -env.task.failure_penalty
    assert reward == sum(info["reward_terms"].values())
    assert all(result[4]["failure"] == "" for result in results[:-1])
    with pytest.raises(RuntimeError, match=r"^the episode is over: reset the environment first$"):
        env.step(full_power(1)[0])
    env.reset()
    assert not env.step(np.zeros(3))[2]


def test_a_divergence_ends_the_episode_with_a_status():
    """An explicit method far beyond its stability limit, with all FE coordinates, and limits that stop nothing."""
    env = FlexManEnv(method="rk4", step=0.02, modes=None, limits=FAR)
    start, _ = env.reset(seed=0)
    results = run(env, full_power(500))
    last, reward, terminated, truncated, info = results[-1]
    assert terminated and not truncated
    assert info["status"] == "diverged" and info["failure"] == "the simulation diverged"
    assert np.array_equal(last, results[-2][0] if len(results) > 1 else start)
    assert np.isfinite(last).all() and np.isfinite(reward)
    assert info["reward_terms"]["failure"] == -env.task.failure_penalty
    with pytest.raises(RuntimeError):
        env.step(full_power(1)[0])
    env.reset(seed=0)
    assert env.simulator.status == "ok"


def test_the_time_limit_truncates_after_500_steps():
    env = gym.make("FlexRRR-v0")
    env.reset(seed=0)
    results = run(env, np.zeros((600, 3), dtype=np.float32))
    assert [result[3] for result in results] == [False] * 499 + [True]
    assert not results[-1][2]
    assert env.unwrapped.simulator.time == pytest.approx(10.0, abs=1e-9)


@pytest.mark.parametrize(("horizon", "period", "expected"), [(0.29, 0.01, 29), (0.7, 0.1, 7), (0.305, 0.02, 15)])
def test_an_episode_lasts_its_horizon_to_half_a_period(horizon, period, expected):
    """Also where a division rounds to less: 0.29 / 0.01 is 28.999... in doubles."""
    assert abs(expected * period - horizon) < 0.5 * period
    env, count, ended = FlexManEnv(horizon=horizon, control_period=period), 0, False
    env.reset(seed=0)
    while not ended:
        count, ended = count + 1, env.step(np.zeros(3))[3]
    assert count == expected


def test_stepping_before_a_reset_is_refused():
    with pytest.raises(RuntimeError, match="reset the environment first"):
        FlexManEnv().step(np.zeros(3))


def test_the_observation_is_what_the_simulator_says():
    env = FlexManEnv()
    env.reset(seed=5)
    simulator, d = env.simulator, env.simulator.model.n_dof
    for action in np.random.default_rng(1).uniform(-1.0, 1.0, (20, 3)):
        observation, _, _, _, info = env.step(action)
        x, v = simulator.state[:d], simulator.state[d:]
        for name, values in {
            "motor_angles": x[3:6],
            "motor_rates": v[3:6],
            "joint_twists": x[3:6] - x[:3],
            "joint_twist_rates": v[3:6] - v[:3],
            "angle_errors": info["goal_angles"] - x[3:6],
            "target_error": info["target"] - info["tip"],
            "tip_velocity": simulator.tip_velocity,
        }.items():
            seen = observation[env.sensors.slices[name]]
            assert seen == pytest.approx(values, rel=1e-6, abs=1e-6), name
        assert info["tip"] == pytest.approx(
            fm.curves(simulator.model, simulator.state, 16).positions[-1, -1], abs=1e-12
        )
        assert info["tip_error"] == pytest.approx(np.linalg.norm(info["target"] - info["tip"]), rel=1e-12)
        assert info["tip_vibration"] == pytest.approx(np.linalg.norm(simulator.deflection_rate), rel=1e-12)


def test_observations_and_info_are_the_callers_to_keep():
    env = FlexManEnv()
    observation, info = env.reset(seed=5)
    kept = observation.copy(), info["tip"].copy(), info["target"].copy(), info["goal_angles"].copy()
    env.step(np.ones(3))
    for before, after in zip(kept, (observation, info["tip"], info["target"], info["goal_angles"]), strict=True):
        assert np.array_equal(before, after)
    observation[:] = info["target"][:] = info["goal_angles"][:] = np.nan
    assert np.isfinite(env.step(np.ones(3))[0]).all()


def test_an_arm_at_rest_on_its_target_stays_there_and_earns_one():
    env = FlexManEnv()
    start, _ = env.reset(options={"start": POSTURE, "goal_angles": POSTURE})
    assert start[env.sensors.slices["motor_angles"]] == pytest.approx(POSTURE)
    for observation, reward, terminated, _, info in run(env, np.zeros((50, 3))):
        assert observation == pytest.approx(start, abs=1e-9)
        assert reward == pytest.approx(1.0, abs=1e-12) and not terminated
        assert info["elastic_energy"] == pytest.approx(0.0, abs=1e-15)


def test_info_has_its_keys_and_a_reward_that_is_the_sum_of_its_terms():
    env = FlexManEnv()
    assert env.reset(seed=1)[1].keys() == INFO
    for _, reward, _, _, info in run(env, np.random.default_rng(2).uniform(-1.0, 1.0, (100, 3))):
        assert info.keys() == INFO and type(reward) is float
        assert info["reward_terms"].keys() == {"tip_error", "tip_vibration", "effort", "failure"}
        assert reward == pytest.approx(sum(info["reward_terms"].values()), abs=1e-15)
        assert info["status"] == "ok" and info["failure"] == ""


@pytest.mark.slow
def test_the_energy_residual_is_the_error_of_the_integrator():
    """It vanishes for a reference method, and falls as the square of the step for one of second order."""
    residuals = {}
    for method, step in (("dop853", 0.02), ("ros2", 0.02 / 64), ("ros2", 0.02 / 256)):
        env = FlexManEnv(method=method, step=step)
        env.reset(options={"start": POSTURE, "goal_angles": (0.0, 0.0, 0.0)})
        info = run(env, np.tile([1.0, -1.0, 0.5], (25, 1)))[-1][4]
        residuals[method, step] = abs(info["energy_residual"]) / env.simulator.energy
    reference, coarse, fine = residuals.values()
    assert reference < 1e-9 and coarse < 1e-4
    assert coarse / fine == pytest.approx(16.0, rel=0.1)


@pytest.mark.parametrize("fidelity", [{"modes": 2}, {"modes": None}, {"elements": 1}, {"elements": (1, 2, 3)}])
def test_the_spaces_do_not_depend_on_the_fidelity(fidelity):
    env, reference = FlexManEnv(**fidelity), FlexManEnv()
    assert env.observation_space == reference.observation_space and env.observation_space.shape == (36,)
    assert env.action_space == reference.action_space
    observation, _ = env.reset(seed=0)
    assert np.array_equal(observation, reference.reset(seed=0)[0]), "an undeformed arm looks the same"
    assert env.step(np.zeros(3))[4]["status"] == "ok"


@pytest.mark.feature
@pytest.mark.parametrize(
    ("arm", "torque_limit"), [(fm.catalog.planar_2r(), 0.2), (fm.catalog.one_link(joint_stiffness=None), 0.5)]
)
def test_other_arms_work(arm, torque_limit):
    env = gym.make("FlexRRR-v0", arm=arm, torque_limit=torque_limit)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        check_env(env.unwrapped)
    assert env.action_space.shape == (arm.n_joints,)
    assert env.observation_space.shape == (9 * arm.n_joints + 9,)
    assert not env.unwrapped.observation_space.contains(np.zeros(36, dtype=np.float32))


def test_the_action_is_a_part_of_the_torque_limit():
    weak, strong = FlexManEnv(torque_limit=100.0), FlexManEnv(torque_limit=200.0)
    for env, action in ((weak, 0.8), (strong, 0.4)):
        env.reset(seed=2)
        env.step(np.full(3, action))
    assert weak.simulator.state == pytest.approx(strong.simulator.state, abs=1e-14)
    assert weak.simulator.state[3:6] != pytest.approx(weak.simulator.model.initial_state([0.0] * 3)[3:6])


@pytest.mark.feature
def test_a_control_period_is_what_a_step_takes():
    env = FlexManEnv(control_period=0.05, step=0.01, render_mode="rgb_array")
    env.reset(seed=0)
    env.step(np.zeros(3))
    assert env.simulator.time == pytest.approx(0.05) and env.metadata["render_fps"] == 20


@pytest.mark.feature
def test_frames_show_the_arm_as_it_moves():
    env = FlexManEnv(render_mode="rgb_array", render_size=(320, 200))
    env.reset(seed=0)
    first = env.render()
    assert first.shape == (200, 320, 3) and first.dtype == np.uint8
    assert np.array_equal(env.render(), first)
    run(env, full_power(30))
    assert (env.render() != first).any()


def test_rendering_without_a_mode_warns_and_gives_nothing():
    env = FlexManEnv()
    env.reset(seed=0)
    with pytest.warns(UserWarning, match="render_mode"):
        assert env.render() is None


@pytest.mark.parametrize(
    "action",
    [[0.0, 0.0], [[0.0, 0.0, 0.0]], [np.nan, 0.0, 0.0], [0.0, 1.001, 0.0], [0.0, -np.inf, 0.0], ["up"] * 3, None],
)
def test_a_bad_action_is_refused_in_one_line_and_changes_nothing(action):
    env = FlexManEnv()
    env.reset(seed=0)
    before = env.simulator.state.copy()
    with pytest.raises(ValueError) as error:
        env.step(action)
    refused(error, "action", action, "3 numbers from -1 to 1")
    assert np.array_equal(env.simulator.state, before) and env.simulator.time == 0.0


@pytest.mark.parametrize(
    ("options", "allowed"),
    [
        ({"speed": 1.0}, "one of start, goal_angles, start_tip, goal_tip, parameters"),
        ({"start": [5.0, 0.0, 0.0]}, "a start and a goal within the limits"),
        (3, "a dict with start, goal_angles, start_tip, goal_tip or parameters"),
    ],
)
def test_bad_options_are_refused_in_one_line_and_end_the_episode(options, allowed):
    env = FlexManEnv()
    env.reset(seed=0)
    with pytest.raises(ValueError) as error:
        env.reset(options=options)
    refused(error, "options", "speed" if "speed" in str(options) else options, allowed)
    with pytest.raises(RuntimeError, match="reset the environment first"):
        env.step(np.zeros(3))


@pytest.mark.parametrize("name", ["start", "goal_angles"])
def test_a_bad_start_or_posture_is_named(name):
    for value in (None, [0.0, 0.0], "up"):
        with pytest.raises(ValueError) as error:
            FlexManEnv().reset(options={name: value})
        refused(error, f"options[{name!r}]", value, "numbers")


OUTSIDE = {"start": [5.0, 0.0, 0.0]}  # beyond the limits, which only a reset finds out
WRONG = [
    OUTSIDE,
    OUTSIDE | {"parameters": {"payload_mass": 3.0, "joint_damping": [1.0, 2.0, 3.0]}},
    OUTSIDE | {"goal_angles": [0.1] * 3, "parameters": {"link_stiffness_factor": [0.9, 0.8, 0.7]}},
    {"start": "up"},
    {"speed": 1.0},
    np.zeros(3),
]
SETTINGS = [
    {},
    {"randomisation": EVERYTHING, "sensors": {"kind": "lab", "noise": 0.01, "bias": 0.01}, "history": 2},
    {"base": "pd", "method": "dopri5", "step": None, "modes": 1, "task": "hold"},
]


def same_bits(one, other):
    """Whether two observations or infos are the same to the last bit."""
    if isinstance(one, dict):
        return one.keys() == other.keys() and all(same_bits(one[name], other[name]) for name in one)
    return np.array_equal(one, other)


@pytest.mark.parametrize("settings", SETTINGS, ids=lambda settings: "-".join(settings) or "plain")
@pytest.mark.parametrize("made", [FlexManEnv, lambda **settings: FlexManVectorEnv(3, **settings)], ids=["one", "many"])
def test_a_refused_reset_is_as_if_it_had_never_been(made, settings):
    """The next reset draws what it would have drawn, and its arm has none of the refused parameters."""
    env, other = made(**settings), made(**settings)
    rest = np.zeros(env.action_space.shape, dtype=np.float32)
    for each in (env, other):
        each.reset(seed=3)
        each.step(rest)
    for number, options in enumerate(WRONG):
        with pytest.raises(ValueError, match="is not allowed; give "):
            env.reset(seed=None if number % 2 else 8, options=options)
        assert env.np_random_seed == other.np_random_seed
    assert all(map(same_bits, env.reset(), other.reset()))
    assert all(map(same_bits, env.step(rest + 0.1), other.step(rest + 0.1)))


def test_a_first_reset_that_is_refused_leaves_nothing_behind():
    env = FlexManEnv(randomisation=EVERYTHING)
    with pytest.raises(ValueError, match="within the limits"):
        env.reset(seed=1, options=OUTSIDE)
    with pytest.raises(RuntimeError, match="reset the environment first"):
        env.step(np.zeros(3))
    assert all(map(same_bits, env.reset(seed=2), FlexManEnv(randomisation=EVERYTHING).reset(seed=2)))


def test_arms_that_a_refused_reset_does_not_mean_go_on():
    settings = {"autoreset_mode": "Disabled", "randomisation": EVERYTHING}
    env, other = FlexManVectorEnv(3, **settings), FlexManVectorEnv(3, **settings)
    first = np.array([True, False, False])
    for each in (env, other):
        each.reset(seed=3)
        each.step(np.full((3, 3), 0.1))
    with pytest.raises(ValueError, match="within the limits"):
        env.reset(options=OUTSIDE | {"reset_mask": first})
    with pytest.raises(RuntimeError, match=r"the episodes of arms \[0\] are over"):
        env.step(np.zeros((3, 3)))
    result, expected = (each.reset(options={"reset_mask": first}) for each in (env, other))
    assert same_bits(result[0], expected[0])
    assert all(map(same_bits, env.step(np.zeros((3, 3))), other.step(np.zeros((3, 3)))))


def test_a_bad_seed_is_refused_in_one_line():
    for seed in ("12", 1.0, True, -1, [1], 2**128):
        with pytest.raises(ValueError) as error:
            FlexManEnv().reset(seed=seed)
        refused(error, "seed", seed, "a whole number from 0")


def refused(error, field, value, allowed):
    """Asserts that an error names field, value and what is allowed, on one line."""
    message = str(error.value)
    assert message.startswith(f"{field}: {value!r} is not allowed; give ") and allowed in message
    assert "\n" not in message

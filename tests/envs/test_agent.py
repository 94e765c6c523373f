"""Hold and base: an agent's part that is kept for some control periods, and a controller that acts in each of them."""

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.vector import AutoresetMode

import flexman_gym as fm
from flexman_gym.agent.base_controllers import make_base
from flexman_gym.agent.pd import PD
from flexman_gym.envs.config.plant import make_plant
from flexman_gym.envs.env import FlexManEnv
from flexman_gym.envs.sensors import FullState
from flexman_gym.envs.vector_env import FlexManVectorEnv

from oracles.assertions import same_side_by_side
from oracles.random_inputs import EVERYTHING, actions

MODES = tuple(AutoresetMode)
TIGHT = fm.Limits(rate=2.5)
HARD = {"stiffness": (497.0, 325.0, 328.0), "damping": (950.0, 950.0, 103.0)}  # which leads to the limits
STIFF = {"base": "pd", "gains": HARD}
NOISELESS = EVERYTHING | {"sensor_noise": None}


def equal(one, other):
    """Asserts that two results are the same to the bit."""
    for actual, expected in zip(one, other, strict=True):
        if isinstance(actual, dict):
            assert actual.keys() == expected.keys()
            equal(actual.values(), expected.values())
        else:
            assert np.array_equal(actual, expected)


class Recorder:
    """A base controller that keeps what it was given and asks for the same of all arms."""

    sensors = ("full",)

    def __init__(self, asked=0.0, sensors=("full",)):
        self.asked, self.sensors, self.readings, self.resets, self.told = asked, sensors, [], [], []

    def reset(self, arms, episode, count):
        self.resets.append((arms.copy(), episode.start.copy(), episode.goal.copy()))

    def act(self, readings, applied, playing):
        self.readings.append({name: value.copy() for name, value in readings.items()})
        self.told.append((applied.copy(), playing.copy()))
        return np.full((len(next(iter(readings.values()))), 3), self.asked)


class Asking(fm.Slew):
    """The slew, which also tells what the motors were asked for."""

    def info(self, view):
        return super().info(view) | {"asked": view.action}


@pytest.mark.slow
@pytest.mark.parametrize("base", [None, "pd"])
@pytest.mark.parametrize("randomisation", [None, NOISELESS], ids=["plain", "randomised"])
@pytest.mark.parametrize("hold", [2, 5])
def test_a_held_action_is_the_same_action_so_many_times(hold, base, randomisation):
    """Reward is the mean of the periods played, all else that of the last; episodes end when they end.

    What is seen after a failure is what was seen last, before the action. Noise is drawn once an action.
    """
    settings = {"limits": TIGHT, "base": base, "gains": HARD, "randomisation": randomisation, "horizon": 0.6}
    held, each = FlexManEnv(action_repeat=hold, **settings), FlexManEnv(**settings)
    equal(before := held.reset(seed=7), each.reset(seed=7))
    ends = {"failed": 0, "failed on the way": 0, "truncated": 0}
    for action in actions(1, 750 // hold):
        result, rewards = held.step(action[0]), []
        while len(rewards) < hold:
            last = each.step(action[0])
            rewards.append(last[1])
            if last[2] or last[3]:
                break
        assert result[1] == pytest.approx(np.mean(rewards), rel=1e-12)
        equal(result[2:], last[2:])
        assert np.array_equal(result[0], before[0] if last[2] else last[0])
        ends["failed"] += last[2]
        ends["failed on the way"] += last[2] and len(rewards) < hold
        ends["truncated"] += last[3]
        before = result
        if last[2] or last[3]:
            equal(before := held.reset(), each.reset())
    assert all(ends.values()), ends


@pytest.mark.slow
@pytest.mark.parametrize(
    ("hold", "mode", "settings"),
    [
        *((3, mode, STIFF) for mode in MODES),
        *((5, mode, {**STIFF, "randomisation": EVERYTHING}) for mode in MODES),
        (1, MODES[0], {**STIFF, "randomisation": EVERYTHING}),
        (1, MODES[1], STIFF),
        (5, MODES[0], {"sensors": ("full", "fine"), "task": fm.Slew(reward="distance")}),
        (5, MODES[2], {}),
    ],
    ids=lambda value: "-".join(value) if isinstance(value, dict) else str(value),
)
def test_it_is_many_single_environments_bit_for_bit(hold, mode, settings):
    settings = {"action_repeat": hold, "limits": TIGHT, "horizon": 0.5, **settings}
    ours = gym.make_vec("FlexRRR-v0", 3, "vector_entry_point", autoreset_mode=mode, **settings)
    theirs = gym.make_vec("FlexRRR-v0", 3, "sync", vector_kwargs={"autoreset_mode": mode}, **settings)
    assert all(same_side_by_side(ours, theirs, actions(3, 80))), "both ways to end were seen"


@pytest.mark.slow
def test_what_the_motors_of_an_arm_that_is_over_were_asked_for_stays():
    """Of three arms that end within an action, in different periods of it, each tells what an arm alone tells."""
    settings = {"action_repeat": 5, **STIFF, "limits": TIGHT, "horizon": 0.5, "task": Asking()}
    ours = gym.make_vec("FlexRRR-v0", 3, "vector_entry_point", autoreset_mode="Disabled", **settings)
    singles = {"autoreset_mode": AutoresetMode.DISABLED}
    theirs = gym.make_vec("FlexRRR-v0", 3, "sync", vector_kwargs=singles, **settings)
    ended, failures = np.ones(3, dtype=bool), 0
    for step, action in enumerate(actions(3, 60)):
        if ended.any():
            for env in (ours, theirs):
                env.reset(seed=step, options={"reset_mask": ended.copy()})
        _, _, failed, late, infos = ours.step(action)
        assert infos["asked"] == pytest.approx(theirs.step(action)[4]["asked"], rel=1e-6, abs=1e-9), step
        failures, ended = failures + int(failed.sum()), failed | late
    assert failures > 5


@pytest.mark.slow
@pytest.mark.parametrize("name", ["FlexRRR-v0", "FlexPlanar-v0", "FlexOne-v0"])
@pytest.mark.parametrize(
    "base", ["pd", *(pytest.param(name, marks=pytest.mark.feature) for name in ("lqr", "lqr-tracking"))]
)
def test_every_base_gives_the_same_bits_to_one_arm_and_to_many(base, name):
    settings = {"base": base, "action_repeat": 2, "horizon": 0.08 if name == "FlexPlanar-v0" else 0.16}  # 4 steps
    arms = gym.make_vec(name, 2, "vector_entry_point", autoreset_mode="SameStep", **settings)
    singles = gym.make_vec(name, 2, "sync", vector_kwargs={"autoreset_mode": AutoresetMode.SAME_STEP}, **settings)
    given = np.random.default_rng(0).uniform(-0.3, 0.3, (7, *arms.action_space.shape)).astype(np.float32)
    assert sum(same_side_by_side(arms, singles, given, 2)) >= 2, "new episodes of the base were seen"


@pytest.mark.parametrize("mode", MODES)
def test_a_held_action_never_reaches_the_next_episode(mode):
    """Episodes of 0.1 s, steps of three periods: the second step has two; then the arm is as reset and at rest."""
    env = gym.make_vec(
        "FlexRRR-v0",
        2,
        "vector_entry_point",
        action_repeat=3,
        horizon=0.1,
        autoreset_mode=mode,
        base=(base := Recorder()),
    ).unwrapped
    rates = env.sensors.slices["motor_rates"]
    env.reset(seed=0)
    full = np.ones((2, 3), dtype=np.float32)
    env.step(full)
    seen, _, _, truncated, infos = env.step(full)
    assert truncated.all() and len(base.readings) == 5, "a base acts in each period that is played"
    if mode == AutoresetMode.SAME_STEP:
        assert (np.stack(infos["final_obs"])[:, rates] > 0).all()
    if mode == AutoresetMode.DISABLED:
        seen, _ = env.reset(options={"reset_mask": truncated})
    if mode == AutoresetMode.NEXT_STEP:
        seen, rewards, *_ = env.step(full)
        assert not rewards.any()
    assert not seen[:, rates].any() and env.batch.time.tolist() == [0.0, 0.0]
    assert not env.episodes.view.action.any() and len(base.resets) == 2
    *_, infos = env.step(np.zeros((2, 3)))
    assert (infos["reward_terms"]["effort"] == 0.1).all(), "no torque was asked for since the reset"


SHAPED = {"base": "privileged-lqr", "actions": "shaping", "sensors": ()}  # the mode reads before the agent acts, too


@pytest.mark.parametrize(
    "settings",
    [pytest.param({"base": "pd"}, id="torque"), pytest.param(SHAPED, id="shaping", marks=pytest.mark.feature)],
)
@pytest.mark.parametrize("hold", [1, 4])
def test_sensors_are_read_once_a_period_at_most(hold, settings, monkeypatch):
    """Those of the agent once an action, those of the base once a period; also where an episode ends on the way."""
    reads = []
    env = FlexManEnv(action_repeat=hold, horizon=0.3, **settings)
    for part in (env.sensors, env.episodes.measurements._base_sensors):
        inner = part.read
        monkeypatch.setattr(part, "read", lambda part=part, inner=inner: (reads.append(part), inner()))
    env.reset(seed=0)
    reads.clear()
    steps = -(-15 // hold)
    for _ in range(steps):
        *_, truncated, _ = env.step(np.zeros(env.action_space.shape))
    assert truncated and [part is env.sensors for part in reads].count(True) == steps and len(reads) == steps + 15


def test_a_horizon_that_is_no_multiple_of_the_hold_ends_the_episode_when_it_is_over():
    env = FlexManEnv(action_repeat=4, horizon=0.2)
    env.reset(seed=0)
    ends = [env.step(np.zeros(3))[3] for _ in range(3)]
    assert ends == [False, False, True] and env.simulator.time == pytest.approx(0.2)
    arms = gym.make_vec("FlexRRR-v0", 1, "vector_entry_point", action_repeat=4, horizon=0.2)
    assert arms.unwrapped.max_episode_steps == 3


# The base


@pytest.mark.parametrize("sensors", ["fine", ("full", "fine"), (FullState(),)])
def test_a_base_gets_the_sensors_that_it_names_whatever_the_agent_sees(sensors):
    bases = [Recorder(sensors=("full",)), Recorder(sensors=("full",))]
    envs = [FlexManEnv(base=bases[0]), FlexManEnv(base=bases[1], sensors=sensors)]
    for env in envs:
        env.reset(seed=1)
        for action in actions(1, 5):
            env.step(action[0])
    for one, other in zip(bases[0].readings, bases[1].readings, strict=True):
        assert one.keys() == other.keys() == set(envs[0].sensors.slices)
        assert all(np.array_equal(one[name], other[name]) for name in one)


def test_a_base_sees_the_moment_and_learns_of_every_episode():
    base = Recorder()
    env = FlexManEnv(base=base, action_repeat=2)
    _, info = env.reset(seed=1)
    ((arms, start, posture),) = base.resets
    assert arms.tolist() == [0] and np.array_equal(posture[0], info["goal_angles"])
    assert np.array_equal(start[0], env.episodes.view.episode_parameters["start"][0])
    env.step(np.ones(3))
    assert np.array_equal(base.readings[0]["motor_angles"][0], start[0])
    assert (base.readings[1]["motor_rates"] > 0).all(), "the second period starts where the first ended"


def test_a_base_and_the_agent_see_the_same_measurements():
    base = Recorder()
    env = FlexManEnv(base=base, randomisation={"sensor_noise": (0.01, 0.01)})
    observation, _ = env.reset(seed=1)
    for _ in range(5):
        env.step(np.zeros(3))
        seen = {name: observation[place] for name, place in env.sensors.slices.items()}
        for name in ("motor_angles", "angle_errors", "target_nearness"):
            assert base.readings[-1][name][0].astype(np.float32) == pytest.approx(seen[name], abs=0)
        observation = env.unwrapped.episodes.agent.observations[0].copy()


@pytest.mark.parametrize(("asked", "given", "sum_"), [(0.8, 0.8, 1.0), (-0.7, -0.6, -1.0), (0.5, -0.25, 0.25)])
def test_base_and_action_add_up_and_saturate(asked, given, sum_):
    together, alone = FlexManEnv(base=Recorder(asked)), FlexManEnv()
    for env in (together, alone):
        env.reset(seed=3)
    for _ in range(10):
        equal(together.step(np.full(3, given)), alone.step(np.full(3, sum_)))
    assert together.episodes.view.action.tolist() == [[sum_] * 3]


def test_a_base_by_name_is_the_controller_itself():
    """With a zero action, the same bits as its own object as a base; the effort is what both ask for."""
    named, own = FlexManEnv(base="pd"), FlexManEnv()
    pd = make_base("pd", make_plant(own.configuration, own.simulator.model))
    own = FlexManEnv(base=pd)
    assert isinstance(named.episodes.base, PD)
    for env in (named, own):
        env.reset(seed=3)
    for _ in range(20):
        one = named.step(np.zeros(3))
        equal(one, own.step(np.zeros(3)))
        effort = np.mean(named.episodes.view.action**2)
        assert one[4]["reward_terms"]["effort"] == pytest.approx(0.1 * (1 - effort))


def test_history_is_the_last_observations_the_newest_first():
    env, plain = FlexManEnv(history=3), FlexManEnv()
    size = plain.observation_space.shape[0]
    seen, past = env.reset(seed=2)[0], [plain.reset(seed=2)[0]] * 3
    for _ in range(6):
        assert np.array_equal(seen, np.concatenate(past))
        action = np.full(3, 0.4)
        seen, past = env.step(action)[0], [plain.step(action)[0], *past[:2]]
    assert env.observation_space.shape == (3 * size,) and np.array_equal(seen[:size], past[0])


@pytest.mark.parametrize("hold", [1, 4])
def test_averages_fade_with_their_times(hold):
    """A motor angle that rises evenly lags behind by the time of the average, once it has forgotten the start.

    An action that is held for longer leaves more time to fade between two observations.
    """
    times, interval = (0.1, 0.4), 0.02 * hold
    env = FlexManEnv(sensors="motor_encoders", history=times, action_repeat=hold)
    plain = FlexManEnv(sensors="motor_encoders", action_repeat=hold)
    seen, now = env.reset(seed=2)[0], plain.reset(seed=2)[0].astype(float)
    expected = [now, now]
    for _ in range(40 // hold):
        result = seen.reshape(3, -1)
        assert result[0] == pytest.approx(now, abs=1e-6) and result[1:] == pytest.approx(np.array(expected), abs=1e-5)
        seen, now = env.step(np.full(3, 0.2))[0], plain.step(np.full(3, 0.2))[0].astype(float)
        expected = [np.exp(-interval / time) * old + (1 - np.exp(-interval / time)) * now
                    for time, old in zip(times, expected, strict=True)]  # fmt: skip


@pytest.mark.parametrize("hold", [1, 3])
@pytest.mark.parametrize("mode", ["NextStep", "SameStep", "Disabled"])
def test_an_episode_that_fails_ends_with_what_was_seen_last(mode, hold):
    """All arms of an environment fail in one step: nothing new is seen then."""
    settings = {"history": 4, "action_repeat": hold, "limits": fm.Limits(rate=0.5)}
    env, many = FlexManEnv(**settings), FlexManVectorEnv(1, autoreset_mode=mode, **settings)
    before, _ = env.reset(seed=3)
    many.reset(seed=3)
    for action in actions(1, 1000):
        seen, _, failed, _, _ = env.step(action[0])
        observations, _, failures, _, infos = many.step(action)
        last = infos["final_obs"][0] if failed and mode == "SameStep" else observations[0]
        assert failed == failures[0] and np.array_equal(last, seen)
        if failed:
            break
        before = seen
    assert failed and np.array_equal(seen, before)

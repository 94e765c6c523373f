"""State: an environment that is given the state of another goes on as that one does, to the last bit."""

import copy
import pickle

import gymnasium as gym
import numpy as np
import pytest

import flexman_gym  # noqa: F401
from flexman_gym.common.run_folder import read_npz, write_npz
from flexman_gym.envs.vector_env import FlexManVectorEnv

from oracles.assertions import refusal

EVERYTHING = {
    "payload_mass": (0.0, 5.0), "joint_stiffness_factor": (0.8, 1.2), "torque_limit_factor": (0.9, 1.1),
    "delay": (0, 2), "sensor_noise": (0.0, 0.01), "tip_impulse": (0.0, 5.0), "initial_vibration": (0.0, 0.02),
    "impulse_gap": 0.2,
}  # fmt: skip
SETTINGS = [
    {},
    {"randomisation": EVERYTHING, "horizon": 0.9},
    {"randomisation": EVERYTHING, "base": "pd", "action_repeat": 3, "stiffening": True},
    {"base": "lqr-tracking"},
    {"base": {"kind": "pd-shaped", "duration": 2.0}},
    {"base": "pd-torque", "randomisation": {"payload_mass": (0.0, 5.0)}},
    {"base": "lqr", "randomisation": {"payload_mass": (0.0, 5.0)}},
    {"condition": "unmodelled"},
    {"method": "implicit_midpoint", "randomisation": {"payload_mass": (0.0, 5.0)}},
    {"method": "dopri5", "step": None, "modes": 1},
]


def played(env, steps=25):
    """What an environment does under actions of its own space; episodes that are over begin anew."""
    rows = []
    for _ in range(steps):
        observation, reward, terminated, truncated, info = env.step(env.action_space.sample())
        rows.append([observation, reward, terminated, truncated, info["tip"], info["energy_residual"]])
        if not isinstance(env.unwrapped, gym.vector.VectorEnv) and (terminated or truncated):
            rows.append([env.reset()[0]])
    return rows


def same(first, second):
    """Whether two records agree in every bit."""
    return len(first) == len(second) and all(
        np.array_equal(a, b) for one, other in zip(first, second, strict=True) for a, b in zip(one, other, strict=True)
    )


def begun(make, steps=33):
    """An environment in the middle of its episodes."""
    env = make()
    env.reset(seed=4)
    env.action_space.seed(5)
    played(env, steps)
    return env


def makers(settings):
    """Makers of a single environment and of one of three arms."""
    return (
        lambda: gym.make("FlexRRR-v0", **settings),
        lambda: gym.make_vec("FlexRRR-v0", 3, "vector_entry_point", **settings),
    )


@pytest.mark.feature
@pytest.mark.slow
@pytest.mark.parametrize("many", [0, 1])
@pytest.mark.parametrize("settings", SETTINGS, ids=lambda settings: "-".join(settings) or "plain")
def test_an_environment_made_alike_goes_on_from_a_state(settings, many, tmp_path):
    """The state goes through JSON and arrays, as a file would hold it; the other has lived before."""
    make = makers(settings)[many]
    env, other = begun(make), make()
    other.reset(seed=77)
    played(other, 7)
    write_npz(tmp_path / "state.npz", env.unwrapped.get_state())
    seen = other.unwrapped.set_state(read_npz(tmp_path / "state.npz"))
    assert np.array_equal(seen, env.unwrapped.episodes.agent.observations)
    assert same(played(env), played(other))


def pickled(env):
    return pickle.loads(pickle.dumps(env))


@pytest.mark.parametrize("duplicate", [copy.copy, copy.deepcopy, pickled])
@pytest.mark.parametrize("many", [0, 1])
def test_a_copy_goes_on_alike_and_alone(many, duplicate):
    env = begun(makers({"randomisation": EVERYTHING, "base": "pd"})[many]).unwrapped
    other, state = duplicate(env), env.get_state()
    first = played(env)
    assert same(first, played(other))
    env.set_state(state)
    assert same(first, played(env))


def test_a_state_is_nobody_elses_memory():
    """What was taken stays as it was while the environment goes on, and what was handed out stays too."""
    env = begun(makers({"randomisation": EVERYTHING})[1])
    state = env.unwrapped.get_state()
    info = env.reset()[1]
    kept = copy.deepcopy(info["drawn"])
    first = copy.deepcopy(state["episodes"])
    played(env)
    env.unwrapped.set_state(state)
    assert all(np.array_equal(kept[name], info["drawn"][name]) for name in EVERYTHING.keys() & kept.keys())
    again = env.unwrapped.get_state()["episodes"]
    np.testing.assert_equal(again, first)


def test_what_a_state_shows_stays_as_it_was():
    env = begun(makers({})[1]).unwrapped
    seen = env.set_state(env.get_state())
    before = seen.copy()
    played(env)
    assert np.array_equal(seen, before)


def test_an_environment_that_was_never_reset_has_a_state():
    make = makers({})[0]
    env, other = make(), begun(make)
    other.unwrapped.set_state(env.unwrapped.get_state())
    with pytest.raises(RuntimeError, match="reset the environment first"):
        other.unwrapped.step(np.zeros(3))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("settings", "line"),
    [
        (
            {"modes": 1},
            "state.episodes.batch.rows: 'array (3, 46) of float64' is not allowed; give an array (3, 20) of",
        ),
        ({"randomisation": {"delay": (0, 1)}}, "state.episodes.effects: None is not allowed; give a mapping"),
        pytest.param(
            {"base": "lqr-tracking"}, "state.agent.base: None is not allowed; give a mapping", marks=pytest.mark.feature
        ),
    ],
)
def test_the_state_of_another_environment_is_refused_in_one_line(settings, line):
    env, other = begun(makers({})[1]), begun(makers(settings)[1])
    assert refusal(other.unwrapped.set_state, env.unwrapped.get_state()).startswith(line)
    other.reset(seed=1)
    played(other, 3)


@pytest.mark.parametrize("state", [None, [], {}, {"episodes": {}}, 3.0])
def test_something_else_than_a_state_is_refused_in_one_line(state):
    line = refusal(begun(makers({})[0], 1).unwrapped.set_state, state)
    assert line.startswith("state: ") and "give a result of get_state: _np_random" in line


def test_a_broken_generator_is_refused_in_one_line():
    env = begun(makers({})[0], 1)
    state = env.unwrapped.get_state()
    state["_np_random"]["state"] = {"state": -1}
    assert refusal(env.unwrapped.set_state, state).startswith(
        "state._np_random: this is no state of a random generator"
    )


def test_what_a_controller_remembers_is_kept():
    """One that turns round after every action names what it remembers."""

    class Turning:
        sensors, state_fields = ("servo",), ("way",)

        def __init__(self):
            self.way = np.ones(3)

        def reset(self, arms, episode, count):
            self.way[arms] = 1.0

        def act(self, readings, applied=None, playing=None):
            self.way = -self.way
            return 0.1 * self.way[:, None] * np.ones_like(readings["motor_rates"])

    env = FlexManVectorEnv(3, base=Turning())
    env.reset(seed=0)
    env.step(np.zeros((3, 3)))
    other = FlexManVectorEnv(3, base=Turning())
    other.set_state(env.get_state())
    assert same([env.step(np.zeros((3, 3)))[:2]], [other.step(np.zeros((3, 3)))[:2]])

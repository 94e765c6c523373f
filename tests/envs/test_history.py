"""History: what an agent has seen before, beside what it sees now, whatever ends an episode."""

import numpy as np
import pytest

import flexman_gym as fm
from flexman_gym.envs.env import FlexManEnv
from flexman_gym.envs.vector_env import FlexManVectorEnv

from oracles.episodes import actions


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
    env = FlexManEnv(sensors="motor_encoders", history=times, hold=hold)
    plain = FlexManEnv(sensors="motor_encoders", hold=hold)
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
    settings = {"history": 4, "hold": hold, "limits": fm.Limits(rate=0.5)}
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

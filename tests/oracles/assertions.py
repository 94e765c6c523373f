"""Assertions of equality: keys, types, shapes and bits of returned values."""

import re

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.vector import AutoresetMode

from flexman_gym.common.errors import short_repr


def same(result, expected, name=""):
    """Assert equal keys, types, shapes and bits."""
    assert type(result) is type(expected), name
    if isinstance(result, dict):
        assert result.keys() == expected.keys(), name
        for key in result:
            same(result[key], expected[key], f"{name} {key}")
        return
    assert result.dtype == expected.dtype and result.shape == expected.shape, name
    if result.dtype == object:
        for one, other in zip(result, expected, strict=True):
            assert type(one) is type(other) and np.array_equal(one, other), name
    else:
        assert np.array_equal(result, expected), name


def same_alone_and_among_others(name, steps=60, **settings):
    """Assert that three arms of the vector environment equal three single ones bit by bit, spaces included."""
    ours, theirs = (gym.make_vec(name, 3, mode, **settings) for mode in ("vector_entry_point", "sync"))
    assert ours.observation_space == theirs.observation_space and ours.action_space == theirs.action_space
    for result, expected in zip(ours.reset(seed=1), theirs.reset(seed=1), strict=True):
        same(result, expected, "reset")
    ours.action_space.seed(0)
    for step in range(steps):
        action = ours.action_space.sample()
        for result, expected in zip(ours.step(action), theirs.step(action), strict=True):
            same(result, expected, f"step {step}")


def same_side_by_side(ours, theirs, actions, seed=5):
    """Assert that an environment of many arms equals single ones bit by bit; return the number of ends of each kind.

    Where episodes do not begin again by themselves, those that ended are reset.
    """
    for actual, expected in zip(ours.reset(seed=seed), theirs.reset(seed=seed), strict=True):
        same(actual, expected, "reset")
    terminated = truncated = 0
    for step, action in enumerate(actions):
        result = ours.step(action)
        for actual, expected in zip(result, theirs.step(action), strict=True):
            same(actual, expected, f"step {step}")
        terminated, truncated = terminated + result[2].sum(), truncated + result[3].sum()
        ended = result[2] | result[3]
        if ours.metadata["autoreset_mode"] == AutoresetMode.DISABLED and ended.any():
            both = (env.reset(options={"reset_mask": ended.copy()}) for env in (ours, theirs))
            for actual, expected in zip(*both, strict=True):
                same(actual, expected, f"{step} reset")
    return terminated, truncated


def refusal(action, *arguments) -> str:
    """Return the one-line error message of a call."""
    with pytest.raises(ValueError) as error:
        action(*arguments)
    assert "\n" not in str(error.value) and len(re.sub(r"/\S*/", "", str(error.value))) < 450  # names of all settings
    return str(error.value)


def offenders(action, values, good) -> list[str]:
    """Return the values that an action wrongly accepts or rejects, each with its message.

    `good` judges the line of a refusal, which is "" for a value that is taken; another error is never good.
    """
    result = []
    for value in values:
        try:
            action(value)
            line = ""
        except ValueError as error:
            line = str(error) or repr(error)
        except Exception as error:
            result.append(f"{short_repr(value)} gives {type(error).__name__}: {error}")
            continue
        if not good(line):
            result.append(f"{short_repr(value)} is refused with {line}" if line else f"{short_repr(value)} is taken")
    return result

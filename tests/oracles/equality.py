"""Equality: the same keys, types, shapes and bits of what environments return."""

import gymnasium as gym
import numpy as np


def same(result, expected, name=""):
    """Asserts the same keys, types, shapes and bits."""
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
    """Asserts that three arms of our vector environment are three single ones, from their spaces to their last bits."""
    ours, theirs = (gym.make_vec(name, 3, mode, **settings) for mode in ("vector_entry_point", "sync"))
    assert ours.observation_space == theirs.observation_space and ours.action_space == theirs.action_space
    for result, expected in zip(ours.reset(seed=1), theirs.reset(seed=1), strict=True):
        same(result, expected, "reset")
    ours.action_space.seed(0)
    for step in range(steps):
        action = ours.action_space.sample()
        for result, expected in zip(ours.step(action), theirs.step(action), strict=True):
            same(result, expected, f"step {step}")

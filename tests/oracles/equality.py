"""Equality: the same keys, types, shapes and bits of what environments return."""

import gymnasium as gym
import numpy as np


def same(found, expected, name=""):
    """Asserts the same keys, types, shapes and bits."""
    assert type(found) is type(expected), name
    if isinstance(found, dict):
        assert found.keys() == expected.keys(), name
        for key in found:
            same(found[key], expected[key], f"{name} {key}")
        return
    assert found.dtype == expected.dtype and found.shape == expected.shape, name
    if found.dtype == object:
        for one, other in zip(found, expected, strict=True):
            assert type(one) is type(other) and np.array_equal(one, other), name
    else:
        assert np.array_equal(found, expected), name


def same_alone_and_among_others(name, steps=60, **settings):
    """Asserts that three arms of our vector environment are three single ones, from their spaces to their last bits."""
    ours, theirs = (gym.make_vec(name, 3, mode, **settings) for mode in ("vector_entry_point", "sync"))
    assert ours.observation_space == theirs.observation_space and ours.action_space == theirs.action_space
    for found, expected in zip(ours.reset(seed=1), theirs.reset(seed=1), strict=True):
        same(found, expected, "reset")
    ours.action_space.seed(0)
    for step in range(steps):
        action = ours.action_space.sample()
        for found, expected in zip(ours.step(action), theirs.step(action), strict=True):
            same(found, expected, f"step {step}")

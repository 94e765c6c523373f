"""Alike: random steps of one arm many times over and of many arms at once, which have to be the same to the bit."""

from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium.vector import AutoresetMode

PARTS = ("observations", "rewards", "terminated", "truncated")
HELD = 7  # actions for which random torques stay, so that limits are met


def alike(name: str, steps: int, arms: int, mode: AutoresetMode, **settings: Any) -> int:
    """Takes so many steps of all arms of a named environment; returns the number of failures that were seen.

    Raises:
        AssertionError: for the first number that is another, with step and part.
    """
    ours = gym.make_vec(name, arms, "vector_entry_point", autoreset_mode=mode, **settings)
    single = gym.make_vec(name, arms, "sync", vector_kwargs={"autoreset_mode": mode}, **settings)
    ours.action_space.seed(0)
    assert np.array_equal(ours.reset(seed=0)[0], single.reset(seed=0)[0]), "reset"
    failures = 0
    for step in range(-(-steps // arms)):
        if step % HELD == 0:
            action = ours.action_space.sample()
        result, expected = ours.step(action), single.step(action)
        for part, one, other in zip(PARTS, result, expected, strict=False):
            assert np.array_equal(one, other), f"{part} after {step} steps"
        failures += int(result[2].sum())
        over = result[2] | result[3]
        if mode == AutoresetMode.DISABLED and over.any():
            observations = [env.reset(options={"reset_mask": over.copy()})[0][over] for env in (ours, single)]
            assert np.array_equal(*observations), f"reset after {step} steps"
    return failures

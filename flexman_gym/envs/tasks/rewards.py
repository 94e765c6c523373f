"""Rewards: the distance reward, and reward terms with weights or a reward function of the user."""

from collections.abc import Callable
from typing import Any

import numpy as np

from flexman_gym.common.arrays import Array, row_dots
from flexman_gym.common.checks import mapping, short_repr
from flexman_gym.envs.view import Number, View

NEAR, FAR = 1.0 / 425.0, 1.0 / 1.7  # fractions of the reach; n and f of `distance_reward`
LOOK_AHEAD = 0.1  # s; weight of the velocity relative to the tip error in `distance_reward`


def distance_reward(view: View, velocity: Array) -> Number:
    """Return the distance reward, a logarithm of the tip error and a velocity.

    The reward is 1 - ln(1 + (e^2 + (0.1 s v)^2) / n^2) / ln(1 + (f / n)^2) with the tip error e, the magnitude v of the
    velocity, n = R / 425 and f = R / 1.7 for a reach R (20 mm and 5 m for R = 8.5 m). It is 1 at rest on the target, 0
    at rest at the distance f, and negative for larger distances. It changes noticeably at errors of metres and of
    millimetres.

    Args:
        view: view of the arms.
        velocity: (..., 3) velocity of the tip, for a moving target relative to the target, m/s.
    """
    near, far, displacement = NEAR * view.reach, FAR * view.reach, LOOK_AHEAD * velocity
    square = view.tip_error * view.tip_error + row_dots(displacement, displacement)
    return 1.0 - np.log1p(square / near**2) / np.log1p((far / near) ** 2)


def make_reward_terms(task: Any, reward: Any) -> Callable[[View], dict[str, Number]]:
    """Return the function that computes the reward terms of a View by name.

    Args:
        task: task with the method `reward_terms`.
        reward: None for the terms of the task, a mapping of weights of these terms, or a function of a View; the result
            of the function is the only term and has the name "own".
    """
    if reward is None:
        terms: Callable[[View], dict[str, Number]] = task.reward_terms
        return terms
    if not isinstance(reward, dict):
        return lambda view: {"own": _call_reward(reward, view)}

    def weighted(view: View) -> dict[str, Number]:
        terms = task.reward_terms(view)
        mapping("reward", reward, terms)
        return {name: reward.get(name, 1.0) * each for name, each in terms.items()}

    return weighted


def _call_reward(reward: Callable[[View], Number], view: View) -> Number:
    """Return the result of a reward function, a number or an array (b,), after a check."""
    try:
        value = reward(view)
        valid = np.asarray(value).dtype.kind in "biuf" and np.shape(value) in ((), np.shape(view.tip_error))
        message, cause = f"returned {short_repr(value)}, not a number for each arm", None
    except Exception as error:
        valid, message, cause = False, f"raised {type(error).__name__}: {error}", error
    if valid:
        return value
    names = [name for name in dir(view) if not (name.startswith("_") or callable(getattr(type(view), name, None)))]
    function = getattr(reward, "__name__", type(reward).__name__)
    raise ValueError(f"reward: {function} {' '.join(message.split())}; a View has {', '.join(names)}") from cause

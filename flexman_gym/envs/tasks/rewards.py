"""Rewards: distance reward, and the reward terms of a task with weights or a user's function."""

from collections.abc import Callable, Mapping
from functools import reduce
from operator import add
from typing import Any

import numpy as np

from flexman_gym.common.arrays import Array, row_dots
from flexman_gym.common.checks import mapping, short_repr
from flexman_gym.envs.view import Number, View

# fractions of the reach; distances of reward near 1 and of 0, and time (s) by which a velocity counts as a distance
NEAR, FAR, LOOK_AHEAD = 1.0 / 425.0, 1.0 / 1.7, 0.1


def distance_reward(view: View, velocity: Array) -> Number:
    """Return a logarithmic reward of the tip error and a velocity.

    The reward is 1 - ln(1 + (e^2 + (0.1 s v)^2) / n^2) / ln(1 + (f / n)^2) with the tip error e, the magnitude v of the
    velocity, n = R / 425 and f = R / 1.7 for a reach R (20 mm and 5 m for 8.5 m). It is 1 at rest on the target, 0 at
    the distance f and negative beyond, and increases from metres down to millimetres.

    Args:
        view: view of the arms.
        velocity: (..., 3) m/s, of the tip, or relative to a moving target.
    """
    near, far, moving = NEAR * view.reach, FAR * view.reach, LOOK_AHEAD * velocity
    square = view.tip_error * view.tip_error + row_dots(moving, moving)
    return 1.0 - np.log1p(square / near**2) / np.log1p((far / near) ** 2)


def make_reward_terms(task: Any, reward: Any) -> Callable[[View], dict[str, Number]]:
    """Return the function that computes the reward terms of a View.

    Args:
        task: task with terms of its own.
        reward: None; weights of terms; or a function of a View, whose result is the only term, "own".
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


def sum_terms(terms: Mapping[str, Number]) -> Number:
    """Return the sum of the terms in their order.

    The built-in `sum` compensates the rounding of floats from Python 3.12 on, but not that of arrays: the reward of a
    single arm would then differ in the last bit from that of the same arm among others.
    """
    return reduce(add, terms.values(), 0.0)


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

"""Rewards: compiled reward terms, and the reward terms of a task with weights or a user's function."""

import math
from collections.abc import Callable, Mapping
from functools import cache
from inspect import getattr_static
from typing import Any, NamedTuple

import numpy as np

from flexman_gym.common.arrays import Array
from flexman_gym.common.checks import mapping
from flexman_gym.common.errors import short_repr
from flexman_gym.envs.view import Number, View
from flexman_gym.kernels import control_period as kernels

NEAR, FAR = 1.0 / 425.0, 1.0 / 1.7  # fractions of the reach; n and f of `distance_reward`
LOOK_AHEAD = 1.0 / 32.0  # fraction of the slew time; weight of the velocity beside the tip error in `distance_reward`
BELL_WIDTHS = (2.0 / 8.5, 0.4 / 8.5, 0.08 / 8.5)  # fractions of the reach; widths w of the reward "bells"
# reward "exponential": term -> weight, and length l as a fraction of the reach
EXPONENTIAL_TERMS = {"far": (0.1, 0.6 / 8.5), "near": (0.25, 0.15 / 8.5), "at_goal": (0.65, 0.03 / 8.5)}
# Fraction of the reach per second; tip vibration at which its reward term is halved. In units of the slew time, gains
# that `tune` optimises for an arm with a slew time of 0.5 s settle it in 0.84 s instead of 0.74 s.
VIBRATION_SCALE = 0.3 / 8.5


class _Reward(NamedTuple):
    """Compiled reward.

    Attributes:
        kind: kind of the reward in `kernels.control_period`.
        names: names of its terms.
        parameters: function from reach (m) and slew time (s) to the parameters of
            `kernels.control_period.reward_terms`.
    """

    kind: int
    names: tuple[str, ...]
    parameters: Callable[[float, float], Array]

    def terms(self, view: View, velocity: Array | None = None) -> dict[str, Number]:
        """Return the terms of the reward, name -> (...), as numbers for a single arm.

        All arms take them from one kernel, as the last digit of NumPy's logarithms depends on the processor.

        Args:
            view: view of the arms.
            velocity: (..., 3) m/s, as in `distance_reward`; None for a reward that does not depend on the velocity.
        """
        errors = np.array(view.tip_error, dtype=float, ndmin=1)
        vibrations, efforts, velocities = errors, errors, np.zeros((1, 3))
        if self.kind == kernels.BELLS:
            vibrations, efforts = (np.array(each, dtype=float, ndmin=1) for each in (view.tip_vibration, view.effort))
        if velocity is not None:
            velocities = np.array(velocity, dtype=float, ndmin=2)
        out = np.empty((kernels.REWARD_TERMS, len(errors)))
        kernels.reward_terms(
            self.kind, self.parameters(view.reach, view.slew_time), errors, vibrations, efforts, velocities, out
        )
        return dict(zip(self.names, out if np.ndim(view.tip_error) else out[:, 0].tolist(), strict=False))

    def derivatives(self, view: View, velocity: Array, changes: Mapping[str, Array]) -> dict[str, Array]:
        """Return the derivatives (p,) of the terms with respect to p parameters, by name.

        Args:
            view: view of one arm.
            velocity: (1, 3) as in `distance_reward`, m/s.
            changes: derivatives of "tip_error", "tip_vibration", "effort", (p,) each, and of "tip_velocity" (p, 3).
        """
        p, error, change = self.parameters(view.reach, view.slew_time), view.tip_error, changes["tip_error"]
        terms: list[Array]
        if self.kind == kernels.DISTANCE:
            total = error**2 + p[2] ** 2 * (velocity**2).sum()
            total_change = 2.0 * (error * change + p[2] ** 2 * (changes["tip_velocity"] @ velocity[0]))
            terms = [-total_change / ((p[0] + total) * p[1])]
        elif self.kind == kernels.EXPONENTIAL:
            terms = [-(p[j] / p[3 + j]) * np.exp(-error / p[3 + j]) * change for j in range(3)]
        else:
            vibration = view.tip_vibration
            near = (p[:3] / (p[:3] + error**2) ** 2).sum()
            terms = [-0.7 / 3.0 * near * 2.0 * error * change]
            terms += [-0.2 * p[3] / (p[3] + vibration**2) ** 2 * 2.0 * vibration * changes["tip_vibration"]]
            terms += [-0.1 * changes["effort"]]
        return dict(zip(self.names, terms, strict=False))


@cache
def _bell_parameters(reach: float, slew_time: float) -> Array:
    return np.array([*((part * reach) ** 2 for part in BELL_WIDTHS), (VIBRATION_SCALE * reach) ** 2])


@cache
def _distance_parameters(reach: float, slew_time: float) -> Array:
    near, far = NEAR * reach, FAR * reach
    return np.array([near**2, math.log1p((far / near) ** 2), LOOK_AHEAD * slew_time])


@cache
def _exponential_parameters(reach: float, slew_time: float) -> Array:
    weights, lengths = zip(*EXPONENTIAL_TERMS.values(), strict=True)
    return np.array([*weights, *(length * reach for length in lengths)])


REWARDS = {
    "bells": _Reward(kernels.BELLS, ("tip_error", "tip_vibration", "effort"), _bell_parameters),
    "distance": _Reward(kernels.DISTANCE, ("distance",), _distance_parameters),
    "exponential": _Reward(kernels.EXPONENTIAL, tuple(EXPONENTIAL_TERMS), _exponential_parameters),
}
"""Compiled rewards by name."""


def distance_reward(view: View, velocity: Array) -> Number:
    """Return the distance reward, a logarithm of the tip error and a velocity.

    The reward is 1 - ln(1 + (e^2 + (T v / 32)^2) / n^2) / ln(1 + (f / n)^2) with the tip error e, the magnitude v of
    the velocity, the slew time T, n = R / 425 and f = R / 1.7 for a reach R (20 mm and 5 m for R = 8.5 m). It is 1 at
    rest on the target, 0 at rest at the distance f, and negative for larger distances. It changes noticeably at errors
    of metres and of millimetres.

    Args:
        view: view of the arms.
        velocity: (..., 3) velocity of the tip, for a moving target relative to the target, m/s.
    """
    result: Number = REWARDS["distance"].terms(view, velocity)["distance"]
    return result


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
    names = [name for name in dir(view) if not (name.startswith("_") or callable(getattr_static(view, name, None)))]
    function = getattr(reward, "__name__", type(reward).__name__)
    raise ValueError(f"reward: {function} {' '.join(message.split())}; a View has {', '.join(names)}") from cause

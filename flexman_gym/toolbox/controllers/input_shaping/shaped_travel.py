"""Shaped travel of a foundation: a velocity profile within the limits of its servo, convolved with a shaper."""

import math
from collections.abc import Callable
from typing import Any

import numpy as np

from flexman_gym.agent.controller import Readings
from flexman_gym.common.arrays import Array, IntArray, Vector
from flexman_gym.toolbox.controllers.input_shaping.shapers import Shaper, convolve_samples

ACCELERATION_SHARE = 0.95  # of the largest acceleration; the rest is left to the feedback
FEEDBACK_TIME = 5.0  # control periods; time constant in which an error of the position decays


class ShapedTravel:
    """Travel of b foundations from start to goal by a shaped velocity profile, with feedback of the position.

    The profile is a trapezoid of the velocity, or a triangle for a short way.

    Args:
        foundation: `foundations.travel.Travel`, the axis and its limits.
        shaper: function of a posture (n,), rad, and the axis (3,) that returns the shaper.
    """

    def __init__(self, foundation: Any, shaper: Callable[[Array, Vector], Shaper]) -> None:
        self._foundation, self._shaper = foundation, shaper
        self._profiles: dict[int, tuple[Array, Array]] = {}  # arm -> positions, m, and velocities, m/s, at the periods
        self._period = 0.0

    def begin(self, arm: int, posture: Array, ends: Array, period: float) -> None:
        """Compute the profile of an arm with a goal posture (n,), rad, between start and goal (2,), m."""
        self._period = period
        fractions = self._shaper(posture, self._foundation.axis).sample(period)
        velocities = velocity_profile(float(ends[1] - ends[0]), self._foundation, period)
        padded = np.concatenate([velocities, np.zeros(len(fractions) + 1)])
        shaped = convolve_samples(fractions, padded[:, None])[:, 0]
        before = np.concatenate([[0.0], shaped[:-1]])
        positions = ends[0] + np.concatenate([[0.0], np.cumsum(0.5 * (before + shaped) * period)])
        self._profiles[arm] = positions, shaped

    def commands(self, readings: Readings, now: IntArray) -> Array:
        """Return the velocities (b, 1) as fractions of the largest, in the control periods `now` (b,) of the arms."""
        result = np.zeros((len(now), 1))
        for arm, (positions, velocities) in self._profiles.items():
            k = min(int(now[arm]), len(velocities) - 1)
            error = positions[min(int(now[arm]), len(positions) - 1)] - readings["travel"][arm, 0]
            result[arm] = (velocities[k] + error / (FEEDBACK_TIME * self._period)) / self._foundation.speed
        return result


def velocity_profile(distance: float, foundation: Any, period: float) -> Array:
    """Return the velocities (K,), m/s, at the ends of the control periods of a travel that ends at rest.

    They rise and fall with ACCELERATION_SHARE of the largest acceleration, and do not exceed the largest speed; those
    of a foundation that accelerates uniformly in each period cover the distance exactly.

    Args:
        distance: signed distance, m.
        foundation: `foundations.travel.Travel`.
        period: control period, s.
    """
    size, steep = abs(distance), ACCELERATION_SHARE * foundation.acceleration
    if size == 0.0:
        return np.zeros(1)
    top = min(foundation.speed, math.sqrt(steep * size))
    rise = max(1, math.ceil(top / (steep * period)))  # periods until the top, and from it to rest
    level = max(0, math.ceil(size / (top * period)) - rise)  # periods at the top
    shape = np.concatenate([np.arange(1, rise + 1) / rise, np.ones(level), np.arange(rise - 1, -1, -1) / rise])
    result: Array = shape * distance / (period * shape.sum())
    return result

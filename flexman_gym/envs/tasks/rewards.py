"""Rewards: what nearness to a target is worth, for the tasks."""

import numpy as np

from flexman_gym.arrays import Array, row_dots
from flexman_gym.simulation.view import Number, View

NEAR, FAR, LOOK_AHEAD = 1.0 / 425.0, 1.0 / 1.7, 0.1  # of the reach, and s


def distance_reward(view: View, velocity: Array) -> Number:
    """1 - ln(1 + (e^2 + (0.1 s v)^2) / n^2) / ln(1 + (f / n)^2), with slope at every scale.

    e is the tip error, v the length of a velocity (..., 3) m/s, n = R / 425 and f = R / 1.7 for a reach R, 20 mm and
    5 m for 8.5 m. It is 1 at rest on the target, 0 at the distance f and below zero beyond.
    """
    near, far, moving = NEAR * view.reach, FAR * view.reach, LOOK_AHEAD * velocity
    square = view.tip_error * view.tip_error + row_dots(moving, moving)
    return 1.0 - np.log1p(square / near**2) / np.log1p((far / near) ** 2)

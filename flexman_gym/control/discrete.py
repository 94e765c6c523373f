"""Discrete: a linear model as a controller with sampled torques meets it, and the optimal gain for it."""

from typing import NamedTuple

import numpy as np

from flexman_gym.arrays import Array
from flexman_gym.model.rounding import solvable
from flexman_gym.model.state_space import LinearModel, held


class Weights(NamedTuple):
    """Departures that weigh alike in the cost of an LQR: tip in m, its speed in m/s, motor angles in rad.

    Torques weigh as much where they reach their limits.
    """

    tip: float
    tip_speed: float
    motor: float


def zero_order_hold(linear: LinearModel, period: float) -> tuple[Array, Array]:
    """Gives the transition of states (2 d, 2 d) and of torques (2 d, n) over a period (s) of constant torques."""
    return held(linear.A, linear.B, period)


def optimal_gain(linear: LinearModel, motors: Array, limits: Array, weights: Weights, period: float) -> Array:
    """Gives the gain K (n, 2 d) of the sampled LQR: torques -K x, for departures x from the place of the model.

    Args:
        linear: the arm about a place where it rests.
        motors: (n,) columns of the motor angles in x.
        limits: (n,) N m, torque limits.
        weights: of the cost.
        period: s.

    Raises:
        ValueError: for an arm for which rounding leaves no such gain.
    """
    with solvable("gains of a regulator"):
        return _gain(linear, motors, limits, weights, period)


def weighted_outputs(linear: LinearModel, motors: Array, weights: Weights) -> Array:
    """Gives what a cost squares (6 + n, 2 d): tip, its velocity and motor angles, parts of their weights."""
    d, n = len(linear.A) // 2, len(motors)
    tip, outputs = linear.C[:, :d], np.zeros((6 + n, 2 * d))
    outputs[:3, :d], outputs[3:6, d:] = tip / weights.tip, tip / weights.tip_speed
    outputs[6:, motors] = np.eye(n) / weights.motor
    return outputs


def _gain(linear: LinearModel, motors: Array, limits: Array, weights: Weights, period: float) -> Array:
    from scipy.linalg import solve_discrete_are

    transition, inputs = zero_order_hold(linear, period)
    n, outputs = len(limits), weighted_outputs(linear, motors, weights)
    cost = np.diag(1.0 / limits**2)
    # torques in parts of their limits, so that the equation is well scaled
    scaled = inputs * limits
    solution = solve_discrete_are(transition, scaled, outputs.T @ outputs, cost * np.outer(limits, limits))
    gain = np.linalg.solve(np.eye(n) + scaled.T @ solution @ scaled, scaled.T @ solution @ transition)
    return limits[:, None] * gain

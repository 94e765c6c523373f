"""Regression of the torques of optimised slews on their start and goal."""

from typing import Self

import numpy as np

from flexman_gym.common.arrays import Array
from flexman_gym.model.dynamics import mass_matrix
from flexman_gym.model.model import Model
from flexman_gym.model.statics import first_angle_is_free, rest_state
from flexman_gym.toolbox.controllers.references.optimised_slews import SlewTable
from flexman_gym.toolbox.controllers.references.single_shooting import SlewTorques

MIRROR_TOLERANCE = 1e-9  # fraction of the largest inertia; coupling of the first joint of a mirrored arm
KNOTS = 20  # number of knots of a predicted slew
SCALES, RIDGES = (0.3, 0.5, 0.8, 1.2, 2.0), (1e-4, 1e-3, 1e-2, 1e-1)  # rad, 1; tried widths and ridge parameters


class SlewRegression:
    """Kernel ridge regression of knots and logarithmic duration of slews, with a Gaussian kernel.

    Width and ridge parameter have the least leave-one-out error of the knots, in closed form (Rasmussen and Williams,
    Gaussian Processes for Machine Learning, 2006, section 5.4.2).

    Args:
        table: optimised slews of the arm.
        limits: torque limits (n,), N m.
        turns: True for an arm whose motion does not depend on its first angle.
        mirrored: True for an arm whose motions with the opposite first angle are mirror images.

    Attributes:
        error: root mean square of the leave-one-out errors of the knots, fraction of the torque limits.
        duration_error: root mean square of those of the logarithmic duration.
        scale: width of the kernel, rad.
        ridge: ridge parameter, 1.
        mean: mean of the values of all slews.
    """

    def __init__(self, table: SlewTable, limits: Array, turns: bool = False, mirrored: bool = False) -> None:
        rows = table.found.values()
        self._limits, self._turns = limits, turns
        ends = np.array([each[0] for each in rows])
        values = np.array([self._values(each[1]) for each in rows])
        if mirrored:
            opposite = np.where(np.arange(len(limits)) == 0, -1.0, 1.0)
            images = values * np.append(np.tile(opposite, KNOTS), np.ones(2))
            ends, values = np.concatenate([ends, ends * opposite]), np.concatenate([values, images])
        self._known, self.mean = self._features(ends), values.mean(axis=0)
        deviations, count = values - self.mean, KNOTS * len(limits)
        best = (np.inf, np.inf, 0.0, 0.0, np.zeros((0, 0)))
        for scale in SCALES:
            for ridge in RIDGES:
                kernel = self._kernel(self._known, scale)
                inverse = np.linalg.inv(kernel + ridge * np.eye(len(kernel)))
                weights = inverse @ deviations
                left_out = weights / np.diag(inverse)[:, None]
                knots, duration = (float(np.sqrt(np.mean(e**2))) for e in np.split(left_out, [count], axis=1))
                if knots < best[0]:
                    best = knots, duration, scale, ridge, weights
        self.error, self.duration_error, self.scale, self.ridge, self._weights = best

    @classmethod
    def of_model(cls, table: SlewTable, model: Model, limits: Array) -> Self:
        """Return the regression for an arm with torque limits (n,), N m."""
        turns = first_angle_is_free(model)
        return cls(table, limits, turns, turns and _is_mirrored(model))

    def predict(self, start: Array, goal: Array) -> SlewTorques:
        """Return the predicted slew between motor angles (n,) rad; its times are fractions of control periods."""
        kernel = self._kernel(self._features(np.array([[start, goal]])), self.scale)[0]
        values = self.mean + kernel @ self._weights
        knots = np.clip(values[:-2].reshape(KNOTS, -1), -1.0, 1.0) * self._limits
        return SlewTorques(knots, max(1, round(float(np.exp(values[-2])))), max(1, round(float(np.exp(values[-1])))))

    def _values(self, slew: SlewTorques) -> Array:
        """Return the knots, as fractions of the limits, and the logarithms of periods and arrival of a slew."""
        at, given = np.linspace(0.0, 1.0, KNOTS), np.linspace(0.0, 1.0, len(slew.knots))
        knots = np.array([np.interp(at, given, column) for column in slew.knots.T]).T / self._limits
        return np.concatenate([knots.ravel(), np.log([slew.periods, slew.arrival])])

    def _features(self, ends: Array) -> Array:
        """Return the features (k, f) of starts and goals (k, 2, n), rad."""
        first = 1 if self._turns else 0
        return np.hstack([ends[:, 1] - ends[:, 0], ends[:, 0, first:], ends[:, 1, first:]])

    def _kernel(self, features: Array, scale: float) -> Array:
        """Return the kernel (r, k) of features (r, f) and those of the table."""
        squares = ((features[:, None] - self._known) ** 2).sum(axis=2)
        result: Array = np.exp(-squares / (2.0 * scale**2))
        return result


def _is_mirrored(model: Model) -> bool:
    """Return True for an arm whose mass matrix of joints and motors changes sign between the first angle and others.

    A mirror image of a motion about a plane through the first axis has the opposite first angle, and the same other
    angles: their coupling changes sign if the other joints turn about axes normal to this plane.
    """
    joints = np.concatenate([np.arange(model.n_joints), model.motor_columns])
    posture = np.linspace(0.4, 0.9, model.n_joints)
    matrix = mass_matrix(model, rest_state(model, posture))[np.ix_(joints, joints)]
    coupling = matrix[[0, model.n_joints]][:, np.setdiff1d(np.arange(len(joints)), [0, model.n_joints])]
    return bool(np.abs(coupling).max(initial=0.0) < MIRROR_TOLERANCE * np.abs(matrix).max())

"""Reference: a minimum-jerk slew of the motors, how the arm bends on it, and the torques that it takes."""

from typing import NamedTuple

import numpy as np

from flexman_gym.arrays import Array
from flexman_gym.checks import refusal
from flexman_gym.model.instant import inertial_forces, stiffness_matrix
from flexman_gym.model.model import Model
from flexman_gym.model.statics import rest_state

PASSES = 3  # of bending under the inertia of the bent arm
SAMPLES, LONGEST, BISECTIONS = 21, 60.0, 30


class Slew(NamedTuple):
    """A slew in T control periods, then rest.

    states: (T + 1, 2 d) at the ends of the periods. torques: (T, n) N m, constant in each.
    """

    states: Array
    torques: Array


def minimum_jerk(parts: Array) -> tuple[Array, Array, Array]:
    """Gives position, speed and acceleration of the minimum-jerk motion from 0 to 1 at parts (T,) of its duration.

    Flash and Hogan, Journal of Neuroscience 5 (1985), 1688.
    """
    s = np.clip(parts, 0.0, 1.0)
    position = s**3 * (10.0 - 15.0 * s + 6.0 * s**2)
    return position, 30.0 * s**2 * (1.0 - s) ** 2, 60.0 * s * (1.0 - s) * (1.0 - 2.0 * s)


class Path:
    """The slew of a model from one posture of its motors to another, (n,) rad each, for any duration.

    The links' sides of the joints follow the minimum-jerk motion between the two places of rest; the motors run ahead
    by what the springs are wound up, and the links bend as the inertia of that motion asks.
    """

    def __init__(self, model: Model, start: Array, goal: Array) -> None:
        n = model.n_joints
        first, last = (rest_state(model, posture)[: model.n_dof] for posture in (start, goal))
        self._model, self._start, self._way = model, first, last[:n] - first[:n]
        self._forces, self._stiffness = inertial_forces(model), stiffness_matrix(model)
        self._motors = model.motor_columns
        self._elastic = np.arange(n + model.n_motors, model.n_dof)
        self._inverse = np.linalg.inv(self._stiffness[np.ix_(self._elastic, self._elastic)])
        stiffness = np.where(model.constants.motor >= 0, model.constants.joint_stiffness, np.inf)
        self._compliance = 1.0 / stiffness

    def at(self, part: float, duration: float) -> tuple[Array, Array]:
        """Gives the bent coordinates (d,) and the motor torques (n,) N m at a part of a duration (s)."""
        position, speed, acceleration = (float(each) for each in minimum_jerk(np.array(part)))
        n, d = self._model.n_joints, self._model.n_dof
        x, rates, changes = self._start.copy(), np.zeros(d), np.zeros(d)
        x[:n] = self._start[:n] + position * self._way
        for columns in (np.arange(n), self._motors):
            rates[columns], changes[columns] = speed / duration * self._way, acceleration / duration**2 * self._way
        rotors = self._model.constants.rotor_inertia * changes[:n]
        for _ in range(PASSES):
            demand = self._forces(x, rates, changes)
            x = x.copy()
            x[self._elastic] = -self._inverse @ demand[self._elastic]
            links = demand[:n] - np.where(self._motors == np.arange(n), rotors, 0.0)
            x[self._motors] = x[:n] + self._compliance * links
        return x, links + rotors

    def peak(self, duration: float, limits: Array) -> float:
        """Gives the largest torque of a slew as a part of the limits (n,) N m."""
        torques = [self.at(part, duration)[1] for part in np.linspace(0.0, 1.0, SAMPLES)]
        return float(np.abs(np.array(torques) / limits).max())


def plan_slew(model: Model, start: Array, goal: Array, limits: Array, share: float, period: float) -> Slew:
    """Plans the quickest minimum-jerk slew whose torques stay within a share of the limits.

    Args:
        model: of the arm.
        start, goal: (n,) rad, motor angles.
        limits: (n,) N m.
        share: of the limits, that the slew may take; feedback has the rest.
        period: s.

    Raises:
        ValueError: for a goal whose weight alone takes more than that.
    """
    path = Path(model, start, goal)
    low, high = period, LONGEST
    if path.peak(high, limits) > share:
        raise refusal("goal", goal.tolist(), f"a posture that {share:.0%} of the torque limits can hold")
    for _ in range(BISECTIONS):
        middle = 0.5 * (low + high)
        low, high = (low, middle) if path.peak(middle, limits) <= share else (middle, high)
    count = max(1, int(np.ceil(high / period)))
    duration, d = count * period, model.n_dof
    places = np.array([path.at(part, duration)[0] for part in np.linspace(0.0, 1.0, count + 1)])
    places[0], places[-1] = rest_state(model, start)[:d], rest_state(model, goal)[:d]
    speeds = np.gradient(places, period, axis=0) if count > 1 else np.zeros_like(places)
    speeds[0] = speeds[-1] = 0.0
    middles = (np.arange(count) + 0.5) / count
    torques = np.array([path.at(part, duration)[1] for part in middles])
    return Slew(np.hstack([places, speeds]), torques)

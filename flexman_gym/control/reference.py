"""Reference: a minimum-jerk slew of the motors, how the arm bends on it, and the torques that it takes."""

from typing import NamedTuple

import numpy as np

from flexman_gym.arrays import Array
from flexman_gym.checks import refusal
from flexman_gym.kernels import outputs
from flexman_gym.kernels.layout import OUTPUTS, TIP, TIP_VELOCITY, make_work
from flexman_gym.model.instant import inertial_forces, stiffness_matrix
from flexman_gym.model.model import Model
from flexman_gym.model.statics import rest_state

PASSES = 3  # of bending under the inertia of the bent arm
SINGULAR = 0.05  # part of the largest slope of the tip; joints do not give way into directions with less
EVERY, RESTING = 4, 6  # control periods between two places of a path that are solved for; such places before its start
SAMPLES, LONGEST, BISECTIONS = 21, 60.0, 30


class Reference(NamedTuple):
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


class Bending:
    """How a model is bent, and what its motors must give, while the links' sides of its joints move.

    Springs are wound up and links bend as the inertia of that motion and the weight ask, without vibrating.
    """

    def __init__(self, model: Model) -> None:
        n = model.n_joints
        self._model = model
        self._forces, self._stiffness = inertial_forces(model), stiffness_matrix(model)
        self._motors = model.motor_columns
        self._elastic = np.arange(n + model.n_motors, model.n_dof)
        self._inverse = np.linalg.inv(self._stiffness[np.ix_(self._elastic, self._elastic)])
        stiffness = np.where(model.constants.motor >= 0, model.constants.joint_stiffness, np.inf)
        self._compliance = 1.0 / stiffness

    def at(self, near: Array, motion: tuple[Array, Array, Array]) -> tuple[Array, Array]:
        """Gives the bent coordinates (d,) and the motor torques (n,) N m.

        Args:
            near: (d,) coordinates from whose bending the search starts.
            motion: angles, rates and accelerations (n,) of the links' sides, rad, rad/s and rad/s^2.
        """
        n, d = self._model.n_joints, self._model.n_dof
        x, rates, changes = near.copy(), np.zeros(d), np.zeros(d)
        x[:n] = motion[0]
        for columns in (np.arange(n), self._motors):
            rates[columns], changes[columns] = motion[1], motion[2]
        rotors = self._model.constants.rotor_inertia * changes[:n]
        for _ in range(PASSES):
            demand = self._forces(x, rates, changes)
            x = x.copy()
            x[self._elastic] = -self._inverse @ demand[self._elastic]
            links = demand[:n] - np.where(self._motors == np.arange(n), rotors, 0.0)
            x[self._motors] = x[:n] + self._compliance * links
        return x, links + rotors


class Path:
    """The slew of a model from one posture of its motors to another, (n,) rad each, for any duration.

    The links' sides of the joints follow the minimum-jerk motion between the two places of rest.
    """

    def __init__(self, model: Model, start: Array, goal: Array) -> None:
        n = model.n_joints
        first, last = (rest_state(model, posture)[: model.n_dof] for posture in (start, goal))
        self._start, self._way, self._bending = first, last[:n] - first[:n], Bending(model)

    def at(self, part: float, duration: float) -> tuple[Array, Array]:
        """Gives the bent coordinates (d,) and the motor torques (n,) N m at a part of a duration (s)."""
        position, speed, acceleration = (float(each) for each in minimum_jerk(np.array(part)))
        angles = self._start[: len(self._way)] + position * self._way
        motion = angles, speed / duration * self._way, acceleration / duration**2 * self._way
        return self._bending.at(self._start, motion)

    def peak(self, duration: float, limits: Array) -> float:
        """Gives the largest torque of a slew as a part of the limits (n,) N m."""
        torques = [self.at(part, duration)[1] for part in np.linspace(0.0, 1.0, SAMPLES)]
        return float(np.abs(np.array(torques) / limits).max())


def plan_slew(model: Model, start: Array, goal: Array, limits: Array, share: float, period: float) -> Reference:
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
    return Reference(np.hstack([places, speeds]), torques)


def plan_path(model: Model, postures: Array, period: float) -> Reference:
    """Plans how a model follows postures (T + 1, n) rad of its motors, one for each control period (s).

    The tip is to be where it would rest at each posture: the joints give way to the bending that the motion adds, once,
    for what gives way twice is differentiated too often. All is solved for at every few periods, with splines between.

    Args:
        model: of the arm.
        postures: whose second derivatives are continuous.
        period: s.
    """
    from scipy.interpolate import CubicSpline

    n, bending, give_way = model.n_joints, Bending(model), GiveWay(model)
    all_times = period * np.arange(len(postures))
    count = max(4, -(-(len(postures) - 1) // EVERY) + 1)
    spacing = all_times[-1] / (count - 1)
    times = spacing * np.arange(-RESTING, count)  # it has rested before
    wanted = CubicSpline(all_times, postures)(np.maximum(times, 0.0))
    rests = np.array([rest_state(model, posture)[: model.n_dof] for posture in wanted])
    angles = rests[:, :n]
    for last in (False, True):
        motion = [CubicSpline(times, angles).derivative(order)(times) if order else angles for order in range(3)]
        result = [bending.at(rest, each) for rest, each in zip(rests, zip(*motion, strict=True), strict=True)]
        places, torques = (np.array(each) for each in zip(*result, strict=True))
        if not last:
            angles = angles + np.array([give_way.turn(*both) for both in zip(rests, places, strict=True)])
    way, middles = CubicSpline(times, places), all_times[:-1] + 0.5 * period
    return Reference(np.hstack([way(all_times), way.derivative()(all_times)]), CubicSpline(times, torques)(middles))


class GiveWay:
    """How the joints of a model turn, motors with them, for the tip at bent coordinates to come to that at rest."""

    def __init__(self, model: Model) -> None:
        self._model, self._work, self._row = model, make_work(model.constants), np.zeros(OUTPUTS)
        self._turns = np.eye(model.n_dof)[: model.n_joints]
        self._turns[np.arange(model.n_joints), model.motor_columns] = 1.0

    def turn(self, rest: Array, place: Array) -> Array:
        """Gives the turn (n,) rad, to first order, for coordinates (d,) each; none into directions that take far."""
        wanted, now = self._seen(rest, self._turns[0])[TIP].copy(), self._seen(place, self._turns[0])[TIP].copy()
        slopes = np.array([self._seen(place, turn)[TIP_VELOCITY].copy() for turn in self._turns]).T
        result: Array = np.linalg.pinv(slopes, rcond=SINGULAR) @ (wanted - now)
        return result

    def _seen(self, x: Array, v: Array) -> Array:
        outputs.observe(self._model.constants, self._work, x, v, self._row)
        return self._row

"""Reference trajectories: timing laws, paths, quasi-static deflection, and time-optimal motions."""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from flexman_gym.common.arrays import Array, IntArray
from flexman_gym.common.checks import one_of, physical, value_error
from flexman_gym.kernels import outputs
from flexman_gym.kernels.layout import OUTPUTS, TIP, TIP_VELOCITY, make_work
from flexman_gym.model.dynamics import inertial_forces, stiffness_matrix
from flexman_gym.model.model import Model
from flexman_gym.model.statics import rest_state


class _TimingLaw(NamedTuple):
    """Rest-to-rest timing law: the path parameter is a polynomial of time in each of k phases.

    Attributes:
        begins: (k,) start times of the phases, s.
        coefficients: (k, 6) in ascending powers of the time since the start of a phase.
        duration: s.
    """

    begins: Array
    coefficients: Array
    duration: float

    def at(self, times: Array) -> tuple[Array, Array, Array]:
        """Return path parameter, speed (1/s) and acceleration (1/s^2) at times (T,) s; at rest before and after."""
        inside = np.clip(times, 0.0, self.duration)
        phases: IntArray = np.searchsorted(self.begins, inside, side="right") - 1
        place, speed, acceleration = evaluate_polynomials(self.coefficients[phases], inside - self.begins[phases])
        return place, speed, np.where(inside == times, acceleration, 0.0)


def quintic_coefficients(place: Array, speed: Array, change: Array, durations: Array) -> Array:
    """Return coefficients (..., 6), in ascending powers, of the polynomial that comes to rest at path parameter 1.

    From rest it is the minimum-jerk motion (Flash and Hogan, Journal of Neuroscience 5, 1985, 1688).

    Args:
        place: initial path parameter.
        speed: initial speed, 1/s.
        change: initial acceleration, 1/s^2.
        durations: s.

    Returns:
        Coefficients (..., 6).
    """
    remaining, squared = 1.0 - place, durations**2
    cubic = (20.0 * remaining - 12.0 * speed * durations - 3.0 * change * squared) / (2.0 * durations**3)
    fourth = (-30.0 * remaining + 16.0 * speed * durations + 3.0 * change * squared) / (2.0 * durations**4)
    fifth = (12.0 * remaining - 6.0 * speed * durations - change * squared) / (2.0 * durations**5)
    result: Array = np.stack(np.broadcast_arrays(place, speed, 0.5 * change, cubic, fourth, fifth), axis=-1)
    return result


def evaluate_polynomials(coefficients: Array, times: Array) -> tuple[Array, Array, Array]:
    """Return path parameter, speed (1/s) and acceleration (1/s^2) of polynomials (..., 6) at times (...) s."""
    a, b, c, d, e, f = np.moveaxis(coefficients, -1, 0)
    place = a + times * (b + times * (c + times * (d + times * (e + times * f))))
    speed = b + times * (2.0 * c + times * (3.0 * d + times * (4.0 * e + times * 5.0 * f)))
    return place, speed, 2.0 * c + times * (6.0 * d + times * (12.0 * e + times * 20.0 * f))


def constant_jerk_law(distance: float, speed: float, acceleration: float, jerk: float | None = None) -> _TimingLaw:
    """Plan the fastest motion from rest to rest over a distance, within limits of its derivatives.

    With a jerk limit this is the double-S law of up to seven phases of constant jerk; without one, the trapezoidal law,
    whose acceleration jumps (Biagiotti and Melchiorri, Trajectory planning for automatic machines and robots, 2008,
    sections 3.2 and 3.4).

    Args:
        distance: 1, along the path.
        speed: 1/s, largest.
        acceleration: 1/s^2, largest.
        jerk: 1/s^3, largest; None for no limit.

    Returns:
        Timing law without phases of zero duration.
    """
    distance, speed = physical("distance", distance), physical("speed", speed, "1/s")
    acceleration = physical("acceleration", acceleration, "1/s^2")
    jerk = np.inf if jerk is None else physical("jerk", jerk, "1/s^3")
    most = min(acceleration, np.sqrt(speed * jerk))
    gaining = most / jerk + speed / most  # s; time to reach the speed
    steady = distance / speed - gaining
    if steady < 0.0:  # the largest speed is not reached
        most, steady = min(acceleration, np.cbrt(0.5 * distance * jerk**2)), 0.0
        gaining = 0.5 * most / jerk + np.sqrt((0.5 * most / jerk) ** 2 + distance / most)
    ramp = most / jerk
    full = max(gaining - 2.0 * ramp, 0.0)
    lasting = np.array([ramp, full, ramp, steady, ramp, full, ramp])
    first, last = most * np.array([[0, 1, 1, 0, 0, -1, -1], [1, 1, 0, 0, -1, -1, 0]])
    first, last, lasting = (each[lasting > 0.0] for each in (first, last, lasting))
    begins, coefficients = np.cumsum(lasting) - lasting, np.zeros((len(lasting), 6))
    coefficients[:, 2], coefficients[:, 3] = first / 2.0, (last - first) / (6.0 * lasting)
    for before, after, time in zip(coefficients[:-1], coefficients[1:], lasting[:-1], strict=True):
        after[0], after[1], _ = evaluate_polynomials(before, time)
    return _TimingLaw(begins, coefficients, float(lasting.sum()))


TIMING_LAWS = {  # of slews from 0 to 1 in a duration of 1, with phases of equal length
    "minimum-jerk": _TimingLaw(np.zeros(1), quintic_coefficients(*np.array([[0.0], [0.0], [0.0], [1.0]])), 1.0),
    "trapezoid": constant_jerk_law(1.0, 1.5, 4.5),
    "double-s": constant_jerk_law(1.0, 1.75, 6.125, 42.875),
}


DEFLECTION_PASSES = 3  # fixed-point iterations of the deflection under the inertia of the deflected arm
SINGULAR_CUTOFF = 0.05  # fraction of the largest singular value of the tip Jacobian; smaller ones are excluded
SOLVE_INTERVAL = 4  # control periods between two solved points of a path
REST_POINTS = 6  # solved points at rest before the start of a path
PATH_SAMPLES = 21  # points of a path at which torques are compared with their limits
MAX_DURATION = 60.0  # s
JUMP_MARGIN = 1e-9  # fraction of the duration before a jump of the acceleration


class _ReferenceTrajectory(NamedTuple):
    """Reference trajectory over T control periods, followed by rest.

    Attributes:
        states: (T + 1, 2 d) at the ends of the periods.
        torques: (T, n) constant in each period, N m.
    """

    states: Array
    torques: Array


class QuasiStaticDeflection:
    """Quasi-static deflection of a model and its motor torques, for a prescribed joint motion.

    The motion is that of the link sides of the joints. Joint springs and links deflect under its inertial and
    gravitational loads, without vibration.
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
        """Return the deflected coordinates (d,) and the motor torques (n,), N m.

        Args:
            near: (d,) coordinates with the initial deflection of the iteration.
            motion: angles, rates and accelerations (n,) of the link sides, rad, rad/s and rad/s^2.

        Returns:
            Coordinates (d,) and torques (n,), N m.
        """
        n, d = self._model.n_joints, self._model.n_dof
        x, rates, changes = near.copy(), np.zeros(d), np.zeros(d)
        x[:n] = motion[0]
        for columns in (np.arange(n), self._motors):
            rates[columns], changes[columns] = motion[1], motion[2]
        rotors = self._model.constants.rotor_inertia * changes[:n]
        for _ in range(DEFLECTION_PASSES):
            demand = self._forces(x, rates, changes)
            x = x.copy()
            x[self._elastic] = -self._inverse @ demand[self._elastic]
            links = demand[:n] - np.where(self._motors == np.arange(n), rotors, 0.0)
            x[self._motors] = x[:n] + self._compliance * links
        return x, links + rotors


class _JointPath(NamedTuple):
    """Rest-to-rest path of the link sides of the joints, for any duration.

    Attributes:
        bending: quasi-static deflection of the model.
        ends: (2, d) equilibrium coordinates at start and end.
        motion: function of fractions (k,) of the duration that returns angles (k, n) rad and their first and second
            derivatives with respect to the fraction.
        parts: fractions of the duration at which torques are compared with their limits.
    """

    bending: QuasiStaticDeflection
    ends: Array
    motion: Callable[[Array], tuple[Array, Array, Array]]
    parts: Array

    def at(self, parts: Array, duration: float) -> tuple[Array, Array]:
        """Return deflected coordinates (k, d) and motor torques (k, n) N m at fractions (k,) of a duration (s)."""
        angles, rates, changes = self.motion(parts)
        motions = zip(angles, rates / duration, changes / duration**2, strict=True)
        places, torques = zip(*(self.bending.at(self.ends[0], each) for each in motions), strict=True)
        return np.array(places), np.array(torques)


def slew_path(model: Model, start: Array, goal: Array, law: str = "minimum-jerk") -> _JointPath:
    """Return the straight path between postures of the motors (n,) rad, with a law from `TIMING_LAWS`."""
    ends, timing = rest_state(model, np.array([start, goal]))[:, : model.n_dof], TIMING_LAWS[law]
    first, last = ends[:, : model.n_joints]

    def motion(parts: Array) -> tuple[Array, Array, Array]:
        place, speed, acceleration = (each[:, None] for each in timing.at(parts))
        return first + place * (last - first), speed * (last - first), acceleration * (last - first)

    jumps = timing.begins[1:]
    return _JointPath(QuasiStaticDeflection(model), ends, motion, _sample_parts(jumps - JUMP_MARGIN, jumps))


def via_path(model: Model, postures: Array, count: int) -> _JointPath:
    """Return the path through postures (m, n) rad of the motors, each at the end of one of `count` control periods.

    The path is a cubic spline with two additional knots, so that it starts and ends with zero acceleration (Biagiotti
    and Melchiorri, Trajectory planning for automatic machines and robots, 2008, section 4.4.4). Times between postures
    are proportional to the square roots of their distances (Lee, Computer-Aided Design 21, 1989, 363).
    """
    from scipy.interpolate import make_interp_spline

    rests, order = rest_state(model, postures)[:, : model.n_dof], np.arange(len(postures))
    angles, zero = rests[:, : model.n_joints], np.zeros(model.n_joints)
    distances = np.sqrt(np.linalg.norm(np.diff(angles, axis=0), axis=1))
    rows = np.rint(count * np.append(0.0, np.cumsum(distances)) / distances.sum())
    rows = np.minimum(np.maximum.accumulate(rows - order) + order, count - order[::-1])  # at least a period apart
    times = rows / count
    more = (2.0 * times[0] + times[1]) / 3.0, (times[-2] + 2.0 * times[-1]) / 3.0
    knots = np.concatenate([np.zeros(4), more[:1], times[1:-1], more[1:], np.ones(4)])
    rest = [(1, zero), (2, zero)]
    spline = make_interp_spline(times, angles, k=3, t=knots, bc_type=(rest, rest))

    def motion(parts: Array) -> tuple[Array, Array, Array]:
        return spline(parts), spline(parts, 1), spline(parts, 2)

    return _JointPath(QuasiStaticDeflection(model), rests[[0, -1]], motion, _sample_parts(knots[4:-4]))


def _sample_parts(*places: Array) -> Array:
    """Return equidistant fractions of a duration, together with others at which accelerations may be largest."""
    return np.sort(np.concatenate([np.linspace(0.0, 1.0, PATH_SAMPLES), *places]))


def plan_slew(
    model: Model, start: Array, goal: Array, limits: Array, share: float, period: float, law: str = "minimum-jerk"
) -> _ReferenceTrajectory:
    """Plan the fastest slew with a timing law whose torques stay within a share of the limits.

    Args:
        model: of the arm.
        start: (n,) initial motor angles, rad.
        goal: (n,) final motor angles, rad.
        limits: (n,) torque limits, N m.
        share: fraction of the limits available to the slew; the rest is left to feedback.
        period: control period, s.
        law: name in `TIMING_LAWS`.

    Returns:
        Reference trajectory.

    Raises:
        ValueError: for a goal at which holding torques alone exceed the share, and for an unknown law.
    """
    path = slew_path(model, start, goal, one_of("law", law, TIMING_LAWS))
    slew = _time_optimal(lambda count: path, share * limits, period, 1)
    if slew is None:
        raise value_error(
            "goal", goal.tolist(), f"a posture with holding torques below {share:.0%} of the torque limits"
        )
    return slew


def plan_via(model: Model, postures: Array, limits: Array, share: float, period: float) -> _ReferenceTrajectory:
    """Plan the fastest motion through postures, see `via_path`, whose torques stay within a share of the limits.

    Postures coincide with ends of control periods, so that the spline changes slightly with the duration; the search
    may therefore miss a shorter one.

    Args:
        model: of the arm.
        postures: (m, n) motor angles, rad; at rest at the first and the last.
        limits: (n,) torque limits, N m.
        share: fraction of the limits available to the motion; the rest is left to feedback.
        period: control period, s.

    Returns:
        Reference trajectory.

    Raises:
        ValueError: for fewer than two postures, two equal ones in succession, and holding torques beyond the share.
    """
    if len(postures) < 2 or not np.diff(postures, axis=0).any(axis=1).all():
        raise value_error("postures", postures.tolist(), "at least two, no two equal in succession")
    motion = _time_optimal(lambda count: via_path(model, postures, count), share * limits, period, len(postures) - 1)
    if motion is None:
        raise value_error(
            "postures", postures.tolist(), f"postures with holding torques below {share:.0%} of the torque limits"
        )
    return motion


def _time_optimal(
    paths: Callable[[int], _JointPath], bounds: Array, period: float, fewest: int
) -> _ReferenceTrajectory | None:
    """Return the path in the fewest control periods with torques within bounds (n,) N m; None if there is none.

    Torques are the holding torques plus an inertial part proportional to 1 / T^2, so that one duration T predicts the
    shortest. Deflections change this slightly, and the prediction is repeated there.
    """
    count, short = max(fewest, int(MAX_DURATION / period)), fewest - 1
    most, path = count, paths(count)
    rest = path.at(path.parts, np.inf)[1]
    if (np.abs(rest) >= bounds).any():
        return None
    while True:
        inertial = path.at(path.parts, count * period)[1] - rest
        needed = np.ceil(count * np.sqrt((np.abs(inertial) / (bounds - np.sign(inertial) * rest)).max()))
        if not needed <= count:  # also for NaN, of an arm that deflects too far
            if count == most:
                return None
            short, count = count, int(min(np.fmax(needed, count + 1), most))
        elif needed == count or count == short + 1:
            return _sample_path(path, count, period)
        else:
            count = int(max(needed, short + 1))
        path = paths(count)


def _sample_path(path: _JointPath, count: int, period: float) -> _ReferenceTrajectory:
    """Sample a path over a number of control periods."""
    places, _ = path.at(np.linspace(0.0, 1.0, count + 1), count * period)
    places[[0, -1]] = path.ends
    speeds = np.gradient(places, period, axis=0) if count > 1 else np.zeros_like(places)
    speeds[[0, -1]] = 0.0
    return _ReferenceTrajectory(
        np.hstack([places, speeds]), path.at((np.arange(count) + 0.5) / count, count * period)[1]
    )


def plan_path(model: Model, postures: Array, period: float) -> _ReferenceTrajectory:
    """Plan the motion of a model through postures (T + 1, n) rad of its motors, one per control period (s).

    The tip follows its equilibrium positions at these postures: the joints compensate the deflection due to the motion.
    One pass only: each further pass would need higher derivatives of the path. The motion is solved for at intervals of
    a few periods and interpolated by splines.

    Args:
        model: of the arm.
        postures: (T + 1, n) with continuous second derivatives, rad.
        period: control period, s.

    Returns:
        Reference trajectory.
    """
    from scipy.interpolate import CubicSpline

    n, bending, give_way = model.n_joints, QuasiStaticDeflection(model), DeflectionCompensation(model)
    all_times = period * np.arange(len(postures))
    count = max(4, -(-(len(postures) - 1) // SOLVE_INTERVAL) + 1)
    spacing = all_times[-1] / (count - 1)
    times = spacing * np.arange(-REST_POINTS, count)  # at rest before the start
    target = CubicSpline(all_times, postures)(np.maximum(times, 0.0))
    rests = np.array([rest_state(model, posture)[: model.n_dof] for posture in target])
    angles = rests[:, :n]
    for last in (False, True):
        motion = [CubicSpline(times, angles).derivative(order)(times) if order else angles for order in range(3)]
        result = [bending.at(rest, each) for rest, each in zip(rests, zip(*motion, strict=True), strict=True)]
        places, torques = (np.array(each) for each in zip(*result, strict=True))
        if not last:
            angles = angles + np.array([give_way.turn(*both) for both in zip(rests, places, strict=True)])
    spline, middles = CubicSpline(times, places), all_times[:-1] + 0.5 * period
    return _ReferenceTrajectory(
        np.hstack([spline(all_times), spline.derivative()(all_times)]), CubicSpline(times, torques)(middles)
    )


class DeflectionCompensation:
    """Rotation of the joints, motors included, that moves the tip of a deflected model to its equilibrium position."""

    def __init__(self, model: Model) -> None:
        self._model, self._work, self._row = model, make_work(model.constants), np.zeros(OUTPUTS)
        self._turns = model.at_rest(np.eye(model.n_joints))[:, : model.n_dof].copy()

    def turn(self, rest: Array, place: Array) -> Array:
        """Return the rotation (n,) rad, to first order, from deflected to equilibrium coordinates (d,) of the tip.

        Directions with small singular values are excluded, since they would require large rotations.
        """
        target, now = self._seen(rest, self._turns[0])[TIP].copy(), self._seen(place, self._turns[0])[TIP].copy()
        jacobian = np.array([self._seen(place, turn)[TIP_VELOCITY].copy() for turn in self._turns]).T
        result: Array = np.linalg.pinv(jacobian, rcond=SINGULAR_CUTOFF) @ (target - now)
        return result

    def _seen(self, x: Array, v: Array) -> Array:
        outputs.compute_outputs(self._model.constants, self._work, x, v, self._row)
        return self._row

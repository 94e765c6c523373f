"""Reference trajectories: timings, paths, quasi-static deflection, and time-optimal motions."""

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from flexman_gym.common.arrays import Array, IntArray
from flexman_gym.common.checks import one_of, physical, sample_count
from flexman_gym.common.errors import value_error
from flexman_gym.kernels import outputs
from flexman_gym.kernels.layout import OUTPUTS, TIP, TIP_VELOCITY, make_work
from flexman_gym.model.dynamics import elastic_forces, inertial_forces, stiffness_matrix
from flexman_gym.model.friction import friction_coefficients, friction_torques
from flexman_gym.model.hanging import tangent_matrices
from flexman_gym.model.model import Model
from flexman_gym.model.statics import rest_state
from flexman_gym.toolbox.controllers.arm_scales import SlewBounds
from flexman_gym.toolbox.controllers.references.path_parametrisation import (
    PathBounds,
    TimeOptimalMotions,
    average_windows,
    is_time_optimal,
)


class _Timing(NamedTuple):
    """Rest-to-rest timing: the path parameter is a polynomial of time in each of k phases.

    Attributes:
        begins: (k,) start times of the phases, s.
        coefficients: (k, 6) in ascending powers of the time since the start of a phase.
        duration: duration of the motion, s.
    """

    begins: Array
    coefficients: Array
    duration: float

    def at(self, times: Array) -> tuple[Array, Array, Array]:
        """Return path parameter, speed (1/s) and acceleration (1/s^2) at times (T,) s; at rest before and after."""
        inside = np.clip(times, 0.0, self.duration)
        phases: IntArray = np.searchsorted(self.begins, inside, side="right") - 1
        progress, speed, acceleration = evaluate_polynomials(self.coefficients[phases], inside - self.begins[phases])
        return progress, speed, np.where(inside == times, acceleration, 0.0)


def quintic_coefficients(progress: Array, speed: Array, acceleration: Array, durations: Array) -> Array:
    """Return coefficients (..., 6), in ascending powers of time, of quintics that come to rest at path parameter 1.

    A quintic that starts at rest is the minimum-jerk motion (Flash and Hogan, Journal of Neuroscience 5, 1985, 1688).

    Args:
        progress: (...) initial path parameter.
        speed: (...) initial speed, 1/s.
        acceleration: (...) initial acceleration, 1/s^2.
        durations: (...) s.
    """
    remaining, squared = 1.0 - progress, durations**2
    cubic = (20.0 * remaining - 12.0 * speed * durations - 3.0 * acceleration * squared) / (2.0 * durations**3)
    fourth = (-30.0 * remaining + 16.0 * speed * durations + 3.0 * acceleration * squared) / (2.0 * durations**4)
    fifth = (12.0 * remaining - 6.0 * speed * durations - acceleration * squared) / (2.0 * durations**5)
    result: Array = np.stack(np.broadcast_arrays(progress, speed, 0.5 * acceleration, cubic, fourth, fifth), axis=-1)
    return result


def evaluate_polynomials(coefficients: Array, times: Array) -> tuple[Array, Array, Array]:
    """Return path parameter, speed (1/s) and acceleration (1/s^2) of polynomials (..., 6) at times (...) s."""
    a, b, c, d, e, f = (coefficients[..., power] for power in range(6))  # np.moveaxis takes longer
    progress = a + times * (b + times * (c + times * (d + times * (e + times * f))))
    speed = b + times * (2.0 * c + times * (3.0 * d + times * (4.0 * e + times * 5.0 * f)))
    return progress, speed, 2.0 * c + times * (6.0 * d + times * (12.0 * e + times * 20.0 * f))


def constant_jerk_timing(distance: float, speed: float, acceleration: float, jerk: float | None = None) -> _Timing:
    """Plan the fastest motion from rest to rest over a distance, within limits of its derivatives.

    With a jerk limit the motion is the double-S law of up to seven phases of constant jerk; without a jerk limit it is
    the trapezoidal law, whose acceleration is discontinuous (Biagiotti and Melchiorri, Trajectory planning for
    automatic machines and robots, 2008, sections 3.2 and 3.4).

    Args:
        distance: change of the path parameter.
        speed: largest speed, 1/s.
        acceleration: largest acceleration, 1/s^2.
        jerk: largest jerk, 1/s^3; None for no limit.

    Returns:
        Timing law without phases of zero duration.
    """
    distance, speed = physical("distance", distance), physical("speed", speed, "1/s")
    acceleration = physical("acceleration", acceleration, "1/s^2")
    jerk = np.inf if jerk is None else physical("jerk", jerk, "1/s^3")
    peak = min(acceleration, np.sqrt(speed * jerk))
    rise_time = peak / jerk + speed / peak  # s; time to reach the largest speed
    cruise_time = distance / speed - rise_time
    if cruise_time < 0.0:  # the largest speed is not reached
        peak, cruise_time = min(acceleration, np.cbrt(0.5 * distance * jerk**2)), 0.0
        rise_time = 0.5 * peak / jerk + np.sqrt((0.5 * peak / jerk) ** 2 + distance / peak)
    jerk_time = peak / jerk
    constant_time = max(rise_time - 2.0 * jerk_time, 0.0)
    durations = np.array([jerk_time, constant_time, jerk_time, cruise_time, jerk_time, constant_time, jerk_time])
    first, last = peak * np.array([[0, 1, 1, 0, 0, -1, -1], [1, 1, 0, 0, -1, -1, 0]])
    first, last, durations = (each[durations > 0.0] for each in (first, last, durations))
    begins, coefficients = np.cumsum(durations) - durations, np.zeros((len(durations), 6))
    coefficients[:, 2], coefficients[:, 3] = first / 2.0, (last - first) / (6.0 * durations)
    for before, after, time in zip(coefficients[:-1], coefficients[1:], durations[:-1], strict=True):
        after[0], after[1], _ = evaluate_polynomials(before, time)
    return _Timing(begins, coefficients, float(durations.sum()))


TIME_OPTIMAL, QUINTIC = "time-optimal", "quintic"  # names of timings
TIMINGS = {  # name -> timing from 0 to 1 with duration 1; the phases have equal length
    QUINTIC: _Timing(np.zeros(1), quintic_coefficients(*np.array([[0.0], [0.0], [0.0], [1.0]])), 1.0),
    "trapezoid": constant_jerk_timing(1.0, 1.5, 4.5),
    "double-s": constant_jerk_timing(1.0, 1.75, 6.125, 42.875),
}
TIMING_NAMES = (TIME_OPTIMAL, *TIMINGS)
TABLE_POINTS = np.linspace(0.0, 1.0, 11)  # path parameters at which torques of a time-optimal slew are tabulated


DEFLECTION_PASSES = 3  # fixed-point iterations of the deflection under the inertia of the deflected arm
SINGULAR_CUTOFF = 0.05  # fraction of the largest singular value of the tip Jacobian; smaller ones are excluded
STEP_DAMPING = 0.01  # fraction of the largest singular value; damping of a step towards a tip position
SOLVE_INTERVAL = 4  # control periods between two points of a path at which the deflection is computed
REST_POINTS = 6  # number of points at rest before the start of a path at which the deflection is computed
PATH_SAMPLES = 21  # number of points of a path at which torques are compared with their limits
TRIED_DURATION, MAX_DURATION, MAX_PERIODS = 60.0, 1e5, 100_000  # s, s and control periods; first and longest slews
ROUNDING = 1e-9  # fraction of a duration by which it may be too short
JUMP_MARGIN = 1e-9  # fraction of the duration; distance of a check point before a jump of the acceleration


class QuasiStaticDeflection:
    """Quasi-static deflection of a model and its motor torques, for a prescribed joint motion.

    The prescribed motion is that of the link sides of the joints with a motor. Joint springs and links deflect, and
    passive joints turn, under the inertial and gravitational loads of the motion, without vibration. Angles of passive
    joints in a prescribed motion are first guesses; their rates and accelerations are kept.

    Args:
        model: model of the arm.
    """

    def __init__(self, model: Model) -> None:
        n = model.n_joints
        self.model = model
        self._forces, self._stiffness = inertial_forces(model), stiffness_matrix(model)
        self._motors = model.motor_columns
        passive = np.flatnonzero(model.constants.passive)
        self._elastic = np.append(passive, np.arange(n + model.n_motors, model.n_dof))
        self._inverse: Array | None = None  # for an arm with passive joints, whose stiffness depends on its motion
        if not len(passive):
            elastic = self._stiffness[np.ix_(self._elastic, self._elastic)]
            self._inverse = np.asarray(np.linalg.inv(elastic), dtype=float)
        stiffness = np.where(model.constants.motor >= 0, model.constants.joint_stiffness, np.inf)
        self._compliance = 1.0 / stiffness

    def at(self, guess: Array, motion: tuple[Array, Array, Array]) -> tuple[Array, Array]:
        """Return the deflected coordinates (d,) and the motor torques (n,), N m.

        Args:
            guess: (d,) coordinates with the initial deflection of the iteration.
            motion: angles, rates and accelerations of the link sides of the joints, (n,) each, rad, rad/s and rad/s^2.
        """
        n, d = self.model.n_joints, self.model.n_dof
        x, rates, accelerations = guess.copy(), np.zeros(d), np.zeros(d)
        x[:n] = motion[0]
        for columns in (np.arange(n), self._motors):
            rates[columns], accelerations[columns] = motion[1], motion[2]
        rotor_torques = self.model.constants.rotor_inertia * accelerations[:n]
        for _ in range(DEFLECTION_PASSES):
            forces = self._forces(x, rates, accelerations)
            x = x.copy()
            if self._inverse is None:
                x[self._elastic] -= self._hanging_step(np.array([x, rates, accelerations]), forces)
            else:
                x[self._elastic] = -self._inverse @ forces[self._elastic]
            link_torques = forces[:n] - np.where(self._motors == np.arange(n), rotor_torques, 0.0)
            x[self._motors] = x[:n] + self._compliance * link_torques
        return x, (link_torques + rotor_torques) * (1 - self.model.constants.passive)

    def _hanging_step(self, motion: Array, forces: Array) -> Array:
        """Return the Newton step of passive joints and elastic coordinates for a motion (3, d) with forces (d,)."""
        _, stiffness = tangent_matrices(self.model, motion, self._elastic)
        residual: Array = (forces + elastic_forces(self.model, motion[0]))[self._elastic]
        step: Array = np.asarray(np.linalg.solve(stiffness, residual), dtype=float)
        return step


class _JointPath(NamedTuple):
    """Rest-to-rest path of the link sides of the joints, for any duration.

    Attributes:
        deflection: quasi-static deflection of the model.
        ends: (2, d) equilibrium coordinates at start and end.
        motion: function of fractions (k,) of the duration that returns joint angles (k, n) rad and their first and
            second derivatives with respect to the fraction.
        check_points: fractions of the duration at which torques are compared with their limits.
    """

    deflection: QuasiStaticDeflection
    ends: Array
    motion: Callable[[Array], tuple[Array, Array, Array]]
    check_points: Array

    def at(self, fractions: Array, duration: float) -> tuple[Array, Array]:
        """Return deflected coordinates (k, d) and motor torques (k, n) N m at fractions (k,) of a duration (s)."""
        angles, rates, accelerations = self.motion(fractions)
        motions = zip(angles, rates / duration, accelerations / duration**2, strict=True)
        coordinates, torques = zip(*(self.deflection.at(self.ends[0], each) for each in motions), strict=True)
        return np.array(coordinates), np.array(torques)

    def friction(self, fractions: Array, duration: float) -> Array:
        """Return the friction torques (k, n) of the motors at fractions (k,) of a duration (s), N m."""
        return friction_torques(self.deflection.model, self.motion(fractions)[1] / duration)


class _ReferenceTrajectory(NamedTuple):
    """Reference trajectory over T control periods, followed by rest.

    Attributes:
        states: (T + 1, 2 d) states at the start and at the end of each period.
        torques: (T, n) motor torques, constant in each period, N m.
        path: path of a planned slew; None for a given path.
    """

    states: Array
    torques: Array
    path: _JointPath | None = None


def _slew_path(model: Model, start: Array, goal: Array, timing: str = QUINTIC) -> _JointPath:
    """Return the straight path between postures of the motors (n,) rad, with a timing from `TIMINGS`."""
    ends, law = rest_state(model, np.array([start, goal]))[:, : model.n_dof], TIMINGS[timing]
    first, last = ends[:, : model.n_joints]

    def motion(fractions: Array) -> tuple[Array, Array, Array]:
        progress, speed, acceleration = (each[:, None] for each in law.at(fractions))
        return first + progress * (last - first), speed * (last - first), acceleration * (last - first)

    jumps = law.begins[1:]
    points = np.sort(np.concatenate([np.linspace(0.0, 1.0, PATH_SAMPLES), jumps - JUMP_MARGIN, jumps]))
    return _JointPath(QuasiStaticDeflection(model), ends, motion, points)


def plan_slew(
    model: Model, start: Array, goal: Array, bounds: SlewBounds, period: float, timing: str = QUINTIC
) -> _ReferenceTrajectory:
    """Plan the fastest slew with a timing within bounds.

    Args:
        model: model of the arm.
        start: (n,) initial motor angles, rad.
        goal: (n,) final motor angles, rad.
        bounds: bounds of torques, rates and duration.
        period: control period, s.
        timing: name in TIMING_NAMES; "time-optimal" stands for `TimeOptimalMotions` where `is_time_optimal` holds.

    Raises:
        ValueError: for a goal at which holding torques alone exceed the fraction, for an unknown timing, and for a
            slew of more than MAX_PERIODS control periods.
    """
    optimal = one_of("timing", timing, TIMING_NAMES) == TIME_OPTIMAL
    path = _slew_path(model, start, goal, QUINTIC if optimal else timing)
    count = _least_periods(path, bounds.fraction * np.asarray(bounds.limits), period)
    if count is None:
        raise value_error(
            "goal", goal.tolist(), f"a posture with holding torques below {bounds.fraction:.0%} of the torque limits"
        )
    rates = np.abs(path.motion(path.check_points)[1]) / bounds.rates
    shortest = max(float(rates.max()), bounds.shortest(model, goal))
    least = math.ceil((1.0 - ROUNDING) * shortest / period)
    if optimal and count > least:
        path, count = _fastest_path(path, goal, bounds, count, period)
    return _sample_path(path, max(count, least), period)


def _least_periods(path: _JointPath, bounds: Array, period: float) -> int | None:
    """Return the least number of control periods with torques within bounds (n,) N m; None without solution.

    Torques are the holding and friction torques plus an inertial part proportional to 1 / T^2, so that the torques for
    one duration T predict the shortest duration. Deflections and friction change with T: the prediction is repeated at
    the new duration. The torques of the trajectory are those without friction.
    """
    most, infeasible = max(1, int(TRIED_DURATION / period)), 0
    count = most
    static = path.at(path.check_points, np.inf)[1]
    if (np.abs(static) >= bounds).any():
        return None
    while True:
        inertial = path.at(path.check_points, count * period)[1] - static
        constant = static + path.friction(path.check_points, count * period)
        with np.errstate(invalid="ignore"):  # friction above the bounds: too short a duration
            needed = np.ceil(count * np.sqrt((np.abs(inertial) / (bounds - np.sign(inertial) * constant)).max()))
        if not needed <= count:  # true also for NaN, of an arm with divergent deflection
            if count == most:
                if most * period >= MAX_DURATION:
                    return None
                most = 10 * most
            infeasible, count = count, int(min(np.fmax(needed, count + 1), most))
        elif needed == count or count == infeasible + 1:
            return count
        else:
            count = int(max(needed, infeasible + 1))


def _fastest_path(
    path: _JointPath, goal: Array, bounds: SlewBounds, count: int, period: float
) -> tuple[_JointPath, int]:
    """Return a path with the timing of the fastest motion, and its number of control periods (s), where it is faster.

    Args:
        path: path with quintic timing.
        goal: (n,) final motor angles, rad.
        bounds: bounds of torques, rates and duration.
        count: number of control periods of the quintic, set by the torques.
        period: control period, s.
    """
    model, duration, motions = path.deflection.model, np.array([count * period]), TimeOptimalMotions()
    (first, last), scale = path.ends[:, : model.n_joints], 1.0 / duration[0]
    way, still, tables = last - first, np.zeros(model.n_joints), []
    for angles in first + TABLE_POINTS[:, None] * (last - first):
        motion = (angles, still, still), (angles, still, scale**2 * way), (angles, scale * way, still)
        rest, accelerated, moved = (path.deflection.at(path.ends[0], each)[1] for each in motion)
        tables.append([rest, (accelerated - rest) / scale**2, (moved - rest) / scale**2])
    limits = bounds.fraction * np.asarray(bounds.limits, dtype=float)
    friction, mode = friction_coefficients(model)[None], np.array([bounds.free])
    arm = np.array([0])
    motions.allocate(1)
    motions.start(
        arm, average_windows(mode, duration),
        PathBounds(model, np.array(tables)[None], limits[None], way[None], bounds.rates, friction),
    )  # fmt: skip
    lasting = motions.durations
    if not (motions.windows[0] and is_time_optimal(lasting, mode, duration, bounds.shortest(model, goal))):
        return path, count

    def timed(fractions: Array) -> tuple[Array, Array, Array]:
        progress, speed, acceleration = (each[:, None] for each in motions.at(fractions * lasting, arm))
        return first + progress * way, lasting * speed * way, lasting**2 * acceleration * way

    return path._replace(motion=timed), math.ceil((1.0 - ROUNDING) * lasting[0] / period)


def _sample_path(path: _JointPath, count: int, period: float) -> _ReferenceTrajectory:
    """Sample a path over a number of control periods (s); torques are those at the middle of each period."""
    sample_count("control_period", period, count * period, MAX_PERIODS)
    coordinates, _ = path.at(np.linspace(0.0, 1.0, count + 1), count * period)
    coordinates[[0, -1]] = path.ends
    rates = np.gradient(coordinates, period, axis=0) if count > 1 else np.zeros_like(coordinates)
    rates[[0, -1]] = 0.0
    torques = path.at((np.arange(count) + 0.5) / count, count * period)[1]
    return _ReferenceTrajectory(np.hstack([coordinates, rates]), torques, path)


def plan_path(model: Model, postures: Array, period: float) -> _ReferenceTrajectory:
    """Plan the motion of a model through postures (T + 1, n) rad of its motors, one per control period (s).

    The tip follows its equilibrium positions at these postures: the joints compensate the deflection due to the motion,
    by one iteration, since each further iteration would need higher derivatives of the path. Deflections are computed
    at intervals of a few periods and interpolated by splines.

    Args:
        model: model of the arm.
        postures: (T + 1, n) motor angles with continuous second derivatives, rad.
        period: control period, s.

    Raises:
        ValueError: for more than MAX_PERIODS control periods.
    """
    from scipy.interpolate import CubicSpline

    sample_count("control_period", period, (len(postures) - 1) * period, MAX_PERIODS)
    n, deflection, compensation = model.n_joints, QuasiStaticDeflection(model), DeflectionCompensation(model)
    all_times = period * np.arange(len(postures))
    count = max(4, -(-(len(postures) - 1) // SOLVE_INTERVAL) + 1)
    spacing = all_times[-1] / (count - 1)
    times = spacing * np.arange(-REST_POINTS, count)  # at rest before the start
    target = CubicSpline(all_times, postures)(np.maximum(times, 0.0))
    rests = np.array([rest_state(model, posture)[: model.n_dof] for posture in target])
    angles = rests[:, :n]
    for last in (False, True):
        motion = [CubicSpline(times, angles).derivative(order)(times) if order else angles for order in range(3)]
        result = [deflection.at(rest, each) for rest, each in zip(rests, zip(*motion, strict=True), strict=True)]
        deflected, torques = (np.array(each) for each in zip(*result, strict=True))
        if not last:
            angles = angles + np.array([compensation.rotation(*both) for both in zip(rests, deflected, strict=True)])
    spline, middles = CubicSpline(times, deflected), all_times[:-1] + 0.5 * period
    return _ReferenceTrajectory(
        np.hstack([spline(all_times), spline.derivative()(all_times)]), CubicSpline(times, torques)(middles)
    )


class DeflectionCompensation:
    """Rotation of joints and motors that moves the tip of a deflected arm to its equilibrium position.

    Args:
        model: model of the arm.
    """

    def __init__(self, model: Model) -> None:
        self._model, self._work, self._row = model, make_work(model.constants), np.zeros(OUTPUTS)
        self._rotations = model.at_rest(np.eye(model.n_joints))[:, : model.n_dof].copy()  # of 1 rad, joint by joint
        self._hangs = bool(model.constants.passive.any())

    def rotation(self, rest: Array, deflected: Array) -> Array:
        """Return the rotation (n,) rad, to first order, from deflected to equilibrium coordinates, (d,) each.

        Directions of the tip with small singular values are excluded, since they would require large rotations.
        """
        jacobian, error = self._linearised(rest, deflected)
        result: Array = np.linalg.pinv(jacobian, rcond=SINGULAR_CUTOFF) @ error
        return result

    def damped_rotation(self, rest: Array, deflected: Array) -> Array:
        """Return the rotation (n,) rad of a damped least-squares step, see `rotation`; repeated steps converge.

        An arm that is nearly stretched reaches the tip of `rest` in all directions after a few steps (Wampler, IEEE
        Transactions on Systems, Man, and Cybernetics 16, 1986, 93).
        """
        jacobian, error = self._linearised(rest, deflected)
        damping = (STEP_DAMPING * np.linalg.norm(jacobian, 2)) ** 2
        result: Array = jacobian.T @ np.linalg.solve(jacobian @ jacobian.T + damping * np.eye(3), error)
        return result

    def _linearised(self, rest: Array, deflected: Array) -> tuple[Array, Array]:
        """Return the Jacobian (3, n) of the tip at deflected coordinates (d,), and its way to the target (3,), m."""
        velocity = self._rotations[0]  # any velocity: positions do not depend on it
        target, tip = self._outputs(rest, velocity)[TIP].copy(), self._outputs(deflected, velocity)[TIP].copy()
        rotations = self._rotations if not self._hangs else self._hanging_rotations(rest)
        jacobian = np.array([self._outputs(deflected, each)[TIP_VELOCITY].copy() for each in rotations]).T
        return jacobian, target - tip

    def _hanging_rotations(self, rest: Array) -> Array:
        """Return the changes (n, d) of equilibrium coordinates by motor angles, per rad; 0 for passive joints."""
        model, d = self._model, self._model.n_dof
        free = np.setdiff1d(np.arange(d), model.driven_columns)
        _, stiffness = tangent_matrices(model, np.array([rest, np.zeros(d), np.zeros(d)]), np.arange(d))
        motors, result = np.flatnonzero(model.constants.passive == 0), np.zeros((model.n_joints, d))
        result[motors, model.driven_columns] = 1.0
        result[np.ix_(motors, free)] = -np.linalg.solve(
            stiffness[np.ix_(free, free)], stiffness[np.ix_(free, model.driven_columns)]
        ).T
        return result

    def _outputs(self, x: Array, v: Array) -> Array:
        outputs.compute_outputs(self._model.constants, self._work, x, v, self._row)
        return self._row

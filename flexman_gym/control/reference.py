"""Reference: a motion of the motors that takes what torque there is, how the arm bends on it, and its torques."""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from flexman_gym.arrays import Array
from flexman_gym.checks import one_of, refusal
from flexman_gym.control.timing import LAWS
from flexman_gym.kernels import outputs
from flexman_gym.kernels.layout import OUTPUTS, TIP, TIP_VELOCITY, make_work
from flexman_gym.model.instant import inertial_forces, stiffness_matrix
from flexman_gym.model.model import Model
from flexman_gym.model.statics import rest_state, rest_states

PASSES = 3  # of bending under the inertia of the bent arm
SINGULAR = 0.05  # part of the largest slope of the tip; joints do not give way into directions with less
EVERY, RESTING = 4, 6  # control periods between two places of a path that are solved for; such places before its start
SAMPLES, LONGEST = 21, 60.0  # places whose torques time a motion; s
HAIR = 1e-9  # of a duration, before accelerations jump


class Reference(NamedTuple):
    """A slew in T control periods, then rest.

    states: (T + 1, 2 d) at the ends of the periods. torques: (T, n) N m, constant in each.
    """

    states: Array
    torques: Array


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


class Path(NamedTuple):
    """A way of the links' sides of the joints of a model from rest to rest, for any duration.

    Attributes:
        bending: of the model.
        ends: (2, d) coordinates at rest before and after.
        motion: gives angles (k, n) rad, and their first and second derivatives, by parts (k,) of the duration.
        parts: of the duration at which torques are compared with their limits.
    """

    bending: Bending
    ends: Array
    motion: Callable[[Array], tuple[Array, Array, Array]]
    parts: Array

    def at(self, parts: Array, duration: float) -> tuple[Array, Array]:
        """Gives the bent coordinates (k, d) and the motor torques (k, n) N m at parts (k,) of a duration (s)."""
        angles, rates, changes = self.motion(parts)
        motions = zip(angles, rates / duration, changes / duration**2, strict=True)
        places, torques = zip(*(self.bending.at(self.ends[0], each) for each in motions), strict=True)
        return np.array(places), np.array(torques)


def slew_path(model: Model, start: Array, goal: Array, law: str = "minimum-jerk") -> Path:
    """Gives the straight path between postures of the motors (n,) rad, by a law of `timing.LAWS`."""
    ends, timing = rest_states(model, np.array([start, goal]))[:, : model.n_dof], LAWS[law]
    first, last = ends[:, : model.n_joints]

    def motion(parts: Array) -> tuple[Array, Array, Array]:
        place, speed, acceleration = (each[:, None] for each in timing.at(parts))
        return first + place * (last - first), speed * (last - first), acceleration * (last - first)

    jumps = timing.begins[1:]
    return Path(Bending(model), ends, motion, _looked_at(jumps - HAIR, jumps))


def via_path(model: Model, postures: Array, count: int) -> Path:
    """Gives the path through postures (m, n) rad of the motors, each at the end of one of `count` control periods.

    It is a cubic spline with two knots more, so that it starts and ends without acceleration (Biagiotti and Melchiorri,
    Trajectory planning for automatic machines and robots, 2008, section 4.4.4). Times between postures go with the
    square roots of their distances (Lee, Computer-Aided Design 21, 1989, 363).
    """
    from scipy.interpolate import make_interp_spline

    rests, order = rest_states(model, postures)[:, : model.n_dof], np.arange(len(postures))
    angles, still = rests[:, : model.n_joints], np.zeros(model.n_joints)
    apart = np.sqrt(np.linalg.norm(np.diff(angles, axis=0), axis=1))
    rows = np.rint(count * np.append(0.0, np.cumsum(apart)) / apart.sum())
    rows = np.minimum(np.maximum.accumulate(rows - order) + order, count - order[::-1])  # a period apart at least
    times = rows / count
    more = (2.0 * times[0] + times[1]) / 3.0, (times[-2] + 2.0 * times[-1]) / 3.0
    knots = np.concatenate([np.zeros(4), more[:1], times[1:-1], more[1:], np.ones(4)])
    rest = [(1, still), (2, still)]
    spline = make_interp_spline(times, angles, k=3, t=knots, bc_type=(rest, rest))

    def motion(parts: Array) -> tuple[Array, Array, Array]:
        return spline(parts), spline(parts, 1), spline(parts, 2)

    return Path(Bending(model), rests[[0, -1]], motion, _looked_at(knots[4:-4]))


def _looked_at(*places: Array) -> Array:
    """Parts of a duration all along it, and others where accelerations may be largest."""
    return np.sort(np.concatenate([np.linspace(0.0, 1.0, SAMPLES), *places]))


def plan_slew(
    model: Model, start: Array, goal: Array, limits: Array, share: float, period: float, law: str = "minimum-jerk"
) -> Reference:
    """Plans the quickest slew of a law whose torques stay within a share of the limits.

    Args:
        model: of the arm.
        start: (n,) rad, motor angles at the beginning.
        goal: (n,) rad, motor angles at the end.
        limits: (n,) N m.
        share: of the limits, that the slew may take; feedback has the rest.
        period: s.
        law: a name of `timing.LAWS`.

    Raises:
        ValueError: for a goal whose weight alone takes more than that, and another law.
    """
    path = slew_path(model, start, goal, one_of("law", law, LAWS))
    slew = _quickest(lambda count: path, share * limits, period, 1)
    if slew is None:
        raise refusal("goal", goal.tolist(), f"a posture that {share:.0%} of the torque limits can hold")
    return slew


def plan_via(model: Model, postures: Array, limits: Array, share: float, period: float) -> Reference:
    """Plans the quickest motion through postures, see `via_path`, whose torques stay within a share of the limits.

    Postures are at ends of periods, which bends the spline a little with each duration: a shorter one may be left out.

    Args:
        model: of the arm.
        postures: (m, n) rad, motor angles; it rests at the first and the last.
        limits: (n,) N m.
        share: of the limits, that the motion may take; feedback has the rest.
        period: s.

    Raises:
        ValueError: for fewer than two postures, one that is that before, and one whose weight alone takes too much.
    """
    if len(postures) < 2 or not np.diff(postures, axis=0).any(axis=1).all():
        raise refusal("postures", postures.tolist(), "two at least, each another than that before")
    motion = _quickest(lambda count: via_path(model, postures, count), share * limits, period, len(postures) - 1)
    if motion is None:
        raise refusal("postures", postures.tolist(), f"postures that {share:.0%} of the torque limits can hold")
    return motion


def _quickest(paths: Callable[[int], Path], bounds: Array, period: float, fewest: int) -> Reference | None:
    """The path in the fewest control periods in which torques stay within bounds (n,) N m, None where none does.

    Torques are those at rest and what inertia asks, which goes with 1 / T^2: both at one T tell the shortest. Bending
    changes that a little, so that it is told anew there.
    """
    count, short = max(fewest, int(LONGEST / period)), fewest - 1
    most, path = count, paths(count)
    rest = path.at(path.parts, np.inf)[1]
    if (np.abs(rest) >= bounds).any():
        return None
    while True:
        asked = path.at(path.parts, count * period)[1] - rest
        needed = np.ceil(count * np.sqrt((np.abs(asked) / (bounds - np.sign(asked) * rest)).max()))
        if not needed <= count:  # nor is no number, of an arm that bends too far
            if count == most:
                return None
            short, count = count, int(min(np.fmax(needed, count + 1), most))
        elif needed == count or count == short + 1:
            return _reference(path, count, period)
        else:
            count = int(max(needed, short + 1))
        path = paths(count)


def _reference(path: Path, count: int, period: float) -> Reference:
    """A path in so many control periods."""
    places, _ = path.at(np.linspace(0.0, 1.0, count + 1), count * period)
    places[[0, -1]] = path.ends
    speeds = np.gradient(places, period, axis=0) if count > 1 else np.zeros_like(places)
    speeds[[0, -1]] = 0.0
    return Reference(np.hstack([places, speeds]), path.at((np.arange(count) + 0.5) / count, count * period)[1])


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
        self._turns = model.at_rest(np.eye(model.n_joints))[:, : model.n_dof].copy()

    def turn(self, rest: Array, place: Array) -> Array:
        """Gives the turn (n,) rad, to first order, for coordinates (d,) each; none into directions that take far."""
        wanted, now = self._seen(rest, self._turns[0])[TIP].copy(), self._seen(place, self._turns[0])[TIP].copy()
        slopes = np.array([self._seen(place, turn)[TIP_VELOCITY].copy() for turn in self._turns]).T
        result: Array = np.linalg.pinv(slopes, rcond=SINGULAR) @ (wanted - now)
        return result

    def _seen(self, x: Array, v: Array) -> Array:
        outputs.observe(self._model.constants, self._work, x, v, self._row)
        return self._row

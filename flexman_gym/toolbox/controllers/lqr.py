"""Linear-quadratic regulators: gain of the sampled model, gain table, regulator about the goal and along a slew."""

import hashlib
import os
import tempfile
from collections.abc import Callable, Sequence
from itertools import product
from pathlib import Path
from typing import Any, NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from flexman_gym.agent.base_controllers import ControllerEntry
from flexman_gym.agent.controller import EpisodeInfo, Plant, Readings, saturated
from flexman_gym.agent.pd import torque_limits
from flexman_gym.common.arrays import Array, BoolArray, IntArray, Vector, pad_rows, row_dots
from flexman_gym.common.checks import check_solvable, mapping, one_of, positive
from flexman_gym.common.errors import value_error
from flexman_gym.common.files import READ_ERRORS, open_arrays
from flexman_gym.kernels.cache import find_cache_folder
from flexman_gym.model.friction import frictionless
from flexman_gym.model.linearization import SLIDING
from flexman_gym.model.model import Model, check_model
from flexman_gym.model.state_space import LinearModel, discretize
from flexman_gym.model.statics import holding_torques, rest_state
from flexman_gym.simulation.linearization import linearize
from flexman_gym.simulation.physical_parameters import varied_model
from flexman_gym.toolbox.controllers.friction_compensation import FrictionCompensation
from flexman_gym.toolbox.controllers.references.trajectories import TIMING_LAWS, plan_path, plan_slew


class CostWeights(NamedTuple):
    """Deviations of unit cost in an LQR (Bryson's rule); a torque has unit cost at its limit.

    Attributes:
        tip: deviation of the tip position, m.
        tip_speed: deviation of the tip velocity, m/s.
        motor: deviation of a motor angle, rad.
    """

    tip: float
    tip_speed: float
    motor: float

    @classmethod
    def default(cls, model: Model) -> Self:
        """Return the cost weights: 20 cm and 1 m/s for a reach of 8.5 m, in proportion to the reach, and 0.5 rad."""
        reach = float(model.constants.length.sum())
        return cls(TIP_SCALE * reach, TIP_SPEED_SCALE * reach, MOTOR_WEIGHT)

    def gain(self, linear: LinearModel, motors: Array, limits: Array, period: float) -> Array:
        """Return the gain K (n, 2 d) of the sampled LQR, torques = -K x, for states x relative to the equilibrium.

        Args:
            linear: linear model about an equilibrium.
            motors: (n,) columns of the motor angles in x.
            limits: (n,) torque limits, N m.
            period: control period, s.

        Raises:
            ValueError: for an arm whose Riccati equation has no solution within rounding.
        """
        from scipy.linalg import solve_discrete_are

        with check_solvable("gains of a regulator"):
            transition, inputs = discretize(linear.A, linear.B, period)
            n, outputs = len(limits), self.outputs(linear, motors)
            scaled = inputs * limits  # torques as fractions of their limits, for a well-scaled equation
            cost = np.diag(1.0 / limits**2) * np.outer(limits, limits)
            equation = transition, scaled, outputs.T @ outputs, cost
            try:
                solution = solve_discrete_are(*equation)
            except (ValueError, np.linalg.LinAlgError):  # caused by balancing
                solution = solve_discrete_are(*equation, balanced=False)
            gain = np.linalg.solve(np.eye(n) + scaled.T @ solution @ scaled, scaled.T @ solution @ transition)
        return limits[:, None] * gain

    def outputs(self, linear: LinearModel, motors: Array) -> Array:
        """Return the matrix (6 + n, 2 d) of the outputs in the cost: tip, its rate and motor angles over weights."""
        d, n = len(linear.A) // 2, len(motors)
        tip, outputs = linear.C[:, :d], np.zeros((6 + n, 2 * d))
        outputs[:3, :d], outputs[3:6, d:] = tip / self.tip, tip / self.tip_speed
        outputs[6:, motors] = np.eye(n) / self.motor
        return outputs


POSTURE_SPACING = 0.17  # rad; distance of postures in the table; with 0.43 rad a folded arm oscillates
SAVE_INTERVAL = 50  # number of new designs (15 ms each) between two writes of the file


class GainTable:
    """Gains K (n, 2 d) of the sampled LQR without friction, interpolated on a grid of postures and payloads.

    Interpolation is multilinear, with postures `POSTURE_SPACING` apart. The angle of a first joint whose axis is
    parallel to gravity does not affect the gains and is no coordinate of the grid.

    Args:
        model: model of the arm.
        limits: (n,) torque limits, N m.
        period: control period, s.
        weights: cost weights.
        payloads: (p,) payloads of the grid, kg, ascending; other payloads are clipped to their range.
    """

    def __init__(
        self, model: Model, limits: Array, period: float, weights: CostWeights, payloads: Sequence[float]
    ) -> None:
        self._design = limits, period, weights
        self._payloads = np.array(payloads, dtype=float)
        model = frictionless(model)
        self._models = [varied_model(model, payload_mass=mass) for mass in payloads]
        posture, rotation = np.full(model.n_joints, 0.3), np.eye(model.n_joints)[0]
        invariant = np.allclose(holding_torques(model, posture), holding_torques(model, posture + rotation))
        self._joints = np.arange(1 if invariant else 0, model.n_joints)
        self._rows: dict[tuple[int, ...], int] = {}  # grid point -> row of its gain
        self._corner_rows: dict[bytes, list[int]] = {}  # cell -> rows of the gains at its corners
        self._gains = np.zeros((0, model.n_joints, 2 * model.n_dof))
        self._cells = np.zeros((0, 1 + len(self._joints)), dtype=np.int64)  # present cell of each arm
        self._corners = np.zeros((0, 2 ** (1 + len(self._joints))), dtype=np.int64)
        self._steps = np.array(list(product((0, 1), repeat=1 + len(self._joints))))
        self._path, self._unsaved = self._file(model), 0
        self._load()

    def __call__(self, arms: IntArray, postures: Array, payloads: Array) -> Array:
        """Return the gains (r, n, 2 d) of the arms (r,) at motor angles (r, n) rad and payloads (r,) kg."""
        count = len(self._payloads)
        places = np.interp(payloads, self._payloads, np.arange(count)) if count > 1 else np.zeros(len(payloads))
        positions = np.column_stack([places, postures[:, self._joints] / POSTURE_SPACING])
        cells = np.floor(positions).astype(np.int64)
        cells[:, 0] = np.minimum(cells[:, 0], max(len(self._payloads) - 2, 0))
        self._find(arms, cells)
        parts = positions - cells
        weights = np.ones((len(positions), len(self._steps)))
        for axis in range(positions.shape[1]):
            part = parts[:, axis, None]
            weights *= np.where(self._steps[:, axis], part, 1.0 - part)
        result = np.zeros((len(positions), *self._gains.shape[1:]))
        for corner in range(len(self._steps)):
            result += weights[:, corner, None, None] * self._gains[self._corners[arms, corner]]
        return result

    def _find(self, arms: IntArray, cells: IntArray) -> None:
        """Update the corner gains of the arms (r,) whose grid cell changed to the cell given in `cells` (r, axes)."""
        count = int(arms.max(initial=-1)) + 1
        if count > len(self._cells):
            outside = np.full((count - len(self._cells), cells.shape[1]), np.iinfo(np.int64).min)
            self._cells, self._corners = np.concatenate([self._cells, outside]), pad_rows(self._corners, count)
        moved: BoolArray = (cells != self._cells[arms]).any(axis=1)
        for arm, cell in zip(arms[moved], cells[moved], strict=True):
            key = cell.tobytes()
            if key not in self._corner_rows:
                self._corner_rows[key] = [self._row(tuple(corner)) for corner in (cell + self._steps).tolist()]
            self._corners[arm] = self._corner_rows[key]
        self._cells[arms] = cells

    def _row(self, key: tuple[int, ...]) -> int:
        """Return the row of the gain at a grid point; a missing gain is computed."""
        key = (min(key[0], len(self._payloads) - 1), *key[1:])
        if key not in self._rows:
            model, posture = self._models[key[0]], np.zeros(self._gains.shape[1])
            posture[self._joints] = POSTURE_SPACING * np.array(key[1:])
            limits, period, weights = self._design
            linear = linearize(model, state=rest_state(model, posture), torque=holding_torques(model, posture))
            gain = weights.gain(linear, model.motor_columns, limits, period)
            self._rows[key] = len(self._gains)
            self._gains = np.concatenate([self._gains, gain[None]])
            self._unsaved += 1
            if self._unsaved >= SAVE_INTERVAL:
                self.save()
        return self._rows[key]

    def _file(self, model: Model) -> Path | None:
        """Return the path of the file with the gains of this arm, in the cache folder of the kernels, or None."""
        folder = find_cache_folder()
        if folder is None:
            return None
        seal = hashlib.sha256(SLIDING.encode())  # separates files of versions that linearised about sticking motors
        for values in (*model.constants, *map(np.array, self._design), self._payloads, np.array(POSTURE_SPACING)):
            seal.update(np.ascontiguousarray(values).tobytes())
        return Path(folder) / f"gains-{seal.hexdigest()[:16]}.npz"

    def _load(self) -> None:
        """Read the gains from the file; an unreadable file is replaced by the next `save`."""
        try:
            with open_arrays(self._path) as data:  # type: ignore[arg-type]
                keys, gains = data["keys"], data["gains"]
        except READ_ERRORS:
            return
        if gains.shape[1:] == self._gains.shape[1:] and keys.shape == (len(gains), 1 + len(self._joints)):
            self._rows = {tuple(key): row for row, key in enumerate(keys.tolist())}
            self._gains = gains

    def save(self) -> None:
        """Write new gains to the file; a file that cannot be written is omitted."""
        if self._path is None or not self._unsaved:
            return
        handle, name = tempfile.mkstemp(dir=self._path.parent, suffix=".npz")
        try:
            with os.fdopen(handle, "wb") as file:
                np.savez(file, keys=np.array(list(self._rows)), gains=self._gains)
            os.replace(name, self._path)
        except OSError:
            Path(name).unlink(missing_ok=True)
        self._unsaved = 0


# Tuned for an arm with a reach of 8.5 m as 0.2 m and 1 m/s; smaller values saturate the torques and fail.
TIP_SCALE, TIP_SPEED_SCALE = 0.2 / 8.5, 1.0 / 8.5  # fraction of the reach, 1/s; tip deviation and speed that cost 1
MOTOR_WEIGHT = 0.5  # rad; motor angle of unit cost
HOLDING_FACTOR = 0.25  # dimensionless; factor of the tip deviation of unit cost for an arm that starts at its goal
FEEDFORWARD_FRACTION = 0.95  # fraction of the torque limits available to the feed-forward
SLEW_POSTURES = 3  # number of postures along a slew at which gains are designed
PATH_POSTURES = 25  # number of postures along a given path at which gains are designed


class _GainSchedule(NamedTuple):
    """Reference states, feed-forward torques and gains of an LQR in each control period.

    Attributes:
        states: (T + 1, 2 d) reference states; T is 0 for a fixed goal.
        torques: (T + 1, n) feed-forward torques, N m.
        gains: (g, n, 2 d) gains at postures along the path.
        positions: (T + 1,) position of each period among these postures, from 0 to g - 1.
    """

    states: Array
    torques: Array
    gains: Array
    positions: Array


class LQR:
    """Linear-quadratic regulator about the goal: torque = holding torque - K (state - equilibrium), saturated.

    The gain K is that of the arm without friction; friction is compensated, see `FrictionCompensation`.

    The regulator requires the true state and an exact model, and therefore serves as a benchmark rather than as a
    controller for hardware.

    Args:
        model: model of the arm, with the same generalised coordinates as the controlled arm.
        torque_limit: torque limit of all joints, or of each joint (n,), N m.
        period: control period, s.
        weights: cost weights; None for `CostWeights.default`.

    Examples:
        >>> import numpy as np
        >>> import flexman_gym as fm
        >>> from flexman_gym.control import LQR, EpisodeInfo
        >>> model = fm.build_model(fm.catalog.one_joint(), elements=1)
        >>> lqr = LQR(model, torque_limit=10.0, period=0.01)
        >>> lqr.reset(np.array([0]), EpisodeInfo(np.zeros((1, 1)), np.array([[0.2]]), period=0.01), count=1)
        >>> lqr.act({"state": fm.rest_state(model, [0.2])[None]}).round(6).tolist()
        [[0.0]]
    """

    sensors: tuple[str, ...] = ("state",)
    c_program = "flexman_gym.toolbox.deployment.c_programs:lqr_program"

    def __init__(
        self, model: Model, torque_limit: float | Vector, period: float, weights: CostWeights | None = None
    ) -> None:
        for i in np.flatnonzero(check_model(model).constants.passive):
            raise value_error(f"LQR.model: arm.joints[{i}].passive", True, "an arm with a motor at each joint")
        n, d = model.n_joints, model.n_dof
        self.model = self.gravity_model = model
        self.period = positive("period", period, "s")
        self.limits = np.array(torque_limits("torque_limit", torque_limit, n))
        self.weights = weights or CostWeights.default(model)
        self._gains, self._rest, self._holding_torques = np.zeros((0, n, 2 * d)), np.zeros((0, 2 * d)), np.zeros((0, n))
        self._compensation = FrictionCompensation(Plant(model, tuple(self.limits.tolist()), period, dict))

    def gain(self, posture: Array, weights: CostWeights | None = None) -> Array:
        """Return the gain K (n, 2 d) at motor angles (n,) rad; weights None for the weights of the regulator."""
        state, holding = rest_state(self.model, posture), holding_torques(self.model, posture)
        linear = linearize(self._compensation.model, state=state, torque=holding)
        return (weights or self.weights).gain(linear, self.model.motor_columns, self.limits, self.period)

    def reset(self, arms: IntArray, episode: EpisodeInfo, count: int) -> None:
        """Compute gains and equilibria for new episodes; arguments as in `Controller.reset`."""
        self._gains, self._rest, self._holding_torques = (
            pad_rows(values, count) for values in (self._gains, self._rest, self._holding_torques)
        )
        for arm, angles in zip(arms, episode.goal, strict=True):
            self._gains[arm] = self.gain(angles)
            self._rest[arm], self._holding_torques[arm] = (
                rest_state(self.model, angles),
                holding_torques(self.model, angles),
            )

    def act(
        self, readings: Readings, applied: Array | None = None, active: BoolArray | None = None
    ) -> NDArray[np.floating]:
        """Return the actions (b, n) for states (b, 2 d), or (n,) for a state (2 d,)."""
        state = readings["state"]
        single = state.ndim == 1
        states = np.asarray(state, dtype=np.float64)
        torques = self.torques(states[None] if single else states)
        actions = np.clip(torques / self.limits, -1.0, 1.0)
        return actions[0] if single else actions

    def torques(self, states: Array) -> Array:
        """Return the torques (b, n) for states (b, 2 d), N m; products are computed arm by arm."""
        return self.compensated(self._holding_torques - row_dots(self._gains, (states - self._rest)[:, None]), states)

    def derivatives(self, readings: Readings, changes: Readings) -> tuple[Array, Array]:
        """Return the actions (1, n) of an arm and their derivatives (p, n), see `Controller`."""
        gain, reference, forward = self._feedback(0)
        states, state_changes = np.asarray(readings["state"], dtype=np.float64), changes["state"]
        torques, change = forward - row_dots(gain, (states - reference)[:, None]), -(state_changes @ gain.T)
        change = change + self._compensation.derivatives((torques, change), (states, state_changes))
        return saturated(self.compensated(torques, states) / self.limits, change / self.limits)

    def move_tables(self) -> dict[str, Array]:
        """Return the tables of `_GainSchedule` for the present move of a single arm, by name.

        Raises:
            ValueError: for a model with friction, whose compensation needs a simulation in every control period.
        """
        self._compensation.check_none("lqr")
        return self._schedule()._asdict()

    def _schedule(self) -> _GainSchedule:
        return _GainSchedule(self._rest[:1], self._holding_torques[:1], self._gains[:1], np.zeros(1))

    def _feedback(self, arm: int) -> tuple[Array, Array, Array]:
        """Return gain K (n, 2 d), reference state (2 d,) and feed-forward torques (n,) of an arm in this period."""
        return self._gains[arm], self._rest[arm], self._holding_torques[arm]

    def compensated(self, torques: Array, states: Array) -> Array:
        """Return torques (b, n), N m, with the friction at states (b, 2 d) compensated, see `FrictionCompensation`."""
        return torques + self._compensation(torques, states, np.arange(len(states)), len(states))


class TrackingLQR(LQR):
    """LQR about a slew within the torque limits, with feed-forward torques and gains scheduled along the path.

    An arm that starts at its goal is held with a larger cost of the tip deviation. For a moving goal the reference is
    the path of the goal.

    Args:
        model: see `LQR`.
        torque_limit: see `LQR`.
        period: see `LQR`.
        weights: see `LQR`.
        timing_law: timing law of the slew: "minimum-jerk", "trapezoid" or "double-s".
    """

    state_fields = ("_now",)
    c_program = LQR.c_program

    def __init__(
        self,
        model: Model,
        torque_limit: float | Vector,
        period: float,
        weights: CostWeights | None = None,
        timing_law: str = "minimum-jerk",
    ) -> None:
        super().__init__(model, torque_limit, period, weights)
        self.timing_law = one_of("timing_law", timing_law, TIMING_LAWS)
        self._schedules: list[_GainSchedule] = []
        self._now = np.zeros(0, dtype=np.int64)

    def reset(self, arms: IntArray, episode: EpisodeInfo, count: int) -> None:
        """Plan the slews of new episodes, or motions along moving goals; arguments as in `Controller.reset`."""
        if episode.reference is not None:
            self._plan_paths(arms, episode.reference)
            return
        motors = self.model.motor_columns
        for arm, first, last in zip(arms, episode.start, episode.goal, strict=True):
            if np.array_equal(first, last):
                self._start(int(arm), self._holding_schedule(last))
                continue
            slew = plan_slew(self.model, first, last, self.limits, FEEDFORWARD_FRACTION, self.period, self.timing_law)
            gains = np.array(
                [self.gain(first + progress * (last - first)) for progress in np.linspace(0.0, 1.0, SLEW_POSTURES)]
            )
            moved = slew.states[:, motors] - slew.states[0, motors]
            progress = row_dots(moved, moved[-1]) / max(moved[-1] @ moved[-1], 1e-12)
            torques = np.vstack([slew.torques, holding_torques(self.model, last)])
            positions = (SLEW_POSTURES - 1) * np.clip(progress, 0.0, 1.0)
            self._start(int(arm), _GainSchedule(slew.states, torques, gains, positions))

    def _holding_schedule(self, posture: Array) -> _GainSchedule:
        """Return the schedule of an arm that holds a posture (n,) rad, with a larger cost of the tip deviation."""
        tight = self.weights._replace(tip=HOLDING_FACTOR * self.weights.tip)
        holding = holding_torques(self.model, posture)[None]
        return _GainSchedule(
            rest_state(self.model, posture)[None], holding, self.gain(posture, tight)[None], np.zeros(1)
        )

    def _plan_paths(self, arms: IntArray, postures: Array) -> None:
        """Plan the motion of the arms (r,) through goal postures (r, T + 1, n) rad, one per control period."""
        for arm, path in zip(arms, postures, strict=True):
            slew = plan_path(self.model, path, self.period)
            rows = np.linspace(0, len(path) - 1, min(PATH_POSTURES, len(path))).round().astype(int)
            gains = np.array([self.gain(path[row]) for row in rows])
            positions = np.interp(np.arange(len(path)), rows, np.arange(len(rows)))
            torques = np.vstack([slew.torques, slew.torques[-1:]])
            self._start(int(arm), _GainSchedule(slew.states, torques, gains, positions))

    def _start(self, arm: int, schedule: _GainSchedule) -> None:
        """Start the schedule of an arm."""
        empty = _GainSchedule(*(np.zeros(0),) * 4)
        self._schedules += [empty] * (arm + 1 - len(self._schedules))
        self._now = pad_rows(self._now, arm + 1)
        self._schedules[arm], self._now[arm] = schedule, 0

    def skip(self, active: BoolArray) -> None:
        """Advance the references of the active arms by a control period without readings, see `Controller`."""
        self._now[active] += 1

    def _schedule(self) -> _GainSchedule:
        return self._schedules[0]

    def torques(self, states: Array) -> Array:
        """Return the torques (b, n) for states (b, 2 d), N m, and advance by a control period."""
        result = np.zeros((len(states), self.model.n_joints))
        for arm, state in enumerate(states):
            gain, reference, torque = self._feedback(arm)
            result[arm] = torque - row_dots(gain, state - reference)
        self._now += 1
        return self.compensated(result, states)

    def _feedback(self, arm: int) -> tuple[Array, Array, Array]:
        """Return gain K (n, 2 d), reference state (2 d,) and feed-forward torques (n,) of an arm in this period."""
        schedule = self._schedules[arm]
        row, gains = min(self._now[arm], len(schedule.states) - 1), schedule.gains
        lower = min(int(schedule.positions[row]), max(len(gains) - 2, 0))
        upper, part = min(lower + 1, len(gains) - 1), schedule.positions[row] - lower
        gain = gains[lower] + part * (gains[upper] - gains[lower])
        return gain, schedule.states[row], schedule.torques[row]


def parse_weights(value: object) -> CostWeights | None:
    """Return the cost weights of a mapping "tip" (m), "tip_speed" (m/s) and "motor" (rad); None for None."""
    if value is None:
        return None
    given = mapping("base.weights", value, CostWeights._fields)
    if len(given) < len(CostWeights._fields):
        raise value_error("base.weights", given, "a mapping with tip (m), tip_speed (m/s) and motor (rad)")
    return CostWeights(**{name: positive(f"base.weights.{name}", each) for name, each in given.items()})


def _maker(regulator: type[LQR]) -> Callable[..., LQR]:
    def make(plant: Plant, weights: object = None, **options: Any) -> LQR:
        return regulator(plant.model, plant.torque_limit, plant.period, parse_weights(weights), **options)

    return make


LQR_ENTRY = ControllerEntry(
    _maker(LQR), ("model", "true state"), ("weights",), "a linear-quadratic regulator about the goal"
)
TRACKING_ENTRY = ControllerEntry(
    _maker(TrackingLQR),
    ("model", "true state"),
    ("weights", "timing_law"),
    "a linear-quadratic regulator that tracks a smooth slew, or a path",
)

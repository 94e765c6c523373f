"""Linear-quadratic regulators: gain of the sampled model, table of gains, control at the goal and along a slew."""

import hashlib
import os
import tempfile
from collections.abc import Sequence
from itertools import product
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from flexman_gym.common.arrays import Array, BoolArray, IntArray, Vector, pad_rows, row_dots
from flexman_gym.common.checks import check_solvable, one_of, positive
from flexman_gym.common.files import READ_ERRORS, open_arrays
from flexman_gym.control.controller import EpisodeInfo, Readings
from flexman_gym.control.pd import torque_limits
from flexman_gym.control.references.trajectories import TIMING_LAWS, plan_path, plan_slew
from flexman_gym.kernels.cache import find_cache_folder
from flexman_gym.model.linearization import SLIDING, linearize
from flexman_gym.model.model import Model, check_model
from flexman_gym.model.state_space import LinearModel, discretize
from flexman_gym.model.statics import holding_torques, rest_state
from flexman_gym.simulation.parameters import varied_model


class CostWeights(NamedTuple):
    """Departures that weigh alike in the cost of an LQR: tip in m, its speed in m/s, motor angles in rad.

    Torques weigh as much where they reach their limits.
    """

    tip: float
    tip_speed: float
    motor: float


def lqr_gain(linear: LinearModel, motors: Array, limits: Array, weights: CostWeights, period: float) -> Array:
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
    with check_solvable("gains of a regulator"):
        return _riccati_gain(linear, motors, limits, weights, period)


def performance_outputs(linear: LinearModel, motors: Array, weights: CostWeights) -> Array:
    """Gives what a cost squares (6 + n, 2 d): tip, its velocity and motor angles, parts of their weights."""
    d, n = len(linear.A) // 2, len(motors)
    tip, outputs = linear.C[:, :d], np.zeros((6 + n, 2 * d))
    outputs[:3, :d], outputs[3:6, d:] = tip / weights.tip, tip / weights.tip_speed
    outputs[6:, motors] = np.eye(n) / weights.motor
    return outputs


def _riccati_gain(linear: LinearModel, motors: Array, limits: Array, weights: CostWeights, period: float) -> Array:
    from scipy.linalg import solve_discrete_are

    transition, inputs = discretize(linear.A, linear.B, period)
    n, outputs = len(limits), performance_outputs(linear, motors, weights)
    cost = np.diag(1.0 / limits**2)
    # torques in parts of their limits, so that the equation is well scaled
    scaled = inputs * limits
    solution = solve_discrete_are(transition, scaled, outputs.T @ outputs, cost * np.outer(limits, limits))
    gain = np.linalg.solve(np.eye(n) + scaled.T @ solution @ scaled, scaled.T @ solution @ transition)
    return limits[:, None] * gain


POSTURE_SPACING = 0.17  # rad between postures; with 0.43 the gains between two of them let a folded arm shake
SAVE_INTERVAL = 50  # designs, of 15 ms each, that a killed process may lose


class GainTable:
    """Gains K (n, 2 d) of the sampled LQR, linear between designs at postures SPACING apart and at some payloads.

    A first joint that turns the arm about the direction of gravity changes nothing and has no axis in the table.

    Args:
        model: of the arm.
        limits: (n,) N m, torque limits.
        period: of control, s.
        weights: of the cost.
        payloads: kg, ascending; one, or several between which the payload is interpolated and beyond which it is not.
    """

    def __init__(
        self, model: Model, limits: Array, period: float, weights: CostWeights, payloads: Sequence[float]
    ) -> None:
        self._design = limits, period, weights
        self._payloads = np.array(payloads, dtype=float)
        self._models = [varied_model(model, payload_mass=mass) for mass in payloads]
        somewhere, turn = np.full(model.n_joints, 0.3), np.eye(model.n_joints)[0]
        alike = np.allclose(holding_torques(model, somewhere), holding_torques(model, somewhere + turn))
        self._joints = np.arange(1 if alike else 0, model.n_joints)
        self._rows: dict[tuple[int, ...], int] = {}
        self._rows_of: dict[bytes, list[int]] = {}  # those of the corners of a cell
        self._gains = np.zeros((0, model.n_joints, 2 * model.n_dof))
        self._cells = np.zeros((0, 1 + len(self._joints)), dtype=np.int64)  # of each arm, and the rows of its corners
        self._corners = np.zeros((0, 2 ** (1 + len(self._joints))), dtype=np.int64)
        self._steps = np.array(list(product((0, 1), repeat=1 + len(self._joints))))
        self._path, self._unsaved = self._file(model), 0
        self._load()

    def __call__(self, arms: IntArray, postures: Array, payloads: Array) -> Array:
        """Gives the gains (r, n, 2 d) of the arms (r,) at motor angles (r, n) rad and payloads (r,) kg."""
        places = np.column_stack([self._between(payloads), postures[:, self._joints] / POSTURE_SPACING])
        cells = np.floor(places).astype(np.int64)
        cells[:, 0] = np.minimum(cells[:, 0], max(len(self._payloads) - 2, 0))
        self._find(arms, cells)
        parts = places - cells
        weights = np.ones((len(places), len(self._steps)))
        for axis in range(places.shape[1]):
            part = parts[:, axis, None]
            weights *= np.where(self._steps[:, axis], part, 1.0 - part)
        result = np.zeros((len(places), *self._gains.shape[1:]))
        for corner in range(len(self._steps)):
            result += weights[:, corner, None, None] * self._gains[self._corners[arms, corner]]
        return result

    def _between(self, payloads: Array) -> Array:
        """Where payloads (b,) are among those of the table, from 0 on."""
        if len(self._payloads) == 1:
            return np.zeros(len(payloads))
        return np.interp(payloads, self._payloads, np.arange(len(self._payloads)))

    def _find(self, arms: IntArray, cells: IntArray) -> None:
        """Looks up the corners of the cells (r, axes) of the arms (r,) that have come into another one."""
        count = int(arms.max(initial=-1)) + 1
        if count > len(self._cells):
            far = np.full((count - len(self._cells), cells.shape[1]), np.iinfo(np.int64).min)
            self._cells, self._corners = np.concatenate([self._cells, far]), pad_rows(self._corners, count)
        moved: BoolArray = (cells != self._cells[arms]).any(axis=1)
        for arm, cell in zip(arms[moved], cells[moved], strict=True):
            key = cell.tobytes()
            if key not in self._rows_of:
                self._rows_of[key] = [self._row(tuple(corner)) for corner in (cell + self._steps).tolist()]
            self._corners[arm] = self._rows_of[key]
        self._cells[arms] = cells

    def _row(self, key: tuple[int, ...]) -> int:
        """The row of a design, which is made where it is missing."""
        key = (min(key[0], len(self._payloads) - 1), *key[1:])
        if key not in self._rows:
            model, posture = self._models[key[0]], np.zeros(self._gains.shape[1])
            posture[self._joints] = POSTURE_SPACING * np.array(key[1:])
            limits, period, weights = self._design
            linear = linearize(model, state=rest_state(model, posture), torque=holding_torques(model, posture))
            gain = lqr_gain(linear, model.motor_columns, limits, weights, period)
            self._rows[key] = len(self._gains)
            self._gains = np.concatenate([self._gains, gain[None]])
            self._unsaved += 1
            if self._unsaved >= SAVE_INTERVAL:
                self.save()
        return self._rows[key]

    def _file(self, model: Model) -> Path | None:
        """Where designs for this arm are kept, beside the kernels that they were calculated with."""
        folder = find_cache_folder()
        if folder is None:
            return None
        seal = hashlib.sha256(SLIDING.encode())  # designs of motors that stick were kept before
        for values in (*model.constants, *map(np.array, self._design), self._payloads, np.array(POSTURE_SPACING)):
            seal.update(np.ascontiguousarray(values).tobytes())
        return Path(folder) / f"gains-{seal.hexdigest()[:16]}.npz"

    def _load(self) -> None:
        """Takes the designs of the file; one that cannot be read is written anew."""
        try:
            with open_arrays(self._path) as data:  # type: ignore[arg-type]
                keys, gains = data["keys"], data["gains"]
        except READ_ERRORS:
            return
        if gains.shape[1:] == self._gains.shape[1:] and keys.shape == (len(gains), 1 + len(self._joints)):
            self._rows = {tuple(key): row for row, key in enumerate(keys.tolist())}
            self._gains = gains

    def save(self) -> None:
        """Writes the designs to the file, where one can be written."""
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


TIP_WEIGHT, TIP_SPEED_WEIGHT, MOTOR_WEIGHT = (
    0.2 / 8.5,
    1.0 / 8.5,
    0.5,
)  # of the reach, reaches a second, rad: stiffer ones saturate and fail
HOLDING_FACTOR = 0.25  # of the weight of the tip, where an arm starts at its goal
TORQUE_SHARE = 0.95  # of the torque limits, for the feed-forward
SLEW_POSTURES, PATH_POSTURES = 3, 25  # postures along a slew, and along a path, for which gains are designed


def default_weights(model: Model) -> CostWeights:
    """Gives 20 cm of tip, 1 m/s and 0.5 rad for 8.5 m of reach, and as large parts of other reaches."""
    reach = float(model.constants.length.sum())
    return CostWeights(TIP_WEIGHT * reach, TIP_SPEED_WEIGHT * reach, MOTOR_WEIGHT)


class LQR:
    """Linear-quadratic regulator at the goal: holding torques - K (state - rest at the goal), saturated.

    It knows the true state, and its model is the arm: the yardstick of what control can do, not something to build.

    Args:
        model: of the arm, with as many coordinates as the one that is controlled.
        torque_limit: N m, one number or one for each joint.
        period: of control, s.
        weights: of the cost; None takes `default_weights`.

    Raises:
        ValueError: one line with field, value and what is allowed.
    """

    sensors: tuple[str, ...] = ("state",)

    def __init__(
        self, model: Model, torque_limit: float | Vector, period: float, weights: CostWeights | None = None
    ) -> None:
        check_model(model)
        n, d = model.n_joints, model.n_dof
        self.model, self.period = model, positive("period", period, "s")
        self.limits = np.array(torque_limits("torque_limit", torque_limit, n))
        self.weights = weights or default_weights(model)
        self._gains, self._rest, self._held = np.zeros((0, n, 2 * d)), np.zeros((0, 2 * d)), np.zeros((0, n))

    def gain(self, posture: Array, weights: CostWeights | None = None) -> Array:
        """Designs K (n, 2 d) for a posture (n,) rad of the motors; weights of None are its own."""
        state, held = rest_state(self.model, posture), holding_torques(self.model, posture)
        linear = linearize(self.model, state=state, torque=held)
        return lqr_gain(linear, self.model.motor_columns, self.limits, weights or self.weights, self.period)

    def reset(self, arms: IntArray, episode: EpisodeInfo, count: int) -> None:
        """Designs for new episodes of the arms (r,)."""
        self._gains, self._rest, self._held = (
            pad_rows(values, count) for values in (self._gains, self._rest, self._held)
        )
        for arm, angles in zip(arms, episode.goal, strict=True):
            self._gains[arm] = self.gain(angles)
            self._rest[arm], self._held[arm] = rest_state(self.model, angles), holding_torques(self.model, angles)

    def act(
        self, readings: Readings, applied: Array | None = None, active: BoolArray | None = None
    ) -> NDArray[np.floating]:
        """Gives actions (b, n), or (n,), for the state."""
        state = readings["state"]
        alone = state.ndim == 1
        states = np.asarray(state, dtype=np.float64)
        torques = self.torques(states[None] if alone else states)
        actions = np.clip(torques / self.limits, -1.0, 1.0)
        return actions[0] if alone else actions

    def torques(self, states: Array) -> Array:
        """Gives torques (b, n) N m for states (b, 2 d), product by product of one arm."""
        return self._held - row_dots(self._gains, (states - self._rest)[:, None])


class _GainSchedule(NamedTuple):
    """What a tracking LQR follows, period by period.

    Attributes:
        states: (T + 1, 2 d).
        torques: (T + 1, n) N m.
        gains: (g, n, 2 d) for some places along the way.
        places: (T + 1,) where each period is among them, from 0 to g - 1.
    """

    states: Array
    torques: Array
    gains: Array
    places: Array


class TrackingLQR(LQR):
    """LQR about a slew within the torque limits, with feed-forward and gains scheduled along the way.

    An arm that starts at its goal is held there more tightly. Of a task whose goal moves it follows the path of the
    goal instead. Other arguments and errors are those of `LQR`.

    Args:
        law: of the slew, "minimum-jerk", "trapezoid" or "double-s".
    """

    state_fields = ("_now",)

    def __init__(
        self,
        model: Model,
        torque_limit: float | Vector,
        period: float,
        weights: CostWeights | None = None,
        law: str = "minimum-jerk",
    ) -> None:
        super().__init__(model, torque_limit, period, weights)
        self.law = one_of("law", law, TIMING_LAWS)
        self._plans: list[_GainSchedule] = []
        self._now = np.zeros(0, dtype=np.int64)

    def reset(self, arms: IntArray, episode: EpisodeInfo, count: int) -> None:
        """Plans how the arms (r,) slew to their goals, or follow those that move."""
        if episode.reference is not None:
            self._follow(arms, episode.reference)
            return
        motors = self.model.motor_columns
        for arm, first, last in zip(arms, episode.start, episode.goal, strict=True):
            if np.array_equal(first, last):
                self._keep(int(arm), self._holding(last))
                continue
            slew = plan_slew(self.model, first, last, self.limits, TORQUE_SHARE, self.period, self.law)
            gains = np.array([self.gain(first + way * (last - first)) for way in np.linspace(0.0, 1.0, SLEW_POSTURES)])
            moved = slew.states[:, motors] - slew.states[0, motors]
            way = row_dots(moved, moved[-1]) / max(moved[-1] @ moved[-1], 1e-12)
            torques = np.vstack([slew.torques, holding_torques(self.model, last)])
            self._keep(
                int(arm), _GainSchedule(slew.states, torques, gains, (SLEW_POSTURES - 1) * np.clip(way, 0.0, 1.0))
            )

    def _holding(self, posture: Array) -> _GainSchedule:
        """Stays at a posture; nothing has to be saved for a slew, so that the tip weighs more."""
        tight = self.weights._replace(tip=HOLDING_FACTOR * self.weights.tip)
        held = holding_torques(self.model, posture)[None]
        return _GainSchedule(rest_state(self.model, posture)[None], held, self.gain(posture, tight)[None], np.zeros(1))

    def _follow(self, arms: IntArray, postures: Array) -> None:
        """Plans how the arms (r,) follow goal postures (r, T + 1, n) rad, one for each control period."""
        for arm, path in zip(arms, postures, strict=True):
            slew = plan_path(self.model, path, self.period)
            rows = np.linspace(0, len(path) - 1, min(PATH_POSTURES, len(path))).round().astype(int)
            gains = np.array([self.gain(path[row]) for row in rows])
            places = np.interp(np.arange(len(path)), rows, np.arange(len(rows)))
            self._keep(
                int(arm), _GainSchedule(slew.states, np.vstack([slew.torques, slew.torques[-1:]]), gains, places)
            )

    def _keep(self, arm: int, plan: _GainSchedule) -> None:
        """Begins a plan of an arm."""
        empty = _GainSchedule(*(np.zeros(0),) * 4)
        self._plans += [empty] * (arm + 1 - len(self._plans))
        self._now = pad_rows(self._now, arm + 1)
        self._plans[arm], self._now[arm] = plan, 0

    def torques(self, states: Array) -> Array:
        """Gives torques (b, n) N m for states (b, 2 d), and moves on by a period."""
        result = np.zeros((len(states), self.model.n_joints))
        for arm, state in enumerate(states):
            plan = self._plans[arm]
            row = min(self._now[arm], len(plan.states) - 1)
            lower = min(int(plan.places[row]), max(len(plan.gains) - 2, 0))
            upper, part = min(lower + 1, len(plan.gains) - 1), plan.places[row] - lower
            gain = plan.gains[lower] + part * (plan.gains[upper] - plan.gains[lower])
            result[arm] = plan.torques[row] - row_dots(gain, state - plan.states[row])
        self._now += 1
        return result

"""MPC: model predictive control within the torque limits, of predictions that the simulator makes in every period."""

from collections.abc import Sequence
from types import ModuleType
from typing import NamedTuple

import numpy as np

from flexman_gym.common.arrays import Array, BoolArray, IntArray, Vector, pad_rows, row_dots
from flexman_gym.common.checks import value_error
from flexman_gym.control.controller import EpisodeInfo, Readings
from flexman_gym.control.lqr import MOTOR_WEIGHT, CostWeights, performance_outputs
from flexman_gym.control.pd import torque_limits
from flexman_gym.control.references.trajectories import plan_slew
from flexman_gym.kernels.layout import TIP, TIP_VELOCITY
from flexman_gym.model.linearization import linearize
from flexman_gym.model.model import Model, check_model
from flexman_gym.model.state_space import discretize
from flexman_gym.model.statics import holding_torques, rest_state
from flexman_gym.simulation.batch import Batch
from flexman_gym.simulation.methods import DEFAULT_METHOD, Method

TIP_WEIGHT, TIP_SPEED_WEIGHT = (
    0.05 / 8.5,
    0.5 / 8.5,
)  # of the reach, reaches a second: a quarter and half of those of the LQR
SLEW_SHARE = 1.3  # of the torque limits, for the slew that it follows as well as they allow
MAX_CHANGE = 0.05  # of the torque limits, by which planned torques change at most in a period, so that slopes hold
LINEARISATION_PERIOD = 20  # periods, where the arm is looked at for how it is linearised
LINEARISATION_POSTURES = 5  # along a slew, at which the arm is linearised
MIN_SQUARED_LENGTH = 1e-12  # rad^2
MOVE_BLOCKS = (1, 2, 3, 4, 5, 5, 5, 6, 7, 7, 8, 10)  # control periods for which a change of the planned torques lasts


class _Horizon(NamedTuple):
    """What is to be small over N periods, linear in m = blocks x n changes of planned torques, in parts of the limits.

    Outputs are parts of the weights: tip, its speed and motors after each period but the last, whose whole state
    counts as the infinite-horizon LQR would go on.

    Attributes:
        slopes: (m, (N - 1) (6 + n) + 2 d) of the outputs with each change.
        curvature: (m, m) of the cost.
        ending: (2 d, 2 d) outputs of the last state.
    """

    jacobian: Array
    curvature: Array
    terminal: Array


def _design_horizon(
    model: Model, posture: Array, limits: Array, weights: CostWeights, period: float, blocks: Sequence[int]
) -> _Horizon:
    """Designs for a posture (n,) rad of the motors; blocks are numbers of control periods, whose sum is N."""
    from scipy.linalg import solve_discrete_are

    linear = linearize(model, state=rest_state(model, posture), torque=holding_torques(model, posture))
    transition, inputs = discretize(linear.A, linear.B, period)
    inputs, d, n = inputs * limits, model.n_dof, len(limits)
    outputs = performance_outputs(linear, model.motor_columns, weights)
    squares, axes = np.linalg.eigh(solve_discrete_are(transition, inputs, outputs.T @ outputs, np.eye(n)))
    ending = np.sqrt(np.maximum(squares, 0.0))[:, None] * axes.T
    state, rows = np.zeros((2 * d, n * len(blocks))), []
    for block in np.repeat(np.arange(len(blocks)), blocks):
        state = transition @ state
        state[:, n * block : n * (block + 1)] += inputs
        rows.append(outputs @ state)
    slopes = np.vstack([*rows[:-1], ending @ state]).T.copy()
    return _Horizon(slopes, slopes @ slopes.T + np.diag(np.repeat(np.array(blocks, dtype=float), n)), ending)


class _Plan(NamedTuple):
    """What an arm follows: horizons (g, ...) on its way, start and way (n,) rad, and the slew with N periods of rest.

    states (T, 2 d), outputs (T, OUTPUTS), torques (T, n) parts of the limits.
    """

    horizons: _Horizon
    start: Array
    displacement: Array
    states: Array
    outputs: Array
    torques: Array


class MPC:
    """Model predictive control of a slew: in every period it plans torques for N periods, and applies the first.

    The simulator predicts where the torques planned before lead, the whole arm with all that is not linear. A
    quadratic program then finds the changes of them, constant in blocks of periods (move blocking), that bring the
    prediction closest to a minimum-jerk slew, which would take half more than the motors have. How changes act is
    linear, scheduled along the way. For a linear arm within its limits it is the finite-horizon LQR.

    Args:
        model: of the arm, with as many coordinates as the one that is controlled.
        torque_limit: N m, one number or one for each joint.
        period: of control, s.
        moved: method and step (s) of the prediction.

    Raises:
        ImportError: without daqp (Arnström, Bemporad and Axehill, IEEE Trans. Automatic Control 67, 2022, 4362), which
            solves the quadratic programs.
        ValueError: one line with field, value and what is allowed; in `reset` for a goal that moves.
    """

    sensors: tuple[str, ...] = ("state",)
    state_fields = ("_planned", "_now")

    def __init__(
        self,
        model: Model,
        torque_limit: float | Vector,
        period: float,
        integration: tuple[str | Method, float | str] = (DEFAULT_METHOD, "auto"),
    ) -> None:
        self._daqp = _import_solver()
        reach = float(check_model(model).constants.length.sum())
        self.model, self.period, self._integration = model, period, integration
        self.limits = np.array(torque_limits("torque_limit", torque_limit, model.n_joints))
        self._weights = CostWeights(TIP_WEIGHT * reach, TIP_SPEED_WEIGHT * reach, MOTOR_WEIGHT)
        self._plans: list[_Plan] = []
        self._planned, self._now = np.zeros((0, sum(MOVE_BLOCKS), model.n_joints)), np.zeros(0, dtype=np.int64)
        self._batch = self._make_batch(1)

    def _make_batch(self, count: int) -> Batch:
        return Batch(self.model, *self._integration, self.period, arms=count)

    def reset(self, arms: IntArray, episode: EpisodeInfo, count: int) -> None:
        """Plans the slews of the arms (r,), and designs for postures on their ways."""
        if episode.path is not None:
            raise value_error("episode", "a goal that moves", "one that stays, for which the MPC plans")
        self._planned, self._now = pad_rows(self._planned, count), pad_rows(self._now, count)
        for arm, start, goal in zip(arms.tolist(), episode.start, episode.goal, strict=True):
            plan = self._plan(start, goal)
            self._plans += [plan] * (arm + 1 - len(self._plans))
            self._plans[arm] = plan
            self._planned[arm], self._now[arm] = np.clip(plan.torques[: sum(MOVE_BLOCKS)], -1.0, 1.0), 0

    def _plan(self, start: Array, goal: Array) -> _Plan:
        slew, rest = plan_slew(self.model, start, goal, self.limits, SLEW_SHARE, self.period), sum(MOVE_BLOCKS) + 1
        states = np.vstack([slew.states, np.repeat(slew.states[-1:], rest, axis=0)])
        torques = np.vstack([slew.torques, np.repeat(holding_torques(self.model, goal)[None], rest + 1, axis=0)])
        batch = self._make_batch(len(states))
        batch.reset(np.arange(len(states)), states)
        postures = start + np.linspace(0.0, 1.0, LINEARISATION_POSTURES)[:, None] * (goal - start)
        each = [
            _design_horizon(self.model, one, self.limits, self._weights, self.period, MOVE_BLOCKS) for one in postures
        ]
        horizons = _Horizon(*(np.array(parts) for parts in zip(*each, strict=True)))
        return _Plan(horizons, start, goal - start, states, batch.outputs, torques / self.limits)

    def act(self, readings: Readings, applied: Array, active: BoolArray) -> Array:
        """Gives actions (b, n) for the state; 0 for arms that do not play."""
        states = np.asarray(readings["state"], dtype=np.float64)
        if len(self._batch.rows) != len(states):
            self._batch = self._make_batch(len(states))
        self._batch.reset(np.arange(len(states)), np.where(active[:, None], states, 0.0))
        drives = np.zeros((*self._planned.shape[:2], self.model.n_joints + 6))
        drives[..., : len(self.limits)] = self._planned * self.limits
        predicted = self._batch.roll(drives)
        actions = np.zeros((len(states), len(self.limits)))
        for arm in np.flatnonzero(active).tolist():
            actions[arm] = self._step(arm, predicted[0][arm], predicted[1][arm])
        return actions

    def _step(self, arm: int, states: Array, outputs: Array) -> Array:
        """The action (n,) of an arm whose planned torques lead to states (N, 2 d) and outputs (N, OUTPUTS)."""
        plan, now, n = self._plans[arm], int(self._now[arm]), len(self.limits)
        rows = np.minimum(now + np.arange(sum(MOVE_BLOCKS) + 1), len(plan.states) - 1)
        planned, firsts = self._planned[arm], np.cumsum((0, *MOVE_BLOCKS[:-1]))
        if np.isfinite(states).all():  # it cannot be told where an arm goes that comes apart
            horizon = self._interpolate(plan, states[LINEARISATION_PERIOD])
            gap = self._residuals(horizon, states - plan.states[rows[1:]], outputs - plan.outputs[rows[1:]])
            beyond = np.add.reduceat(planned - plan.torques[rows[:-1]], firsts).ravel()
            mean = (np.add.reduceat(planned, firsts) / np.array(MOVE_BLOCKS)[:, None]).ravel()
            slope = row_dots(horizon.jacobian, gap) + beyond
            low, high = np.maximum(-1.0 - mean, -MAX_CHANGE), np.minimum(1.0 - mean, MAX_CHANGE)
            changes = _solve_quadratic_program(self._daqp, horizon.curvature, slope, low, high)
            planned = np.clip(planned + np.repeat(changes.reshape(-1, n), MOVE_BLOCKS, axis=0), -1.0, 1.0)
        self._planned[arm] = np.vstack([planned[1:], np.clip(plan.torques[rows[-1]], -1.0, 1.0)])
        self._now[arm] += 1
        return planned[0]

    def _interpolate(self, plan: _Plan, state: Array) -> _Horizon:
        """The horizon of the place on its way that an arm has come to."""
        come = row_dots(state[self.model.motor_columns] - plan.start, plan.displacement) / max(
            row_dots(plan.displacement, plan.displacement), MIN_SQUARED_LENGTH
        )
        place = float(np.clip(come, 0.0, 1.0)) * (LINEARISATION_POSTURES - 1)
        lower = min(int(place), LINEARISATION_POSTURES - 2)
        part = place - lower
        return _Horizon(*(each[lower] + part * (each[lower + 1] - each[lower]) for each in plan.horizons))

    def _residuals(self, horizon: _Horizon, states: Array, outputs: Array) -> Array:
        """What is to be small, see `_Horizon`, for departures of states (N, 2 d) and outputs (N, OUTPUTS)."""
        weights, motors = self._weights, states[:-1, self.model.motor_columns]
        near = outputs[:-1, TIP] / weights.tip, outputs[:-1, TIP_VELOCITY] / weights.tip_speed, motors / weights.motor
        return np.concatenate([np.hstack(near).ravel(), row_dots(horizon.terminal, states[-1])])


def _solve_quadratic_program(daqp: ModuleType, curvature: Array, slope: Array, low: Array, high: Array) -> Array:
    """Gives the changes (m,) from low to high of least cost, zero where the solver finds none."""
    changes, _, status, _ = daqp.solve(curvature, slope, np.zeros((0, len(slope))), high, low)
    return np.array(changes) if status > 0 else np.clip(np.zeros(len(slope)), low, high)


def _import_solver() -> ModuleType:
    """Gives the package that solves the quadratic programs.

    Raises:
        ImportError: without it; it names the extra.
    """
    try:
        import daqp
    except ImportError:
        raise ImportError("the MPC needs daqp: pip install 'flexman_gym[mpc]'", name="daqp") from None
    result: ModuleType = daqp
    return result

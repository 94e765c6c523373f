"""Model predictive control within the torque limits, with nonlinear predictions by the simulator."""

from collections.abc import Collection, Sequence
from typing import Any, NamedTuple

import numpy as np

from flexman_gym.agent.base_controllers import ControllerEntry
from flexman_gym.agent.controller import EpisodeInfo, Plant, Readings
from flexman_gym.agent.pd import torque_limits
from flexman_gym.common.arrays import Array, BoolArray, IntArray, Vector, pad_rows, row_dots
from flexman_gym.common.checks import one_of
from flexman_gym.common.computer import optional_module
from flexman_gym.common.errors import value_error
from flexman_gym.kernels.layout import TIP, TIP_VELOCITY
from flexman_gym.model.model import Model, check_model
from flexman_gym.model.state_space import discretize
from flexman_gym.model.statics import holding_torques, rest_state
from flexman_gym.simulation.batch import Batch
from flexman_gym.simulation.linearization import linearize
from flexman_gym.simulation.methods import DEFAULT_METHOD, Method
from flexman_gym.toolbox.controllers.arm_scales import ArmScales
from flexman_gym.toolbox.controllers.cost_weights import CostWeights
from flexman_gym.toolbox.controllers.friction_compensation import FrictionCompensation
from flexman_gym.toolbox.controllers.references.planned_slews import JACOBIAN_TIME, PlannedLQR, make_planned
from flexman_gym.toolbox.controllers.references.trajectories import plan_slew

# Tip deviation (fraction of the reach) and tip speed / reach (1/s) that cost 1: tuned as 0.05 m and 0.5 m/s for an arm
# with a reach of 8.5 m; a quarter and half of the values of the LQR.
TIP_SCALE, TIP_SPEED_SCALE = 0.05 / 8.5, 0.5 / 8.5
REFERENCE_TORQUE = 1.3  # fraction of the torque limits for which the reference slew is planned
MAX_CHANGE = 0.05  # fraction of the torque limits; largest change of planned torques, within the linear range
LINEARISATION_TIME = 20  # time units; the prediction is linearised at the state after this time
LINEARISATION_POSTURES = 5  # number of postures along a slew about which the prediction is linearised
MIN_SQUARED_LENGTH = 1e-12  # rad^2; avoids division by zero for a slew of zero length
STEP_FACTORS = (1.0, 0.3, 0.1)  # of the changes of a plan; the first that decreases the predicted cost is applied
SLEWS = ("minimum-jerk", "planned")  # references
MOVE_BLOCKS = (1, 2, 3, 4, 5, 5, 5, 6, 7, 7, 8, 10)  # time units over which each torque change is constant


class _Horizon(NamedTuple):
    """Linear prediction over N control periods, with respect to m = blocks x n changes of planned torques.

    Torque changes are fractions of the limits. The p outputs in the cost, after each period but the last, are those of
    `CostWeights.outputs`; the state after the last period has the terminal cost of the infinite-horizon LQR.

    Attributes:
        jacobian: (m, (N - 1) p + 2 d) transposed Jacobian of the outputs with respect to the changes.
        curvature: (m, m) Hessian of the cost.
        terminal: (2 d, 2 d) square root of the terminal cost matrix.
    """

    jacobian: Array
    curvature: Array
    terminal: Array


def _design_horizon(
    model: Model, posture: Array, limits: Array, weights: CostWeights, period: float, blocks: Sequence[int]
) -> _Horizon:
    """Return the prediction about a posture (n,) rad of the motors; the lengths of the blocks, in periods, sum to N."""
    linear = linearize(model, state=rest_state(model, posture), torque=holding_torques(model, posture))
    transition, inputs = discretize(linear.A, linear.B, period)
    inputs, d, n = inputs * limits, model.n_dof, len(limits)
    outputs = weights.outputs(linear, model.motor_columns)
    squares, axes = np.linalg.eigh(weights.terminal(transition, inputs, outputs, limits))
    terminal = np.sqrt(np.maximum(squares, 0.0))[:, None] * axes.T
    state, rows = np.zeros((2 * d, n * len(blocks))), []
    for block in np.repeat(np.arange(len(blocks)), blocks):
        state = transition @ state
        state[:, n * block : n * (block + 1)] += inputs
        rows.append(outputs @ state)
    jacobian = np.vstack([*rows[:-1], terminal @ state]).T.copy()
    return _Horizon(jacobian, jacobian @ jacobian.T + np.diag(np.repeat(np.array(blocks, dtype=float), n)), terminal)


class _Plan(NamedTuple):
    """Reference of an arm: a slew followed by N periods of rest, and the linear predictions along it.

    Attributes:
        horizons: (g, ...) linear predictions at postures along the path.
        start: (n,) initial motor angles, rad.
        displacement: (n,) motor angles of the goal minus those of the start, rad.
        states: (T, 2 d) reference states.
        outputs: (T, OUTPUTS) outputs of the model at these states.
        torques: (T, n) feed-forward torques, fractions of the limits.
    """

    horizons: _Horizon
    start: Array
    displacement: Array
    states: Array
    outputs: Array
    torques: Array


class _Prediction(NamedTuple):
    """Motion of an arm predicted for planned torques over N periods.

    Attributes:
        horizon: linear prediction at the position along the path of the reference.
        outputs: ((N - 1) p + 2 d,) deviations from the reference in the cost.
        torques: (N, n) deviations of the torques, fractions of the limits.
    """

    horizon: _Horizon
    outputs: Array
    torques: Array

    @property
    def cost(self) -> float:
        """Cost of the predicted motion."""
        return float(self.outputs @ self.outputs + np.square(self.torques).sum())


class MPC:
    """Model predictive control of a slew: torques are planned for N periods, and planned anew before they end.

    Torques are planned once in a time unit of the arm, a control period for the arms of the named environments. The
    simulator predicts the motion of the nonlinear arm under the previous plan. A quadratic program then computes
    changes of the torques, constant over blocks of periods (move blocking), that bring the prediction closest to a
    minimum-jerk slew planned for 1.3 times the torque limits, or to an optimised slew. The effect of the changes is
    linearised, with Jacobians interpolated along the path. Changes that do not decrease the predicted cost are
    shortened, such as those about a posture with a far smaller inertia. For a linear arm within its limits, the result
    equals the finite-horizon LQR. The predictions are those of the arm without friction; friction is compensated, see
    `FrictionCompensation`.

    Args:
        model: model of the arm, with the same generalised coordinates as the controlled arm.
        torque_limit: torque limit of all joints, or of each joint (n,), N m.
        period: control period, s.
        integration: method and step (s) of the prediction.
        scales: scales of the arm; None for those of the model and the torque limits.
        planner: controller whose optimised slews are the references, where one settles; None for minimum-jerk slews.

    Raises:
        ImportError: without daqp (Arnström, Bemporad and Axehill, IEEE Trans. Automatic Control 67, 2022, 4362), the
            solver of the quadratic programs.
        ValueError: for arguments out of range; in `reset` for a moving goal.
    """

    sensors: tuple[str, ...] = ("state",)
    state_fields = ("_planned", "_now")

    def __init__(
        self,
        model: Model,
        torque_limit: float | Vector,
        period: float,
        integration: tuple[str | Method, float | str] = (DEFAULT_METHOD, "auto"),
        scales: ArmScales | None = None,
        planner: PlannedLQR | None = None,
    ) -> None:
        self._planner, self._planning_time = planner, np.zeros(0)
        _solver()  # says at once that the package is missing
        reach = float(check_model(model).constants.length.sum())
        self.model, self.period, self._integration = model, period, integration
        self.limits = np.array(torque_limits("torque_limit", torque_limit, model.n_joints))
        scales = scales or ArmScales.of(model, self.limits)
        self._weights = CostWeights.default(model, scales)._replace(
            tip=TIP_SCALE * reach, tip_speed=TIP_SPEED_SCALE * reach, torque=1.0
        )
        self._bounds = scales.bounds(self.limits, REFERENCE_TORQUE)
        self._unit = scales.unit(period)
        self._blocks = tuple(self._unit * block for block in MOVE_BLOCKS)  # control periods
        self._plans: list[_Plan] = []
        self._planned, self._now = np.zeros((0, sum(self._blocks), model.n_joints)), np.zeros(0, dtype=np.int64)
        plant = Plant(model, tuple(self.limits.tolist()), period, dict, integration=integration)
        self._compensation = FrictionCompensation(plant)
        self._batch: Batch | None = None  # of the predictions, from the first on

    def __getstate__(self) -> dict[str, Any]:
        """Return the attributes without the batch, which cannot be copied and whose state does not last."""
        return {**vars(self), "_batch": None}

    def _make_batch(self, count: int) -> Batch:
        return Batch(self._compensation.model, *self._integration, self.period, arms=count)

    @property
    def estimates(self) -> dict[str, Array]:
        """Declared planning time (b,) of optimised slews, s, for `info`; {} for minimum-jerk slews."""
        return {} if self._planner is None else {"planning_time": self._planning_time}

    def reset(self, arms: IntArray, episode: EpisodeInfo, count: int) -> None:
        """Plan the slews of new episodes and the predictions along them; arguments as in `Controller.reset`."""
        if episode.path is not None:
            raise value_error("episode", "a moving goal", "a fixed goal: the MPC plans slews only")
        for name in ("_planned", "_now", "_planning_time"):
            setattr(self, name, pad_rows(getattr(self, name), count))
        for arm, start, goal in zip(arms.tolist(), episode.start, episode.goal, strict=True):
            plan = self._plan(arm, start, goal)
            self._plans += [plan] * (arm + 1 - len(self._plans))
            self._plans[arm] = plan
            self._planned[arm], self._now[arm] = np.clip(plan.torques[: sum(self._blocks)], -1.0, 1.0), 0

    def _plan(self, arm: int, start: Array, goal: Array) -> _Plan:
        (states, torques), rest = self._slew(arm, start, goal), sum(self._blocks) + 1
        states = np.vstack([states, np.repeat(states[-1:], rest, axis=0)])
        torques = np.vstack([torques, np.repeat(holding_torques(self.model, goal)[None], rest + 1, axis=0)])
        batch = self._make_batch(len(states))
        batch.reset(np.arange(len(states)), states)
        postures = start + np.linspace(0.0, 1.0, LINEARISATION_POSTURES)[:, None] * (goal - start)
        design = self.limits, self._weights, self.period, self._blocks
        horizons = [_design_horizon(self._compensation.model, posture, *design) for posture in postures]
        stacked = _Horizon(*(np.array(parts) for parts in zip(*horizons, strict=True)))
        return _Plan(stacked, start, goal - start, states, batch.outputs, torques / self.limits)

    def _slew(self, arm: int, start: Array, goal: Array) -> tuple[Array, Array]:
        """Return the states (T + 1, 2 d) and torques (T, n), N m, of the reference between motor angles (n,) rad."""
        if self._planner is not None:
            motion, jacobians = self._planner.motion(start, goal)
            self._planning_time[arm] = JACOBIAN_TIME * jacobians
            if motion is not None:
                return motion
        slew = plan_slew(self.model, start, goal, self._bounds, self.period)
        return slew.states, slew.torques

    def act(self, readings: Readings, applied: Array, active: BoolArray) -> Array:
        """Return the actions (b, n) for the states; 0 for inactive arms."""
        states = np.asarray(readings["state"], dtype=np.float64)
        arms, actions = np.flatnonzero(active), np.zeros((len(states), len(self.limits)))
        due = arms[self._now[arms] % self._unit == 0].tolist()
        self._improve(np.where(active[:, None], states, 0.0), due)
        actions[arms] = self._planned[arms, 0]
        for arm in arms.tolist():
            last = self._plans[arm].torques[self._rows(arm)[-1]]
            self._planned[arm] = np.vstack([self._planned[arm, 1:], np.clip(last, -1.0, 1.0)])
        self._now[arms] += 1
        friction = self._compensation(actions[arms] * self.limits, states[arms], arms, len(states))
        actions[arms] = np.clip(actions[arms] + friction / self.limits, -1.0, 1.0)
        return actions

    def _improve(self, states: Array, arms: Collection[int]) -> None:
        """Change the plans of arms with states (b, 2 d) where this decreases the predicted cost."""
        before, changes = self._predict(states, self._planned, arms), np.zeros_like(self._planned)
        for arm, prediction in before.items():
            changes[arm] = self._changes(self._planned[arm], prediction)
        left = [*before]
        for factor in STEP_FACTORS:
            tried = np.clip(self._planned + factor * changes, -1.0, 1.0)
            after = self._predict(states, tried, left)
            better = [arm for arm in after if after[arm].cost < before[arm].cost]
            self._planned[better] = tried[better]
            left = [arm for arm in left if arm not in better]

    def _predict(self, states: Array, planned: Array, arms: Collection[int]) -> dict[int, _Prediction]:
        """Return arm -> prediction from states (b, 2 d) under planned torques (b, N, n), if it does not diverge."""
        if not arms:
            return {}
        if self._batch is None or len(self._batch.rows) != len(states):
            self._batch = self._make_batch(len(states))
        self._batch.reset(np.arange(len(states)), states)
        drives = np.zeros((*planned.shape[:2], self.model.n_joints + 6))  # torques, tip force, base acceleration
        drives[..., : len(self.limits)] = planned * self.limits
        motions, outputs = self._batch.roll(drives)
        result = {}
        for arm in (arm for arm in arms if np.isfinite(motions[arm]).all()):
            plan, rows = self._plans[arm], self._rows(arm)
            horizon = self._interpolate(plan, motions[arm, self._unit * LINEARISATION_TIME])
            deviations = motions[arm] - plan.states[rows[1:]], outputs[arm] - plan.outputs[rows[1:]]
            torques = planned[arm] - plan.torques[rows[:-1]]
            result[arm] = _Prediction(horizon, self._residuals(horizon, *deviations), torques)
        return result

    def _rows(self, arm: int) -> IntArray:
        """Return the rows (N + 1,) of the reference of an arm from now on."""
        rows: IntArray = np.minimum(self._now[arm] + np.arange(sum(self._blocks) + 1), len(self._plans[arm].states) - 1)
        return rows

    def _changes(self, planned: Array, prediction: _Prediction) -> Array:
        """Return the changes (N, n) of planned torques (N, n), fractions of the limits, with the least linear cost."""
        firsts = np.cumsum((0, *self._blocks[:-1]))
        mean = (np.add.reduceat(planned, firsts) / np.array(self._blocks)[:, None]).ravel()
        gradient = row_dots(prediction.horizon.jacobian, prediction.outputs)
        gradient += np.add.reduceat(prediction.torques, firsts).ravel()
        low, high = np.maximum(-1.0 - mean, -MAX_CHANGE), np.minimum(1.0 - mean, MAX_CHANGE)
        changes = _solve_quadratic_program(prediction.horizon.curvature, gradient, low, high)
        return np.repeat(changes.reshape(-1, planned.shape[1]), self._blocks, axis=0)

    def _interpolate(self, plan: _Plan, state: Array) -> _Horizon:
        """Return the linear prediction at the position along the path of an arm with a state (2 d,)."""
        progress = row_dots(state[self.model.motor_columns] - plan.start, plan.displacement) / max(
            row_dots(plan.displacement, plan.displacement), MIN_SQUARED_LENGTH
        )
        position = float(np.clip(progress, 0.0, 1.0)) * (LINEARISATION_POSTURES - 1)
        lower = min(int(position), LINEARISATION_POSTURES - 2)
        part = position - lower
        return _Horizon(*(each[lower] + part * (each[lower + 1] - each[lower]) for each in plan.horizons))

    def _residuals(self, horizon: _Horizon, states: Array, outputs: Array) -> Array:
        """Return the outputs in the cost for deviations (N, 2 d) and (N, OUTPUTS) of states and outputs."""
        weights, motors = self._weights, self.model.motor_columns
        running = [
            outputs[:-1, TIP] / weights.tip,
            outputs[:-1, TIP_VELOCITY] / weights.tip_speed,
            states[:-1, motors] / weights.motor,
        ]
        if np.isfinite(weights.motor_rate).any():
            running.append(states[:-1, self.model.n_dof + motors] / np.array(weights.motor_rate))
        return np.concatenate([np.hstack(running).ravel(), row_dots(horizon.terminal, states[-1])])


def _solver() -> Any:
    """Return the module daqp, which the controller does not keep: objects with modules cannot be copied."""
    return optional_module("daqp", "the MPC", "mpc")


def _solve_quadratic_program(curvature: Array, gradient: Array, low: Array, high: Array) -> Array:
    """Return x (m,) between low and high with least x H x / 2 + g x, curvature H (m, m), gradient g; 0 on failure."""
    changes, _, status, _ = _solver().solve(curvature, gradient, np.zeros((0, len(gradient))), high, low)
    return np.array(changes) if status > 0 else np.clip(np.zeros(len(gradient)), low, high)


def _make(plant: Plant, slew: object = SLEWS[0]) -> MPC:
    planner = make_planned(plant) if one_of("base.slew", slew, SLEWS) == "planned" else None
    return MPC(plant.model, plant.torque_limit, plant.period, plant.integration, ArmScales.of_plant(plant), planner)


ENTRY = ControllerEntry(
    _make,
    ("model", "true state"),
    ("slew",),
    "model predictive control within the torque limits",
)

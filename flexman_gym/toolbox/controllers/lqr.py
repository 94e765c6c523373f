"""Linear-quadratic regulators about the goal and along a slew."""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from flexman_gym.agent.base_controllers import ControllerEntry
from flexman_gym.agent.controller import NO_MOTOR, EpisodeInfo, Plant, Readings, saturated
from flexman_gym.agent.pd import torque_limits
from flexman_gym.common.arrays import Array, BoolArray, IntArray, Vector, pad_rows, row_dots
from flexman_gym.common.checks import one_of, positive
from flexman_gym.common.errors import value_error
from flexman_gym.model.model import Model, check_model
from flexman_gym.model.statics import holding_torques, rest_state
from flexman_gym.toolbox.controllers.arm_scales import ArmScales
from flexman_gym.toolbox.controllers.cost_weights import CostWeights, parse_weights, posture_gain
from flexman_gym.toolbox.controllers.friction_compensation import FrictionCompensation
from flexman_gym.toolbox.controllers.references.trajectories import TIME_OPTIMAL, TIMING_NAMES, plan_path, plan_slew

HOLDING_FACTOR = 0.25  # dimensionless; factor of the tip deviation of unit cost for an arm that starts at its goal
FEEDFORWARD_FRACTION = 0.95  # fraction of the torque limits available to the feed-forward
SLEW_POSTURES = 3  # number of postures along a slew at which gains are designed
PATH_POSTURES = 25  # number of postures along a given path at which gains are designed


class GainSchedule(NamedTuple):
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
        weights: cost weights; None for `CostWeights.expensive`.
        scales: scales of the arm; None for those of the model and the torque limits.

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
        self,
        model: Model,
        torque_limit: float | Vector,
        period: float,
        weights: CostWeights | None = None,
        scales: ArmScales | None = None,
    ) -> None:
        n, d, passive = check_model(model).n_joints, model.n_dof, model.constants.passive > 0
        if passive.all():
            raise value_error("LQR.model: arm.joints", "passive joints", "an arm with a motor")
        self.model = self.gravity_model = model
        self.period = positive("period", period, "s")
        if passive.any():
            torque_limit = np.where(passive, NO_MOTOR, torque_limit)
        self.limits = np.array(torque_limits("torque_limit", torque_limit, n))
        self.scales = scales or ArmScales.of(model, self.limits)
        self.weights = weights or self._default_weights()
        self._gains, self._rest, self._holding_torques = np.zeros((0, n, 2 * d)), np.zeros((0, 2 * d)), np.zeros((0, n))
        self._compensation = FrictionCompensation(Plant(model, tuple(self.limits.tolist()), period, dict))

    def _default_weights(self) -> CostWeights:
        return CostWeights.expensive(self.model, self.scales)

    def gain(self, posture: Array, weights: CostWeights | None = None) -> Array:
        """Return the gain K (n, 2 d) at motor angles (n,) rad; weights None for the weights of the regulator."""
        return posture_gain(self._compensation.model, posture, weights or self.weights, self.limits, self.period)

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
        """Return the tables of `GainSchedule` for the present move of a single arm, by name.

        Raises:
            ValueError: for a model with friction, whose compensation needs a simulation in every control period.
        """
        self._compensation.check_none("lqr")
        return self._schedule()._asdict()

    def _schedule(self) -> GainSchedule:
        return GainSchedule(self._rest[:1], self._holding_torques[:1], self._gains[:1], np.zeros(1))

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
        weights: cost weights; None for `CostWeights.default`.
        timing: timing of the slew, see `plan_slew`: "time-optimal", "quintic", "trapezoid" or "double-s".
        scales: see `LQR`.
    """

    state_fields = ("_now",)
    c_program = LQR.c_program

    def __init__(
        self,
        model: Model,
        torque_limit: float | Vector,
        period: float,
        weights: CostWeights | None = None,
        timing: str = TIME_OPTIMAL,
        scales: ArmScales | None = None,
    ) -> None:
        super().__init__(model, torque_limit, period, weights, scales)
        self.timing = one_of("timing", timing, TIMING_NAMES)
        bounds = self.scales.bounds(self.limits, FEEDFORWARD_FRACTION)
        self._bounds = bounds.time_optimal(model) if timing == TIME_OPTIMAL else bounds
        self._schedules: list[GainSchedule] = []
        self._now = np.zeros(0, dtype=np.int64)

    def _default_weights(self) -> CostWeights:
        return CostWeights.default(self.model, self.scales)

    def reset(self, arms: IntArray, episode: EpisodeInfo, count: int) -> None:
        """Plan the slews of new episodes, or motions along moving goals; arguments as in `Controller.reset`."""
        if episode.reference is not None:
            self._plan_paths(arms, episode.reference)
            return
        motors = self.model.driven_columns
        for arm, first, last in zip(arms, episode.start, episode.goal, strict=True):
            if np.array_equal(first, last):
                self._start(int(arm), self._holding_schedule(last))
                continue
            slew = plan_slew(self.model, first, last, self._bounds, self.period, self.timing)
            gains = np.array(
                [self.gain(first + progress * (last - first)) for progress in np.linspace(0.0, 1.0, SLEW_POSTURES)]
            )
            moved = slew.states[:, motors] - slew.states[0, motors]
            progress = row_dots(moved, moved[-1]) / max(moved[-1] @ moved[-1], 1e-12)
            torques = np.vstack([slew.torques, holding_torques(self.model, last)])
            positions = (SLEW_POSTURES - 1) * np.clip(progress, 0.0, 1.0)
            self._start(int(arm), GainSchedule(slew.states, torques, gains, positions))

    def _holding_schedule(self, posture: Array) -> GainSchedule:
        """Return the schedule of an arm that holds a posture (n,) rad, with a larger cost of the tip deviation."""
        tight = self.weights._replace(tip=HOLDING_FACTOR * self.weights.tip)
        holding = holding_torques(self.model, posture)[None]
        return GainSchedule(
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
            self._start(int(arm), GainSchedule(slew.states, torques, gains, positions))

    def _start(self, arm: int, schedule: GainSchedule) -> None:
        """Start the schedule of an arm."""
        empty = GainSchedule(*(np.zeros(0),) * 4)
        self._schedules += [empty] * (arm + 1 - len(self._schedules))
        self._now = pad_rows(self._now, arm + 1)
        self._schedules[arm], self._now[arm] = schedule, 0

    def skip(self, active: BoolArray) -> None:
        """Advance the references of the active arms by a control period without readings, see `Controller`."""
        self._now[active] += 1

    def _schedule(self) -> GainSchedule:
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


def _maker(regulator: type[LQR]) -> Callable[..., LQR]:
    def make(plant: Plant, weights: object = None, design: object = None, **options: Any) -> LQR:
        scales = ArmScales.of_plant(plant, design)
        chosen = parse_weights(weights, scales)
        return regulator(plant.model, plant.torque_scales, plant.period, chosen, scales=scales, **options)

    return make


LQR_ENTRY = ControllerEntry(
    _maker(LQR),
    ("model", "true state"),
    ("weights", "design"),
    "a linear-quadratic regulator about the goal",
    passive="some",
)
TRACKING_ENTRY = ControllerEntry(
    _maker(TrackingLQR),
    ("model", "true state"),
    ("weights", "design", "timing"),
    "a linear-quadratic regulator that tracks a smooth slew, or a path",
    passive="some",
)

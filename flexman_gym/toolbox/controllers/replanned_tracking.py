"""Slews optimised while the arm moves: shooting from the predicted state, planned anew with each estimate."""

from functools import partial

import numpy as np

from flexman_gym.agent.controller import EpisodeInfo, Plant
from flexman_gym.common.arrays import Array, BoolArray, IntArray, pad_rows, row_dots
from flexman_gym.metrics.signals import BAND
from flexman_gym.model.friction import frictionless
from flexman_gym.model.model import Model
from flexman_gym.model.statics import holding_torques, rest_state
from flexman_gym.simulation.batch import Batch
from flexman_gym.toolbox.controllers.arm_scales import NAMED_SLEW, ArmScales
from flexman_gym.toolbox.controllers.cost_weights import CostWeights
from flexman_gym.toolbox.controllers.friction_compensation import estimated_friction
from flexman_gym.toolbox.controllers.lqr import LQR
from flexman_gym.toolbox.controllers.observers.observer import Estimate
from flexman_gym.toolbox.controllers.references.adaptive_references import estimated_model
from flexman_gym.toolbox.controllers.references.planned_slews import JACOBIAN_TIME, PLANNED, TRACKED
from flexman_gym.toolbox.controllers.references.single_shooting import (
    SingleShooting,
    SlewTorques,
    interpolate_torques,
    simulate_torques,
)
from flexman_gym.toolbox.controllers.tracking import Tracking

# Time of the computer, which does not scale with the arm: an arm whose slews are shorter keeps those of `Tracking`
PLANNING_TIME = 0.3  # s; declared computing time of a plan, during which the arm moves on
ESTIMATION_TIME = 20  # time units from the start to the first plan; earlier estimates mislead: settling is 6 % slower
LONGEST_PLAN = 3.0  # longest time from the start to the end of a plan / duration of a slew; limits cost and memory
LEAST_REST = 0.1  # shortest time to the arrival for which a plan is made / duration of a slew
TORQUE_FRACTION = 0.95  # fraction of the torque limits of a plan; the remainder is reserved for feedback
SLEW_FACTOR = 0.77  # first trial duration / remaining duration of the slew of `Tracking`
LATER_FACTOR = 1.06  # next trial duration after a plan that failed, relative to the last
SHORTER_FACTOR = 0.96  # next trial duration after a success within the same planning time, relative to the last


class ReplannedTracking(Tracking):
    """Tracking law whose slews are optimised while the arm moves.

    The arm starts with the slew of `Tracking`. From a first time on, once per planning time, single shooting begins at
    the state predicted for the end of this time with the estimated parameters, from the torques that remain, see
    `SingleShooting`. The number of Jacobians follows from the declared planning time, so that results do not depend on
    the computer. When the planning time is over, the arm tracks the simulated states and torques of the plan. If no
    plan settles, it tracks the reference that it has.

    Args:
        plant: plant model with its uncertain parameters.
        weights: see `Tracking`.
        scales: see `Tracking`.
        thinking: planning time, s.
        known: True to plan from the start on; False to wait for an estimate of unknown parameters.

    Attributes:
        status: (b,) PLANNED or TRACKED.
        arrivals: (b,) planned time since the start from which the tip stays within the band, s; infinite without plan.
        jacobians: (b,) number of Jacobians of all plans.
    """

    state_fields = (
        *Tracking.state_fields, "status", "jacobians", "_states", "_torques", "_first", "_arrival", "_end", "_failures",
    )  # fmt: skip

    def __init__(
        self,
        plant: Plant,
        weights: CostWeights | None = None,
        scales: ArmScales | None = None,
        thinking: float = PLANNING_TIME,
        known: bool = False,
    ) -> None:
        self._scales = scales or ArmScales.of_plant(plant)
        self._cost = weights or CostWeights.default(plant.model, self._scales)
        super().__init__(plant, self._cost, scales=self._scales)
        self._plant, model = plant, plant.model
        self._budget, self._ahead = max(1, round(thinking / JACOBIAN_TIME)), max(1, round(thinking / plant.period))
        self._begin = 1 if known else ESTIMATION_TIME * self.unit
        slew = self._scales.slew / plant.period
        self._rows, self._least = round(LONGEST_PLAN * slew), round(LEAST_REST * slew)
        self._band = BAND * float(model.constants.length.sum())
        integers = np.zeros(0, dtype=np.int64)
        self.status, self.jacobians, self._failures = integers, integers, integers
        # clock periods: start of the plan, its arrival, and its last row; plans are stored by periods of the clock
        self._first, self._arrival, self._end = integers, integers, integers
        self._states = np.zeros((0, self._rows, 2 * model.n_dof))
        self._torques = np.zeros((0, self._rows, model.n_joints))

    @property
    def arrivals(self) -> Array:
        """Planned time since the start (b,) from which the tip stays within the band, s; infinite without a plan."""
        result: Array = np.where(self.status == PLANNED, self._arrival * self._period, np.inf)
        return result

    @property
    def estimates(self) -> dict[str, Array]:
        """Status, planned arrival (s) and declared planning time (s), (b,) each, for `info`."""
        time = JACOBIAN_TIME * self.jacobians
        return {"plan_status": self.status.astype(float), "plan_arrival": self.arrivals, "planning_time": time}

    def reset(self, arms: IntArray, episode: EpisodeInfo, count: int) -> None:
        """Start new episodes, see `Tracking.reset`."""
        super().reset(arms, episode, count)
        for name in ("status", "jacobians", "_failures", "_first", "_arrival", "_end", "_states", "_torques"):
            setattr(self, name, pad_rows(getattr(self, name), count))
        self.jacobians[arms] = 0
        self._forget(arms)

    def restart(self, arms: IntArray) -> None:
        """Plan the slews of arms (r,) anew, see `Tracking.restart`."""
        super().restart(arms)
        self._forget(arms)

    def _forget(self, arms: IntArray) -> None:
        self.status[arms], self._failures[arms], self._first[arms], self._end[arms] = TRACKED, 0, 0, 0

    def plan(self, estimate: Estimate, active: BoolArray) -> None:
        """Plan the references of the active arms (b,), once per control period; called by `torques` if necessary."""
        new = active & ~self._planned
        super().plan(estimate, active)
        due = new & ~self._holding & ~self._on_path & (self._ages >= self._begin)
        due &= (self._ages - self._begin) % self._ahead == 0
        for arm in np.flatnonzero(due).tolist():
            self._optimise(arm, estimate)

    def _optimise(self, arm: int, estimate: Estimate) -> None:
        """Optimise the slew of an arm from the end of the planning time on."""
        here = np.array([arm])
        begin = self._row(self.clock(estimate, here))[0] + self._ahead
        guess, factor = self._remaining(here, int(begin))
        trial = round(factor * LATER_FACTOR ** self._failures[arm] * guess.arrival)
        if guess.arrival < self._least or begin + trial > self._rows:
            return
        model = frictionless(estimated_model(self.slews.model, estimate.parameters, arm))
        state = self._predict(here, estimate, model)
        friction = estimated_friction(self.slews.model, estimate.parameters, here)[0, 1]
        limits = np.maximum(TORQUE_FRACTION * self.limits - friction, (1.0 - TORQUE_FRACTION) * self.limits)
        goal = self.slews.start[arm] + self.slews.displacement[arm] + self.slews.shift[arm]
        shooting = SingleShooting(
            LQR(model, limits, self._period, self._cost, self._scales), partial(self._batch, model), self._band,
            self._plant.rate_limit, (state, goal), self._budget, self._scales.slew / NAMED_SLEW,
        )  # fmt: skip
        guess = guess._replace(knots=np.clip(guess.knots, -limits, limits))
        found = shooting.improve(guess, max(1, trial), SHORTER_FACTOR)
        self.jacobians[arm] += shooting.jacobians
        self._failures[arm] += 1
        if found is not None and begin + found.periods < self._rows:
            self._adopt(arm, int(begin), (model, state, goal), found)

    def _remaining(self, here: IntArray, begin: int) -> tuple[SlewTorques, float]:
        """Return the torques that remain of the reference of an arm, as a guess, and the factor of its duration."""
        (arm,) = here
        if self.status[arm] == PLANNED:
            rows = slice(begin, max(begin, self._end[arm]))
            return SlewTorques(self._torques[arm, rows], len(self._torques[arm, rows]), self._arrival[arm] - begin), 1.0
        last = self.slews.start_time[arm] + self.slews.duration[arm]
        times = self._period * np.arange(begin, max(begin, np.ceil(last / self._period)))
        torques = super()._reference(times, here.repeat(len(times)))[1]
        return SlewTorques(torques, len(torques), len(torques)), SLEW_FACTOR

    def _predict(self, here: IntArray, estimate: Estimate, model: Model) -> Array:
        """Return the state (2 d,) of an arm at the end of the planning time, under this law, without friction."""
        batch, payload = self._batch(model, 1), self.slews.payloads(estimate.parameters, here)
        batch.reset(np.zeros(1, dtype=np.int64), estimate.states[here])
        now, drive = self.clock(estimate, here), np.zeros((1, len(self.limits) + 6))
        for period in range(self._ahead):
            reference, forward = self._reference(now + period * self._period, here)
            gains = self._gains[0](here, batch.state[:, self._motors], payload)
            command = forward - row_dots(gains, (batch.state - reference)[:, None])
            drive[:, : len(self.limits)] = np.clip(command, -self.limits, self.limits)
            batch.step(drive)
        result: Array = batch.state[0].copy()
        return result

    def _batch(self, model: Model, count: int) -> Batch:
        return Batch(model, *self._plant.integration, self._period, arms=count)

    def _adopt(self, arm: int, begin: int, case: tuple[Model, Array, Array], found: SlewTorques) -> None:
        """Store the plan found for an arm from a period of the clock on; case = (model, first state, goal)."""
        model, state, goal = case
        torques, end = interpolate_torques(found.knots, found.periods), begin + found.periods
        self._states[arm, begin : end + 1] = simulate_torques(self._batch(model, 1), state, torques)
        self._torques[arm, begin:end] = torques
        self._states[arm, end], self._torques[arm, end] = rest_state(model, goal), holding_torques(model, goal)
        if self.status[arm] != PLANNED:
            self._first[arm] = begin
        self.status[arm], self._failures[arm] = PLANNED, 0
        self._arrival[arm], self._end[arm] = begin + found.arrival, end

    def _reference(self, now: Array, arms: IntArray) -> tuple[Array, Array]:
        rows = self._row(now)
        over = (self.status[arms] == PLANNED) & (rows >= self._end[arms])
        states, torques = super()._reference(np.where(over, np.inf, now), arms)
        moving = (self.status[arms] == PLANNED) & (rows >= self._first[arms]) & ~over
        states[moving] = self._states[arms[moving], rows[moving]]
        torques[moving] = self._torques[arms[moving], rows[moving]]
        return states, torques

    def _row(self, now: Array) -> IntArray:
        """Return the periods (r,) of the clock at times (r,), s."""
        result: IntArray = (now / self._period).round().astype(np.int64)
        return result

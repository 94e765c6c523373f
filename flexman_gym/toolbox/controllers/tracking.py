"""Tracking control: feed-forward and scheduled LQR gains along a reference."""

import numpy as np

from flexman_gym.agent.controller import EpisodeInfo, Plant
from flexman_gym.common.arrays import Array, BoolArray, IntArray, pad_rows, row_dots
from flexman_gym.toolbox.controllers.arm_scales import ArmScales
from flexman_gym.toolbox.controllers.cost_weights import CostWeights
from flexman_gym.toolbox.controllers.friction_compensation import FrictionCompensation
from flexman_gym.toolbox.controllers.gain_table import GainDesigns, make_gains, spread
from flexman_gym.toolbox.controllers.lqr import FEEDFORWARD_FRACTION, HOLDING_FACTOR, PATH_POSTURES, SLEW_POSTURES
from flexman_gym.toolbox.controllers.observers.observer import Estimate
from flexman_gym.toolbox.controllers.reference_shaping import ReferenceShaping
from flexman_gym.toolbox.controllers.references.adaptive_references import PathReferences, SlewReferences
from flexman_gym.toolbox.controllers.references.trajectories import TIME_OPTIMAL

RETIMING_TIMES = (6, 12, 20, 30, 45)  # time units since the start of an episode at which timing is replanned
LAST_RETIMING = 0.75  # path parameter beyond which the timing is not replanned
ADAPTATION_INTERVAL = 5  # time units between two adaptations of references to the estimates
END_INTERVAL = 25  # time units between two computations of the static equilibrium at the end of a path


class Tracking:
    """Tracking law of b arms: torque = feed-forward - K (state - reference).

    The gains are scheduled by posture and payload. Slews are straight lines in motor space within 95 %
    of the torque limits. While parameter estimates converge, the timing of the remaining path is replanned from
    the current reference. An arm that starts at its goal is held with a larger cost of the tip deviation. Gains and
    feed-forward are those of the arm without friction; friction is compensated, see `FrictionCompensation`.

    Args:
        plant: plant model with its uncertain parameters.
        weights: cost weights; None for `CostWeights.default`.
        retimed: True to replan the timing of slews with new parameter estimates.
        scales: scales of the arm; None for those of the plant.
        timing: timing of the slews, see `SlewReferences`.

    Attributes:
        slews: references of the arms.
        unit: control periods in a time unit of adaptation, see `ArmScales.unit`.
        shaping: reference shaping by an agent; None for no reference shaping.
    """

    state_fields: tuple[str, ...] = ("slews", "_paths", "_ages", "_holding", "_goal", "_planned", "shaping")

    def __init__(
        self,
        plant: Plant,
        weights: CostWeights | None = None,
        retimed: bool = True,
        scales: ArmScales | None = None,
        timing: str = TIME_OPTIMAL,
    ) -> None:
        model, scales = plant.model, scales or ArmScales.of_plant(plant)
        self.unit = scales.unit(plant.period)
        self._retimed = self.unit * np.array(RETIMING_TIMES if retimed else (), dtype=np.int64)
        weights = weights or CostWeights.default(model, scales)
        low, high = plant.unknown.get("payload_mass", (model.constants.payload_mass[0],) * 2)
        payloads = (low, 0.5 * (low + high), high) if high > low else (low,)
        self.limits, self._period = plant.torque_scales, plant.period
        self._paths = PathReferences(model, plant.period, payloads)
        bounds = scales.bounds(self.limits, FEEDFORWARD_FRACTION)
        bounds = bounds.time_optimal(model) if timing == TIME_OPTIMAL else bounds
        self.slews = SlewReferences(model, bounds, payloads, scales.slew, not scales.named, timing)
        tight = weights._replace(tip=HOLDING_FACTOR * weights.tip)
        nodes = payloads if scales.named else spread(payloads)
        self._gains = [
            make_gains(GainDesigns(model, self.limits, plant.period, each, nodes), self._route)
            for each in (weights, tight)
        ]
        self._motors, self._driven = model.motor_columns, 1 - model.constants.passive
        self._compensation = FrictionCompensation(plant)
        self.shaping: ReferenceShaping | None = None
        self._planned = np.zeros(0, dtype=bool)  # flags of arms with a plan of this control period
        self._ages, self._holding = np.zeros(0, dtype=np.int64), np.zeros(0, dtype=bool)
        self._goal, self._on_path = np.zeros((0, model.n_joints)), np.zeros(0, dtype=bool)

    def reset(self, arms: IntArray, episode: EpisodeInfo, count: int) -> None:
        """Start new episodes, whose references are planned at the first state estimate; see `Controller.reset`."""
        for name in ("_ages", "_holding", "_goal", "_on_path", "_planned"):
            setattr(self, name, pad_rows(getattr(self, name), count))
        self.slews.allocate(count)
        self._planned[arms] = False
        self._ages[arms], self._goal[arms], self._on_path[arms] = 0, episode.goal, episode.reference is not None
        self._holding[arms] = (episode.start == episode.goal).all(axis=1) & (episode.reference is None)
        if episode.reference is not None:
            for arm, path in zip(arms.tolist(), episode.reference, strict=True):
                self._paths.begin(arm, path)
        for table in self._gains:
            table.save()

    def holding_gain(self, posture: Array) -> Array:
        """Return the gain K (n, 2 d) of an arm that holds motor angles (n,) rad with the nominal payload.

        Raises:
            ValueError: for a model with friction, whose compensation needs a simulation in every control period.
        """
        self._compensation.check_none("lqg")
        payload = self.slews.payloads({}, np.zeros(1, dtype=np.int64))
        return self._gains[1].at(posture, payload)

    def _route(self, arm: int) -> Array:
        """Return the motor angles (g, n) rad at which gains along the path of an arm are designed."""
        if self._on_path[arm]:
            return self._paths.route(arm, PATH_POSTURES)
        parts = np.linspace(0.0, 1.0, SLEW_POSTURES)[:, None]
        return self.slews.start[arm] + parts * self.slews.displacement[arm]

    def restart(self, arms: IntArray) -> None:
        """Plan the slews of arms (r,) anew, from rest at their next state estimate; paths continue."""
        arms = arms[~self._on_path[arms]]
        self._ages[arms], self._planned[arms] = 0, False
        if self.shaping:
            self.shaping.reset(arms, len(self._ages))

    def torques(self, estimate: Estimate, active: BoolArray) -> Array:
        """Return the torques (b, n) within the limits, N m, and advance by a control period; 0 for inactive arms."""
        arms, result = np.flatnonzero(active), np.zeros((len(active), len(self.limits)))
        if not len(arms):
            return result
        self.plan(estimate, active)
        if self.shaping:
            self.shaping.update_time_scaling(arms)
        now = self.clock(estimate, arms)
        states, (reference, forward) = estimate.states[arms], self._reference(now, arms)
        payloads = self.slews.payloads(estimate.parameters, arms)
        gains = np.zeros((len(arms), len(self.limits), states.shape[1]))
        for table, chosen in zip(self._gains, (~self._holding[arms], self._holding[arms]), strict=True):
            if chosen.any():
                gains[chosen] = table(arms[chosen], states[chosen][:, self._motors], payloads[chosen])
        command = forward - row_dots(gains, (states - reference)[:, None])
        if self.shaping:
            command += self.shaping.advance(arms, self.slews.at(now, arms)[0])
        command += self._compensation(command, states, arms, len(active), estimate.parameters)
        result[arms] = np.clip(command, -self.limits, self.limits)
        self._ages += active
        self._planned[arms] = False
        return result

    def clock(self, estimate: Estimate, arms: IntArray) -> Array:
        """Return the times (r,), s, of the slew clocks of arms (r,) when torques commanded now take effect."""
        now = (self._ages[arms] + estimate.lead[arms]).astype(float) * self._period
        return now + self.shaping.clock_offset[arms] if self.shaping else now

    def plan(self, estimate: Estimate, active: BoolArray) -> None:
        """Plan the references of the active arms (b,), once per control period; called by `torques` if necessary."""
        due = active & ~self._planned
        if due.any():
            arms = np.flatnonzero(due)
            self._plan(arms, estimate)
            self._planned |= due

    def reference(self, estimate: Estimate, arms: IntArray) -> Array:
        """Return the reference states (r, 2 d) of arms (r,) at the time at which torques commanded now take effect."""
        return self._reference(self.clock(estimate, arms), arms)[0]

    def _reference(self, now: Array, arms: IntArray) -> tuple[Array, Array]:
        """Return reference states (r, 2 d) at times (r,) s, and torques (r, n) of the following period."""
        moving = self._on_path[arms]
        if moving.all():
            return self._paths.at(now, arms)
        middle = now + 0.5 * self._period * self.slews.time_scaling[arms]
        states, torques = self.slews.motion(now, middle, arms)
        if self.shaping:
            states += self.shaping.offset_states(arms)
        if moving.any():
            states[moving], torques[moving] = self._paths.at(now[moving], arms[moving])
        return states, torques

    def _plan(self, arms: IntArray, estimate: Estimate) -> None:
        """Plan the references of arms (r,) at the start of an episode, later adapt them at fixed intervals."""
        due, on_path = self._ages[arms] % (self.unit * ADAPTATION_INTERVAL) == 0, self._on_path[arms]
        self._paths.adapt(arms[on_path & due], estimate.parameters)
        arms, due = arms[~on_path], due[~on_path] & (self._ages[arms[~on_path]] > 0)
        first = arms[self._ages[arms] == 0]
        if len(first):
            start = np.where(self._holding[first, None], self._goal[first], estimate.states[first][:, self._motors])
            self.slews.begin(first, self._driven * start, self._driven * self._goal[first])
            self.slews.adapt(first, estimate.parameters)
            self.slews.end_in_equilibrium(first, estimate.parameters)
            self.slews.plan_timing(first, self.clock(estimate, first), first=True)
        retimed = arms[(self._ages[arms, None] == self._retimed).any(axis=1)] if estimate.parameters else arms[:0]
        self.slews.adapt(np.union1d(arms[due], retimed), estimate.parameters)
        ended = due & (self._ages[arms] % (self.unit * END_INTERVAL) == 0)
        self.slews.end_in_equilibrium(arms[ended], estimate.parameters)
        if len(retimed):
            retimed = retimed[self.slews.at(self.clock(estimate, retimed), retimed)[0] < LAST_RETIMING]
            self.slews.plan_timing(retimed, self.clock(estimate, retimed), first=False)

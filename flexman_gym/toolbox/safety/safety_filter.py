"""Safety filter: the smallest change of the torques of an agent after which the arm can be stopped within its limits.

In every control period the motion is predicted for the torques of the agent in this period, followed by a brake until
the arm is at rest, see `braking`. The torques pass unchanged if all limits are kept. Otherwise a quadratic program
finds the closest torques for which they are kept, and a second prediction confirms them. If there are none, a quadratic
program about the torques of the brake finds some between these and the torques of the agent; if there are none either,
the brake acts. A stop that was found in one period is still possible in the next one: the argument of predictive safety
filters (Wabersich and Zeilinger, Automatica 129, 2021, 109597) and of backup controllers.
"""

from collections.abc import Iterator, Mapping
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from flexman_gym.agent.action_modes import ActionMode
from flexman_gym.agent.controller import Controller, EpisodeInfo, Plant, Readings
from flexman_gym.agent.mode_wrapper import ModeWrapper
from flexman_gym.common.arrays import Array, BoolArray, IntArray, pad_rows
from flexman_gym.common.checks import non_negative
from flexman_gym.common.computer import optional_module
from flexman_gym.common.errors import value_error
from flexman_gym.kernels.layout import ARMS_PER_GROUP, LARGEST_STATE, OUTPUTS
from flexman_gym.model.statics import holding_torques
from flexman_gym.toolbox.controllers.observers.uncertain_states import StateSource, find_state_source
from flexman_gym.toolbox.safety.braking import BRAKE, DECAY, NEAR_PERIODS, STAGES, BrakePrediction, PredictedLimits

PULSE = 0.05  # fraction of the torque limits; pulse of a finite difference
RESPONSE_PERIODS = 5  # control periods for which the response to a pulse is used again
SKIPPED_PERIODS = 10, 2  # largest number of control periods without a prediction, of a known and an estimated arm
RENEWAL_PERIODS = 25  # control periods after which the effects of torques are computed again
GROWTH = 1.5  # factor on the effects of torques, for changes of the posture and models other than the most probable one
ARMS = 64  # largest number of arms predicted at once
TRIALS = 3  # quadratic programs about the torques of the agent until the prediction confirms a change
FRACTIONS = (1.0, 0.5, 0.25)  # of the way from the brake to the torques of the quadratic program about it
REMAINDER = 0.985  # fraction of the limits, larger after a start beyond it; the rest is for errors of the prediction
TOLERANCE = 0.002  # fraction of the limits; accepted by the confirmation
STATUS = ("passed", "changed", "stopped")
PASSED, CHANGED, STOPPED = range(len(STATUS))


class _Cases(NamedTuple):
    """Situations of r arms with k models each, the most probable one first.

    Attributes:
        states: (r, k, 2 d) present states.
        past: (r, D, n) torques commanded in the last periods, the latest first, N m.
        delays: (r, k) delays of the torques, control periods.
        hold: (r, n) torques that hold the weight, N m.
        parameters: name -> (r, k, ...) physical parameters.
        deviations: as in `UncertainStates`.
        slow: (r,) True for a brake that takes back the torques slowly, False for one that drops them.
    """

    states: Array
    past: Array
    delays: IntArray
    hold: Array
    parameters: Mapping[str, Array]
    deviations: int
    slow: BoolArray

    def of(self, arms: IntArray | BoolArray, models: IntArray | slice = slice(None)) -> "_Cases":
        """Return the situations of some arms with some of their models."""
        parameters = {name: each[arms][:, models] for name, each in self.parameters.items()}
        states, delays = self.states[arms][:, models], self.delays[arms][:, models]
        past, hold, slow = self.past[arms], self.hold[arms], self.slow[arms]
        return _Cases(states, past, delays, hold, parameters, self.deviations, slow)


class SafetyFilter:
    """Safety filter of b arms with n joints, see the module.

    The predictions cover the models that a `StateSource` leaves possible: the deviations of the quantities between
    these models are subtracted from the limits. A period has no prediction if the torques of the agent since the last
    one, instead of the brake that it contains, cannot lead beyond the limits: the effects of torques on the quantities
    add up, and are at most GROWTH times the responses to pulses.

    Args:
        plant: plant model.
        limits: quantities with limits.
        source: source of the uncertain states.

    Attributes:
        change: (b, n) change of the torques in the last period, as fractions of the torque limits.
        status: (b,) PASSED, CHANGED or STOPPED in the last period, indices of STATUS.

    Raises:
        ImportError: without daqp (Arnström, Bemporad and Axehill, IEEE Trans. Automatic Control 67, 2022, 4362).
        ValueError: for an arm without PD gains, from which the brake follows, and for drives with a lag.
    """

    _arrays = (
        "_past", "change", "status", "_ages", "_check_ages", "_skipped", "_levels", "_hold", "_decaying", "_room",
        "_backup", "_effects", "_continuations", "_responses", "_response_ages", "_response_slow", "_slow",
    )  # fmt: skip
    state_fields = (*_arrays, "source")

    def __init__(self, plant: Plant, limits: PredictedLimits, source: StateSource) -> None:
        self._daqp, self._plant = optional_module("daqp", "the safety filter", "mpc"), plant
        if plant.bandwidth is not None:
            raise value_error("safety", True, "False with drive_bandwidth: the predicted drives have no lag")
        self._limits, self.source = limits, source
        n, late = plant.model.n_joints, plant.delay[1]
        self.torque_limits = np.array(plant.torque_limit)
        damping = [non_negative(f"gains.damping[{i}]", each) for i, each in enumerate(plant.gains()["damping"])]
        self._damping = BRAKE * np.array(damping)
        self._predictions: dict[int, BrakePrediction] = {}  # by the number of groups of arms
        self._past, self.change = np.zeros((0, late, n)), np.zeros((0, n))
        self._hold = np.zeros((0, n))  # torques that hold the weight in the last stop predicted within the limits, N m
        self._slow, self._response_slow = np.zeros(0, dtype=bool), np.zeros(0, dtype=bool)
        self._decaying = np.zeros((0, n))  # torques of the brake in this period beside its damper and the weight, N m
        self.status, self._ages, self._response_ages = (np.zeros(0, dtype=np.int64) for _ in range(3))
        self._check_ages, self._skipped = np.zeros(0, dtype=np.int64), np.zeros(0, dtype=np.int64)
        nothing = np.zeros((1, 1, 2 * plant.model.n_dof)), np.zeros((1, 1, OUTPUTS)), np.zeros((1, n))
        m, self._near = limits.shares(*nothing).shape[2], 1 + late + NEAR_PERIODS
        self._levels = np.zeros((0, m))  # allowed fractions of the limits
        # fractions of the limits that are left at the end of this and the next near periods, and at all later times
        self._room = np.zeros((0, self._near + 1, m))
        self._backup = np.zeros((0, self._near, n))  # torques of the predicted brake, fractions of the torque limits
        self._effects = np.zeros((0, self._near + 1, m, n))  # of torques in this period; largest magnitudes
        self._continuations = np.zeros((0, self._near, n, n))  # derivatives of the brake with respect to these torques
        self._responses = np.zeros((0, self._near + sum(count for _, count in STAGES), m, n))

    @property
    def sensors(self) -> tuple[str, ...]:
        """Names of the sensors that the filter reads."""
        return self.source.sensors

    def reset(self, arms: IntArray, episode: EpisodeInfo, count: int) -> None:
        """Start new episodes; arguments as in `Controller.reset`."""
        for name in self._arrays:
            setattr(self, name, pad_rows(getattr(self, name), count))
        self._past[arms] = self.change[arms] = self._decaying[arms] = 0.0
        self.status[arms] = self._ages[arms] = self._check_ages[arms] = 0
        self._room[arms], self._response_ages[arms] = -1.0, -RENEWAL_PERIODS
        self.source.reset(arms, episode, count)

    def __call__(self, actions: Array, readings: Readings, applied: Array, active: BoolArray) -> Array:
        """Return safe torques (b, n) for torques `actions` (b, n), as fractions of the torque limits.

        Args:
            actions: torques of the agent.
            readings: as in `Controller.act`.
            applied: as in `Controller.act`.
            active: as in `Controller.act`.
        """
        self.source.update(readings, applied, active)
        running, result = np.flatnonzero(active), actions.copy()
        if self._past.shape[1]:
            self._past[running, 1:] = self._past[running, :-1]
            self._past[running, 0] = applied[running] * self.torque_limits
        self.status[running], self.change[running] = PASSED, 0.0
        due = running[~self._covered(running, actions[running])]
        if len(due):
            self._check(due, actions[due], result)
        self.change[running] = result[running] - actions[running]
        self._ages[running] += 1
        return result

    def _covered(self, arms: IntArray, actions: Array) -> BoolArray:
        """Return flags (r,) of arms that the last prediction keeps within the limits for actions (r, n), too.

        The room that it left is reduced by the effect of the actions in place of the brake.
        """
        room, backup = self._room[arms], self._backup[arms]
        other = actions - backup[:, 0]
        room[:, :-1] = room[:, 1:]
        room -= (self._effects[arms] @ np.abs(other)[:, None, :, None])[..., 0]
        late = self._ages[arms] - self._check_ages[arms] > self._skipped[arms]
        covered = (room >= 0.0).all(axis=(1, 2)) & ~late
        other[~covered] = 0.0  # the brake remains that of the last prediction
        backup[:, :-1] = backup[:, 1:] + (self._continuations[arms, :-1] @ other[:, None, :, None])[..., 0]
        self._room[arms], self._backup[arms] = room, backup
        self._decaying[arms] *= np.exp(-self._plant.period / DECAY)
        return np.asarray(covered)

    def _cases(self, arms: IntArray) -> _Cases:
        """Return the present situations of arms (r,)."""
        possible = self.source.read(arms)
        states = np.clip(np.nan_to_num(possible.states, nan=LARGEST_STATE), -LARGEST_STATE, LARGEST_STATE)
        hold, past = self._holding_torques(states[:, 0]), self._past[arms]
        self._skipped[arms] = SKIPPED_PERIODS[possible.delays.shape[1] > 1]
        slow = np.zeros(len(arms), dtype=bool)
        return _Cases(states, past, possible.delays, hold, possible.parameters, possible.deviations, slow)

    def _check(self, arms: IntArray, actions: Array, result: Array) -> None:
        """Predict the motion of arms (r,) for their actions (r, n), and overwrite their rows of the result (b, n)."""
        cases, new = self._cases(arms), np.flatnonzero(self._ages[arms] == 0)
        shares, radius, rates = self._predict_models(cases, actions)
        if len(new):
            start = np.abs(self._present(cases.of(new, slice(1)))) + radius[new, 0] + TOLERANCE
            self._levels[arms[new]], self._hold[arms[new]] = np.clip(start, REMAINDER, 1.0), cases.hold[new]
        room = self._allowed(arms, radius)
        left = np.flatnonzero(_excess(shares, room) > 0.0)
        if len(left):
            self._try_slow_brake(arms[left], cases, left, actions[left], (shares, room, rates))
        beyond = _excess(shares, room) > 0.0
        period = np.where(beyond, RESPONSE_PERIODS, RENEWAL_PERIODS)
        late = self._ages[arms] - self._response_ages[arms] >= period
        old = np.flatnonzero(late | (self._response_slow[arms] != cases.slow))
        if len(old):
            self._respond(arms[old], cases.of(old, slice(1)), actions[old], shares[old], rates[old])
        self._check_ages[arms] = self._ages[arms]
        passed = np.flatnonzero(~beyond)
        self._store(
            arms[passed], cases.of(passed), actions[passed], room[passed] - np.abs(shares[passed]), rates[passed]
        )
        rows = np.flatnonzero(beyond)
        if len(rows):
            result[arms[rows]] = self._change(arms[rows], cases.of(rows), actions[rows], (shares[rows], room[rows]))

    def _try_slow_brake(
        self, arms: IntArray, cases: _Cases, left: IntArray, actions: Array, predicted: tuple[Array, Array, Array]
    ) -> None:
        """Choose the slow brake for arms (r,) that are nearer to their limits with it, for actions (r, n).

        Overwrites rows `left` (r,) of the cases, and of the predicted quantities, their limits and the motor rates.
        """
        slow = cases.of(left)._replace(slow=np.ones(len(left), dtype=bool))
        shares, radius, rates = self._predict_models(slow, actions)
        room = self._allowed(arms, radius)
        better = _excess(shares, room) < _excess(predicted[0][left], predicted[1][left])
        cases.slow[left[better]] = True
        for all_arms, some in zip(predicted, (shares, room, rates), strict=True):
            all_arms[left[better]] = some[better]

    def _store(self, arms: IntArray, cases: _Cases, actions: Array, room: Array, rates: Array) -> None:
        """Store the brake after actions (r, n): its motor rates (r, P, n), and the room (r, T, m) that it leaves.

        The slow brake leaves none, as the effects of torques do not add up while its own are at their limits.
        """
        self._room[arms, : self._near] = room[:, : self._near]
        self._room[arms, self._near] = room[:, self._near :].min(axis=1)
        self._room[arms[cases.slow]] = -1.0
        self._hold[arms], self._slow[arms] = cases.hold, cases.slow
        self._decaying[arms] = self._decaying_torques(cases, actions[:, None])[:, 0]
        self._backup[arms] = self._brake(cases.hold[:, None], rates)

    def _decaying_torques(self, cases: _Cases, actions: Array) -> Array:
        """Return the decaying torques (r, k, n), N m, of the brake after actions (r, k, n), zero of the fast brake."""
        steady = cases.hold - self._damping * self._rates(cases)
        return np.asarray(cases.slow[:, None, None] * (actions * self.torque_limits - steady[:, None]))

    def _rates(self, cases: _Cases) -> Array:
        """Return the present motor rates (r, n) of the most probable models, rad/s."""
        model = self._plant.model
        return cases.states[:, 0, model.n_dof :][:, model.motor_columns]

    def _brake(self, torques: Array, rates: Array) -> Array:
        """Return torques (..., n), N m, less the damper at motor rates (..., n), as fractions of the torque limits."""
        return np.asarray(np.clip((torques - self._damping * rates) / self.torque_limits, -1.0, 1.0))

    def _holding_torques(self, states: Array) -> Array:
        """Return the torques (r, n) that hold the weight of the arms at the motor angles of states (r, 2 d), N m."""
        model = self._plant.model
        if not model.constants.gravity.any():
            return np.zeros((len(states), model.n_joints))
        return np.array([holding_torques(model, state[model.motor_columns]) for state in states])

    def _change(self, arms: IntArray, cases: _Cases, actions: Array, predicted: tuple[Array, Array]) -> Array:
        """Return the safe torques (r, n) closest to the torques of the agent, and set the status.

        Args:
            arms: (r,) indices.
            cases: situations of the arms.
            actions: (r, n) torques of the agent.
            predicted: (r, T, m) quantities of the most probable model for these torques, and their allowed magnitudes.
        """
        brake = self._brake(self._hold[arms] + self._decaying[arms], self._rates(cases))
        self.status[arms], self._room[arms] = STOPPED, -1.0
        (shares, room), changed, trial, left = predicted, brake.copy(), actions, np.arange(len(arms))
        for _ in range(TRIALS):
            trial, solved = self._closest(arms[left], actions[left], trial, shares, room)
            left, trial = left[solved], trial[solved]
            if not len(left):
                break
            safe, shares, room = self._confirm(arms[left], cases.of(left), trial)
            changed[left[safe]] = trial[safe]
            left, trial, shares, room = left[~safe], trial[~safe], shares[~safe], room[~safe]
        left = np.flatnonzero(self.status[arms] == STOPPED)
        if len(left):
            changed[left] = self._change_brake(arms[left], cases.of(left), actions[left], brake[left])
        return changed

    def _change_brake(self, arms: IntArray, cases: _Cases, actions: Array, brake: Array) -> Array:
        """Return safe torques (r, n) between those of the brake and of a quadratic program about it, as in `_change`.

        Models differ less after the torques of the brake (r, n) than after those of the agent, which leaves more room.
        """
        cases = cases._replace(slow=self._slow[arms])
        shares, radius, rates = self._predict_models(cases, brake)
        old = np.flatnonzero(self._response_slow[arms] != cases.slow)
        if len(old):
            self._respond(arms[old], cases.of(old, slice(1)), brake[old], shares[old], rates[old])
        room = np.maximum(self._allowed(arms, radius), np.abs(shares))
        trial, solved = self._closest(arms, actions, brake, shares, room)
        changed, left = brake.copy(), np.flatnonzero(solved)
        for fraction in FRACTIONS if len(left) else ():
            some = brake[left] + fraction * (trial[left] - brake[left])
            safe = self._confirm(arms[left], cases.of(left), some)[0]
            changed[left[safe]], left = some[safe], left[~safe]
            if not len(left):
                break
        return changed

    def _confirm(self, arms: IntArray, cases: _Cases, actions: Array) -> tuple[BoolArray, Array, Array]:
        """Predict the motion for changed actions (r, n); those within the limits become the last prediction.

        Returns:
            Flags (r,) of the safe actions, and the quantities (r, T, m) with their allowed magnitudes.
        """
        shares, radius, rates = self._predict_models(cases, actions)
        room = self._allowed(arms, radius)
        safe = np.asarray((np.abs(shares) <= room + TOLERANCE).all(axis=(1, 2)))
        self.status[arms[safe]] = CHANGED
        self._store(arms[safe], cases.of(safe), actions[safe], (room - np.abs(shares))[safe], rates[safe])
        return safe, shares, room

    def _allowed(self, arms: IntArray, radius: Array) -> Array:
        """Return the allowed magnitudes (r, T, m) of the quantities of the most probable models."""
        return np.asarray(self._levels[arms][:, None] - radius)

    def _closest(
        self, arms: IntArray, wanted: Array, actions: Array, shares: Array, room: Array
    ) -> tuple[Array, BoolArray]:
        """Return the torques (r, n) closest to the wanted ones with quantities within the room, by linear responses.

        Args:
            arms: (r,) indices.
            wanted: (r, n) torques of the agent.
            actions: (r, n) torques of the prediction.
            shares: (r, T, m) quantities of the prediction.
            room: (r, T, m) allowed magnitudes of the quantities.

        Returns:
            Torques, and flags (r,) of the arms that have any.
        """
        closest, solved = actions.copy(), np.zeros(len(arms), dtype=bool)
        for i, arm in enumerate(arms.tolist()):
            response = self._responses[arm]
            near = np.abs(shares[i]) + 2.0 * np.abs(response).sum(axis=2) > room[i]
            largest, now = room[i, near], shares[i, near]
            if (largest < 0.0).any():
                continue
            upper = np.concatenate([1.0 - actions[i], largest - now])
            lower = np.concatenate([-1.0 - actions[i], -largest - now])
            rows, unit = np.ascontiguousarray(response[near]), np.eye(len(wanted[i]))
            step, _, flag, _ = self._daqp.solve(unit, actions[i] - wanted[i], rows, upper, lower)
            if flag > 0:
                closest[i], solved[i] = np.clip(actions[i] + np.array(step), -1.0, 1.0), True
        return closest, solved

    def _respond(self, arms: IntArray, cases: _Cases, actions: Array, shares: Array, rates: Array) -> None:
        """Compute the responses to actions (r, n) of the predicted quantities (r, T, m) and motor rates (r, P, n)."""
        n = len(self.torque_limits)
        pulses = np.where(actions > 0.0, -PULSE, PULSE)  # inwards
        several = cases.of(np.arange(len(arms)), np.zeros(n, dtype=np.int64))
        moved, moved_rates = self._predict(several, actions[:, None] + pulses[:, None] * np.eye(n))
        response = np.moveaxis((moved - shares[:, None]) / pulses[:, :, None, None], 1, -1)
        self._responses[arms], self._response_ages[arms] = response, self._ages[arms]
        effects = GROWTH * np.abs(response)
        self._effects[arms, : self._near] = effects[:, : self._near]
        self._effects[arms, self._near] = effects[:, self._near :].max(axis=1)
        damper = np.moveaxis((moved_rates - rates[:, None]) / pulses[:, :, None, None], 1, -1)
        damper *= (self._damping / self.torque_limits)[:, None]
        self._continuations[arms], self._response_slow[arms] = -damper, cases.slow

    def _present(self, cases: _Cases) -> Array:
        """Return the quantities (r, m) of the most probable models in their present states."""
        parts = []
        for some, prediction in self._parts(len(cases.states)):
            named = {name: each[some, 0] for name, each in cases.parameters.items()}
            parts.append(prediction.present(cases.states[some, 0], named))
        return np.concatenate(parts)

    def _predict_models(self, cases: _Cases, actions: Array) -> tuple[Array, Array, Array]:
        """Return quantities (r, T, m) of the most probable models for actions (r, n), and their deviations (r, T, m).

        The third result are the motor rates (r, P, n) of these models, see `BrakePrediction`.
        """
        shares, rates = self._predict(cases, actions[:, None])
        return shares[:, 0], _radius(shares, cases.deviations), rates[:, 0]

    def _predict(self, cases: _Cases, actions: Array) -> tuple[Array, Array]:
        """Return the quantities (r, k, T, m) and motor rates (r, k, P, n) of all models for actions (r, k or 1, n)."""
        r, k = cases.delays.shape
        first = np.broadcast_to(actions * self.torque_limits, (r, k, actions.shape[2]))[:, :, None]
        past = np.broadcast_to(cases.past[:, None], (r, k, *cases.past.shape[1:]))
        hold = np.broadcast_to(cases.hold[:, None], (r, k, cases.hold.shape[1]))
        decaying = np.broadcast_to(self._decaying_torques(cases, actions), hold.shape)
        given = cases.states, np.concatenate([first, past], axis=2), cases.delays, hold, decaying
        flat = [np.ascontiguousarray(each.reshape(r * k, *each.shape[2:])) for each in given]
        named = {name: each.reshape(r * k, *each.shape[2:]) for name, each in cases.parameters.items()}
        parts = []
        for some, prediction in self._parts(r * k):
            states, commands, delays, weight, more = (each[some] for each in flat)
            own = {name: each[some] for name, each in named.items()}
            parts.append(prediction(states, commands, delays, weight, more, own))
        shares, rates = (np.concatenate(each) if len(parts) > 1 else each[0] for each in zip(*parts, strict=True))
        return shares.reshape(r, k, *shares.shape[1:]), rates.reshape(r, k, *rates.shape[1:])

    def _parts(self, count: int) -> Iterator[tuple[slice, BrakePrediction]]:
        """Yield slices of at most ARMS of some arms, and predictions for their number of groups."""
        for start in range(0, count, ARMS):
            groups = -(-min(ARMS, count - start) // ARMS_PER_GROUP)
            if groups not in self._predictions:
                own = self._plant, self._limits, self._damping, groups * ARMS_PER_GROUP
                self._predictions[groups] = BrakePrediction(*own)
            yield slice(start, start + ARMS), self._predictions[groups]


def _excess(shares: Array, room: Array) -> Array:
    """Return the largest excess (r,) of quantities (r, T, m) over their allowed magnitudes."""
    return np.asarray((np.abs(shares) - room).max(axis=(1, 2)))


def _radius(shares: Array, last: int) -> Array:
    """Return the deviations (r, T, m) of quantities (r, k, T, m) of k models from those of the first model.

    The deviations of parameters, the first `last` ones, are conditionally independent and add in the mean square.
    """
    deviations = np.abs(shares[:, 1:] - shares[:, :1])
    parameters, delays = deviations[:, :last], deviations[:, last:]
    return np.asarray(np.sqrt((parameters**2).sum(axis=1)) + (delays.max(axis=1) if delays.shape[1] else 0.0))


class SafeMode(ModeWrapper):
    """Action mode whose torques pass a safety filter.

    Args:
        mode: action mode of the agent, with its base controller.
        filter: safety filter.
    """

    state_fields = ("_mode", "filter")
    withheld = ("derivatives",)  # the filter is not differentiable

    def __init__(self, mode: ActionMode, filter: SafetyFilter) -> None:
        super().__init__(mode)
        self.filter = filter

    @property
    def sensors(self) -> tuple[object, ...]:
        """Names of the sensors that the mode, its base and the filter read."""
        return (*super().sensors, *self.filter.sensors)

    def reset(self, arms: IntArray, episode: EpisodeInfo, count: int) -> None:
        """Start new episodes; arguments as in `Controller.reset`."""
        super().reset(arms, episode, count)
        self.filter.reset(arms, episode, count)

    def act(self, actions: Array, readings: Readings, applied: Array, active: BoolArray) -> Array:
        """Return the safe torques (b, n); arguments as in `ActionMode.act`."""
        return self.filter(super().act(actions, readings, applied, active), readings, applied, active)

    def info(self) -> dict[str, Array | NDArray[np.object_]]:
        """Return "safety_status" (b,), names of STATUS, and "safety_change" (b, n), see `SafetyFilter`."""
        return {
            "safety_status": np.array(STATUS, dtype=object)[self.filter.status],
            "safety_change": self.filter.change.copy(),
        }


def make_safe_mode(mode: ActionMode, plant: Plant, limits: PredictedLimits, base: Controller | None) -> SafeMode:
    """Return an action mode with a safety filter.

    Args:
        mode: action mode of the agent.
        plant: plant model.
        limits: quantities with limits.
        base: base controller of the mode, whose estimator the filter uses; None for no base controller.
    """
    return SafeMode(mode, SafetyFilter(plant, limits, find_state_source(plant, base)))

"""Safety filter: the smallest change of the torques of an agent after which the arm can be stopped within its limits.

In every control period the motion is predicted for the torques of the agent in this period, followed by a stop: the
backup, a damper at each motor. The torques pass unchanged if all limits are kept until the arm is at rest. Otherwise a
quadratic program finds the closest torques for which they are kept, and a second prediction confirms them. If there are
none, the backup acts. A stop that was found in one period is still possible in the next one: the argument of predictive
safety filters (Wabersich and Zeilinger, Automatica 129, 2021, 109597) and of backup controllers.
"""

from collections.abc import Mapping
from typing import Any, NamedTuple, Protocol

import numpy as np

from flexman_gym.common.arrays import Array, BoolArray, IntArray, pad_rows
from flexman_gym.common.checks import non_negative, value_error
from flexman_gym.common.computer import optional_module
from flexman_gym.control.actions import ActionMode
from flexman_gym.control.controller import EpisodeInfo, Plant, Readings
from flexman_gym.control.observers.uncertain_states import StateSource
from flexman_gym.kernels.layout import LARGEST_STATE, OUTPUTS
from flexman_gym.model.statics import holding_torques
from flexman_gym.simulation.batch import Batch

BRAKE = 0.3  # fraction of the damping of the PD tuned for the arm; a stronger brake strains the links
NEAR_PERIODS = 14  # control periods predicted with the brake sampled at the control rate, after the delay
STAGES = ((0.025, 40), (0.1, 30))  # interval (s) and number of intervals of the later motion, with a continuous damper
METHOD, MAX_STEP = "midpoint_corrected_3", 0.007  # of the prediction; longest step (s) in the near periods
ROUNDING = 1e-6  # steps; error of a number of steps
PULSE = 0.05  # fraction of the torque limits; pulse of a finite difference
RESPONSE_PERIODS = 5  # control periods for which the response to a pulse is used again
SKIPPED_PERIODS = 10  # largest number of control periods without a prediction, far from all limits
RENEWAL_PERIODS = 25  # control periods after which the growth of the quantities is computed again
GROWTH, SMALLEST_GROWTH = 1.5, 1e-6  # factor for models other than the most probable one, and least growth in a period
TRIALS = 3  # quadratic programs until the prediction confirms a change
REMAINDER = 0.985  # fraction of the limits, larger after a start beyond it; the rest is for errors of the prediction
TOLERANCE = 0.002  # fraction of the limits; accepted by the confirmation
DIVERGED = 1e3  # magnitude that replaces a prediction that diverged
STATUS = ("passed", "changed", "stopped")
PASSED, CHANGED, STOPPED = range(len(STATUS))


class PredictedLimits(Protocol):
    """Quantities with limits, as functions of predicted states, see `envs.limits.Limits.predicted`."""

    def shares(self, states: Array, outputs: Array, stiffness: Array) -> Array:
        """Return quantities as fractions (k, T, m) of their limits, magnitudes up to 1 within the limits.

        Args:
            states: (k, T, 2 d) states.
            outputs: (k, T, OUTPUTS) outputs of these states, see `kernels.layout`.
            stiffness: (k, n) joint stiffness, N m/rad.
        """
        ...


class _Prediction:
    """Prediction of the motion of k models: torques in one period, then the brake.

    Args:
        plant: plant model.
        limits: quantities with limits.
        damping: (n,) damping of the brake, N m s/rad.
        count: k, number of models.
    """

    def __init__(self, plant: Plant, limits: PredictedLimits, damping: Array, count: int) -> None:
        self._plant, self._limits, self._damping = plant, limits, damping
        self.count, period, arms = count, plant.period, max(2, count)  # a single arm has another kernel
        step = plant.integration[1]
        steps = int(np.ceil(period / (MAX_STEP if isinstance(step, str) else min(MAX_STEP, step)) - ROUNDING))
        self._near = Batch(plant.model, METHOD, period / steps, period, arms=arms)
        self._later = [Batch(plant.model, METHOD, interval, interval, arms=arms) for interval, _ in STAGES]
        self._parameters: Mapping[str, Array] = {}
        self._stiffness = np.repeat(plant.model.constants.joint_stiffness[None], arms, axis=0)
        self.set_parameters({})

    def set_parameters(self, parameters: Mapping[str, Array]) -> None:
        """Set physical parameters, name -> (k, ...), of the models, if they have changed."""
        before = self._parameters
        if before and all(name in before and np.array_equal(before[name], each) for name, each in parameters.items()):
            return
        every, nominal = np.arange(self.count), self._near.nominal["viscous_friction"]
        friction = parameters.get("viscous_friction", np.tile(nominal, (self.count, 1)))
        for batch in (self._near, *self._later):
            own = dict(parameters)
            if batch is not self._near:
                own["viscous_friction"] = friction + self._damping
            if own:
                batch.vary(every, **own)
        self._stiffness[: self.count] = parameters.get("joint_stiffness", self._stiffness[: self.count])
        self._parameters = {**parameters, "viscous_friction": friction}

    def present(self, state: Array) -> Array:
        """Return the quantities (m,) of the first model in a state (2 d,) as fractions of their limits."""
        self._near.reset(np.zeros(1, dtype=np.int64), state[None])
        shares = self._limits.shares(state[None, None], self._near.outputs[:1, None], self._stiffness[:1])
        return np.asarray(shares[0, 0])

    def __call__(self, states: Array, commands: Array, delays: IntArray, hold: Array) -> Array:
        """Return the quantities (r, T, m) of r <= k models as fractions of their limits.

        Args:
            states: (r, 2 d) present states.
            commands: (r, D + 1, n) torques of this period, then those commanded before, the latest first, N m.
            delays: (r,) delays of the torques up to D, control periods.
            hold: (r, n) torques of the brake at rest, N m.
        """
        used, n = len(states), len(self._damping)
        rows = np.minimum(np.arange(len(self._near.rows)), used - 1)
        every, delays, limits = np.arange(len(rows)), delays[rows], np.array(self._plant.torque_limit)
        periods = commands.shape[1] + NEAR_PERIODS
        drives = np.zeros((len(rows), periods, n + 6))
        drives[..., :n] = hold[rows, None]
        for t in range(commands.shape[1]):  # a torque acts after the delay
            known = delays >= t
            drives[known, t, :n] = commands[rows[known], delays[known] - t]
        gains = np.array([np.zeros(n), self._damping, limits, np.zeros(n)])
        timing = np.stack([1 + delays, delays], axis=1)
        self._near.reset(every, states[rows])
        feedback = np.repeat(gains[None], len(rows), axis=0), timing, self._near.rows.copy()
        parts = [self._near.roll(drives, feedback)]
        for batch, (_, count) in zip(self._later, STAGES, strict=True):
            batch.reset(every, np.nan_to_num(parts[-1][0][:, -1], nan=DIVERGED))
            drives = np.zeros((len(rows), count, n + 6))
            drives[..., :n] = hold[rows, None]
            parts.append(batch.roll(drives))
        motion, outputs = (np.concatenate([each[i][:used] for each in parts], axis=1) for i in range(2))
        return np.nan_to_num(self._limits.shares(motion, outputs, self._stiffness[:used]), nan=DIVERGED)


class SafetyFilter:
    """Safety filter of b arms with n joints, see the module.

    The predictions cover the models that a `StateSource` leaves possible: the deviations of the quantities between
    these models are subtracted from the limits. A period without a prediction follows a prediction so far within the
    limits that no torques can exceed them.

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
        "_past", "change", "status", "_ages", "_next", "_growth", "_levels", "_hold", "_responses", "_response_ages",
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
        self._models: _Prediction | None = None
        self._own: _Prediction | None = None  # of the models of one arm
        self._single = _Prediction(plant, limits, self._damping, 1 + n)
        self._past, self.change = np.zeros((0, late, n)), np.zeros((0, n))
        self._hold = np.zeros((0, n))  # torques that hold the weight in the last stop predicted within the limits, N m
        self.status, self._ages, self._next = (np.zeros(0, dtype=np.int64) for _ in range(3))
        self._growth, self._response_ages = np.zeros(0), np.zeros(0, dtype=np.int64)
        nothing = np.zeros((1, 1, 2 * plant.model.n_dof)), np.zeros((1, 1, OUTPUTS)), np.zeros((1, n))
        periods = 1 + late + NEAR_PERIODS + sum(count for _, count in STAGES)
        self._levels = np.zeros((0, limits.shares(*nothing).shape[2]))  # allowed fractions of the limits
        self._responses = np.zeros((0, periods, self._levels.shape[1], n))

    @property
    def sensors(self) -> tuple[str, ...]:
        """Names of the sensors that the filter reads."""
        return self.source.sensors

    def reset(self, arms: IntArray, episode: EpisodeInfo, count: int) -> None:
        """Start new episodes; arguments as in `Controller.reset`."""
        for name in self._arrays:
            setattr(self, name, pad_rows(getattr(self, name), count))
        self._past[arms] = self.change[arms] = self._growth[arms] = 0.0
        self.status[arms] = self._ages[arms] = self._next[arms] = 0
        self._response_ages[arms] = -RENEWAL_PERIODS
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
        due = running[self._ages[running] >= self._next[running]]
        if len(due):
            self._check(due, actions, result)
        self.change[running] = result[running] - actions[running]
        self._ages[running] += 1
        return result

    def _check(self, arms: IntArray, actions: Array, result: Array) -> None:
        """Predict the motion of arms (r,) for actions (b, n), and overwrite their rows of the result (b, n)."""
        possible = self.source.read(arms)
        (r, k), count = possible.delays.shape, len(self.status)
        if self._models is None or self._models.count < count * k:
            self._models = _Prediction(self._plant, self._limits, self._damping, count * k)
        flat = {name: values.reshape(r * k, *values.shape[2:]) for name, values in possible.parameters.items()}
        self._models.set_parameters(
            {name: np.resize(each, (count * k, *each.shape[1:])) for name, each in flat.items()}
        )
        commands = np.concatenate([(actions[arms] * self.torque_limits)[:, None], self._past[arms]], axis=1)
        states = np.clip(np.nan_to_num(possible.states, nan=LARGEST_STATE), -LARGEST_STATE, LARGEST_STATE)
        hold = self._holding_torques(states[:, 0])
        given = states.reshape(r * k, -1), np.repeat(commands, k, axis=0), possible.delays.ravel()
        shares = self._models(*given, np.repeat(hold, k, axis=0))
        for i, arm in enumerate(arms.tolist()):
            own = shares[i * k : (i + 1) * k]
            radius = _radius(own, possible.deviations)
            parameters = {name: each[i] for name, each in possible.parameters.items()}
            case = _Case(states[i], commands[i], possible.delays[i], hold[i], parameters, possible.deviations)
            if self._ages[arm] == 0:
                self._single.set_parameters(case.repeated_parameters(self._single.count))
                start = np.abs(self._single.present(case.states[0])) + radius[0] + TOLERANCE
                self._levels[arm], self._hold[arm] = np.clip(start, REMAINDER, 1.0), hold[i]
            room = self._levels[arm] - radius
            margin = float((room - np.abs(own[0])).min())
            if margin < 0.0:
                result[arm], self.status[arm] = self._change(arm, case, room, own[0])
            elif self._ages[arm] - self._response_ages[arm] >= RENEWAL_PERIODS:
                self._respond(arm, case)
            else:
                free = int(margin / self._growth[arm])
                self._next[arm] = self._ages[arm] + min(1 + free, SKIPPED_PERIODS)
            if self.status[arm] != STOPPED:
                self._hold[arm] = hold[i]

    def _holding_torques(self, states: Array) -> Array:
        """Return the torques (r, n) that hold the weight of the arms at the motor angles of states (r, 2 d), N m."""
        model = self._plant.model
        if not model.constants.gravity.any():
            return np.zeros((len(states), model.n_joints))
        return np.array([holding_torques(model, state[model.motor_columns]) for state in states])

    def _change(self, arm: int, case: "_Case", room: Array, shares: Array) -> tuple[Array, int]:
        """Return the safe torques (n,) closest to the torques of the agent, and the status.

        Args:
            arm: index of the arm.
            case: situation of the arm.
            room: (T, m) allowed magnitudes of the quantities of the most probable model.
            shares: (T, m) quantities of the most probable model for the torques of the agent.
        """
        if self._ages[arm] - self._response_ages[arm] >= RESPONSE_PERIODS:
            self._respond(arm, case)
        action = case.commands[0] / self.torque_limits
        response, changed = self._responses[arm], action
        for _ in range(TRIALS):
            near = np.abs(shares) + 2.0 * np.abs(response).sum(axis=2) > room
            largest, now = room[near], shares[near]
            if (largest < 0.0).any():
                break
            upper = np.concatenate([1.0 - changed, largest - now])
            lower = np.concatenate([-1.0 - changed, -largest - now])
            rows = np.ascontiguousarray(response[near])
            step, _, solved, _ = self._daqp.solve(np.eye(len(action)), changed - action, rows, upper, lower)
            if solved <= 0:
                break
            changed = np.clip(changed + np.array(step), -1.0, 1.0)
            of_models = self._predict_models(case, changed)
            shares, room = of_models[0], self._levels[arm] - _radius(of_models, case.deviations)
            if (np.abs(shares) <= room + TOLERANCE).all():
                return changed, CHANGED
        return self._stop(arm, case.states[0]), STOPPED

    def _stop(self, arm: int, state: Array) -> Array:
        """Return the torques (n,) of the brake of an arm in a state (2 d,), as fractions of their limits."""
        model = self._plant.model
        rates = state[model.n_dof :][model.motor_columns]
        return np.asarray(np.clip((self._hold[arm] - self._damping * rates) / self.torque_limits, -1.0, 1.0))

    def _respond(self, arm: int, case: "_Case") -> None:
        """Compute the response (T, m, n) of the quantities of an arm to its torques of this period."""
        n = len(self.torque_limits)
        action = case.commands[0] / self.torque_limits
        pulses = np.where(action > 0.0, -PULSE, PULSE)  # inwards
        shares = self._predict_one(case, action + np.vstack([np.zeros(n), np.diag(pulses)]))
        response = np.moveaxis((shares[1:] - shares[:1]) / pulses[:, None, None], 0, -1)
        self._responses[arm], self._response_ages[arm] = response, self._ages[arm]
        self._growth[arm] = max(GROWTH * 2.0 * np.abs(response).sum(axis=2).max(), SMALLEST_GROWTH)

    def _predict_one(self, case: "_Case", actions: Array) -> Array:
        """Return the quantities (a, T, m) of the most probable model of an arm for actions (a, n)."""
        a = len(actions)
        self._single.set_parameters(case.repeated_parameters(self._single.count))
        commands = np.repeat(case.commands[None], a, axis=0)
        commands[:, 0] = actions * self.torque_limits
        given = np.repeat(case.states[:1], a, axis=0), commands, np.repeat(case.delays[:1], a)
        return self._single(*given, np.repeat(case.hold[None], a, axis=0))

    def _predict_models(self, case: "_Case", action: Array) -> Array:
        """Return the quantities (k, T, m) of all models of an arm for an action (n,)."""
        k = len(case.states)
        if self._own is None or self._own.count != k:
            self._own = _Prediction(self._plant, self._limits, self._damping, k)
        self._own.set_parameters(case.parameters)
        commands = np.repeat(np.concatenate([[action * self.torque_limits], case.commands[1:]])[None], k, axis=0)
        return self._own(case.states, commands, case.delays, np.repeat(case.hold[None], k, axis=0))


class _Case(NamedTuple):
    """Situation of an arm with k models, the most probable one first.

    Attributes:
        states: (k, 2 d) present states.
        commands: (D + 1, n) torques of the agent in this period, then those commanded before, N m.
        delays: (k,) delays of the torques, control periods.
        hold: (n,) torques that hold the weight, N m.
        parameters: name -> (k, ...) physical parameters.
        deviations: as in `UncertainStates`.
    """

    states: Array
    commands: Array
    delays: IntArray
    hold: Array
    parameters: Mapping[str, Array]
    deviations: int

    def repeated_parameters(self, count: int) -> dict[str, Array]:
        """Return the parameters of the most probable model, repeated: name -> (count, ...)."""
        return {name: np.repeat(each[:1], count, axis=0) for name, each in self.parameters.items()}


def _radius(shares: Array, last: int) -> Array:
    """Return the deviations (T, m) of quantities (k, T, m) of k models from those of the first model.

    The deviations of parameters, the first `last` ones, are conditionally independent and add in the mean square.
    """
    deviations = np.abs(shares[1:] - shares[0])
    parameters, delays = deviations[:last], deviations[last:]
    return np.asarray(np.sqrt((parameters**2).sum(axis=0)) + (delays.max(axis=0) if len(delays) else 0.0))


class SafeMode:
    """Action mode whose torques pass a safety filter.

    Args:
        mode: action mode of the agent, with its base controller.
        filter: safety filter.
    """

    state_fields = ("_mode", "filter")

    def __init__(self, mode: ActionMode, filter: SafetyFilter) -> None:
        self._mode, self.filter = mode, filter
        self.joints, self.names, self.sensors = mode.joints, mode.names, (*mode.sensors, *filter.sensors)

    def __getattr__(self, name: str) -> Any:
        if name in ("observe", "observation_sizes", "strength"):  # optional members of action modes but derivatives
            return getattr(self.__dict__["_mode"], name)
        raise AttributeError(f"{type(self).__name__} has no attribute {name}")

    def reset(self, arms: IntArray, episode: EpisodeInfo, count: int) -> None:
        """Start new episodes; arguments as in `Controller.reset`."""
        self._mode.reset(arms, episode, count)
        self.filter.reset(arms, episode, count)

    def act(self, actions: Array, readings: Readings, applied: Array, active: BoolArray) -> Array:
        """Return the safe torques (b, n); arguments as in `ActionMode.act`."""
        return self.filter(self._mode.act(actions, readings, applied, active), readings, applied, active)

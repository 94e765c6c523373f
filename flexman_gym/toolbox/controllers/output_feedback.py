"""Output feedback: an observer with the law of `lqr-tracking`, and its entries as base controllers."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from flexman_gym.agent.base_controllers import ControllerEntry
from flexman_gym.agent.controller import Controller, EpisodeInfo, Plant, Readings
from flexman_gym.agent.pd import PD, make_pd
from flexman_gym.common.arrays import Array, BoolArray, IntArray, pad_rows
from flexman_gym.common.checks import flag, positive
from flexman_gym.common.errors import value_error
from flexman_gym.model.statics import rest_state
from flexman_gym.toolbox.controllers.arm_scales import NAMED_SLEW, ArmScales
from flexman_gym.toolbox.controllers.cost_weights import CostWeights, parse_weights
from flexman_gym.toolbox.controllers.observers.estimator import Estimator
from flexman_gym.toolbox.controllers.observers.kalman_filter import KalmanFilter
from flexman_gym.toolbox.controllers.observers.observer import Estimate, Observer
from flexman_gym.toolbox.controllers.observers.oracle import Oracle
from flexman_gym.toolbox.controllers.references.trajectories import TIME_OPTIMAL
from flexman_gym.toolbox.controllers.replanned_tracking import PLANNING_TIME, ReplannedTracking
from flexman_gym.toolbox.controllers.tracking import Tracking

POSTURE_STEP = 1e-4  # rad; central difference of the equilibrium state with respect to motor angles
RETURN_TIME = 1.0  # s; time for which a model must explain the readings before a fallback controller ends


class OutputFeedback:
    """Output feedback: an observer estimates the state, and a tracking law computes torques from it.

    If no model of the observer explains the readings of an arm, a fallback controller acts until the estimated model
    has explained them for RETURN_TIME. The slew is then planned anew from where the arm is.

    Args:
        observer: observer of states and parameters. Its optional members `inconsistent` and `consistent`, (b,) flags,
            mark arms whose readings no model of the observer explains, and arms whose readings its estimated model
            explains; without the latter a fallback controller acts until the end of the episode.
        law: tracking law.
        fallback: controller without a model, such as a PD; None for no fallback.
    """

    state_fields = ("observer", "law", "fallback", "_fallback_active", "_consistent_periods", "_updated", "_latest")

    def __init__(self, observer: Observer, law: Tracking, fallback: Controller | None = None) -> None:
        self.observer, self.law, self.fallback = observer, law, fallback
        self.sensors = (*observer.sensors, *(fallback.sensors if fallback else ()))
        self._fallback_active, self._updated = np.zeros(0, dtype=bool), np.zeros(0, dtype=bool)
        self._consistent_periods, self._return_periods = np.zeros(0, dtype=np.int64), 0
        self._latest: dict[str, Any] = {}  # estimate of the arms updated in this control period

    @property
    def estimates(self) -> Mapping[str, Array]:
        """Estimates of the observer and of the law, name -> (b, ...)."""
        return {**getattr(self.observer, "estimates", {}), **getattr(self.law, "estimates", {})}

    def reset(self, arms: IntArray, episode: EpisodeInfo, count: int) -> None:
        """Start new episodes; arguments as in `Controller.reset`."""
        self.observer.reset(arms, episode, count)
        self.law.reset(arms, episode, count)
        if self.fallback:
            self.fallback.reset(arms, episode, count)
        for name in ("_fallback_active", "_consistent_periods", "_updated"):
            setattr(self, name, pad_rows(getattr(self, name), count))
            getattr(self, name)[arms] = False
        self._return_periods = round(RETURN_TIME / episode.period)

    def update_estimate(self, readings: Readings, applied: Array, active: BoolArray) -> Estimate:
        """Return the estimate for the active arms (b,); the observer is updated once per control period."""
        due = active & ~self._updated
        if self._latest and not due.any():
            return Estimate(**self._latest)
        estimate = self.observer.estimate(readings, applied, due)
        self._fallback_active |= _inconsistent(self.observer)
        self._end_fallback(due)
        if self._updated.any():
            states = np.where(due[:, None], estimate.states, self._latest["states"])
            estimate = estimate._replace(states=states)
        self._latest, self._updated = estimate._asdict(), self._updated | due
        return estimate

    def _end_fallback(self, due: BoolArray) -> None:
        """Return to the tracking law the arms (b,) whose readings have been explained long enough."""
        if not self._fallback_active.any() or not hasattr(self.observer, "consistent"):
            return
        explained = self._fallback_active & self.observer.consistent
        self._consistent_periods = np.where(explained, self._consistent_periods + due, 0)
        returned = np.flatnonzero(due & (self._consistent_periods >= self._return_periods))
        self._fallback_active[returned], self._consistent_periods[returned] = False, 0
        self.law.restart(returned)

    def linear_form(self) -> Controller:
        """Return the linear output feedback about a goal; the controller itself for observers without a linear form."""
        linear = type(self.observer) is KalmanFilter
        return LinearOutputFeedback(self.observer, self.law) if linear else self  # type: ignore[arg-type]

    def prepare(self, applied: Array, active: BoolArray) -> None:
        """Let the observer compute what does not depend on the next readings; see `Controller`."""
        if hasattr(self.observer, "prepare"):
            self.observer.prepare(applied, active & ~self._updated)

    def act(self, readings: Readings, applied: Array, active: BoolArray) -> Array:
        """Return the actions (b, n), fractions of the torque limits."""
        estimate = self.update_estimate(readings, applied, active)
        self._updated &= ~active
        torques = self.law.torques(estimate, active & ~self._fallback_active) - estimate.disturbance
        result = np.clip(torques / self.law.limits, -1.0, 1.0)
        if self.fallback and self._fallback_active.any():
            fallback = np.asarray(self.fallback.act(readings, applied, active), dtype=float)
            result = np.where(self._fallback_active[:, None], fallback, result)
        if not self._updated.any():
            self._latest = {}
        return result


def _inconsistent(observer: Observer) -> BoolArray | bool:
    """Return the flags (b,) `inconsistent` of an observer; False for an observer without this attribute."""
    result: BoolArray | bool = getattr(observer, "inconsistent", False)
    return result


class LinearOutputFeedback:
    """Linear output feedback about the goal of one arm: Kalman filter and LQR with fixed gains.

    Args:
        observer: Kalman filter from which the linear filter is computed.
        law: tracking law whose gain at the goal is used.
    """

    c_program = "flexman_gym.toolbox.deployment.c_programs:lqg_program"

    def __init__(self, observer: KalmanFilter, law: Tracking) -> None:
        self._observer, self._law = observer, law
        self.sensors: tuple[str, ...] = tuple(observer.sensors)
        self.gravity_model = law.slews.model
        self.posture = "motor_angles" if "motor_angles" in observer.quantities else "joint_angles"
        self._tables: dict[str, Array] = {}
        self._deviation: Array | None = None  # (2 d,) estimated deviation from the equilibrium; None before a reading

    def reset(self, arms: IntArray, episode: EpisodeInfo, count: int) -> None:
        """Linearise about the goal; arguments as in `Controller.reset`."""
        if len(episode.goal) != 1 or episode.reference is not None:
            raise value_error("lqg", "several arms, or a moving goal", "one arm with a fixed goal")
        goal, model = episode.goal[0], self.gravity_model
        steps = POSTURE_STEP * np.eye(len(goal))
        rows = (rest_state(model, goal + steps) - rest_state(model, goal - steps)) / (2.0 * POSTURE_STEP)
        gain = {"K": self._law.holding_gain(goal), "from_angles": rows.T, "goal": goal}
        self._tables, self._deviation = self._observer.linear(goal) | gain, None

    def move_tables(self) -> dict[str, Array]:
        """Return the matrices of the present goal by name, see `KalmanFilter.linear`."""
        return self._tables

    def act(self, readings: Readings, applied: Array, active: BoolArray) -> Array:
        """Return the action (1, n); arguments as in `Controller.act`."""
        t, limits = self._tables, self._law.limits
        if self._deviation is None:
            self._deviation = t["from_angles"] @ (readings[self.posture][0] - t["goal"])
        else:
            predicted = t["A"] @ self._deviation + t["B"] @ (applied[0] * limits - t["holding"])
            measured = np.concatenate([readings[name][0] for name in self._observer.quantities])
            self._deviation = predicted + t["L"] @ (measured - t["C"] @ (t["rest"] + predicted))
        return np.clip((t["holding"] - t["K"] @ self._deviation) / limits, -1.0, 1.0)[None]


def _lqg(plant: Plant, **options: Any) -> OutputFeedback:
    law = _law(plant, options)
    return OutputFeedback(KalmanFilter(plant, **options), law)


def _adaptive(plant: Plant, unknown: Any = None, **options: Any) -> OutputFeedback:
    plant = plant if unknown is None else plant._replace(unknown=unknown)
    return _with_estimator(plant, _law(plant, options), options)


def _adaptive_planned(plant: Plant, unknown: Any = None, **options: Any) -> OutputFeedback:
    plant = plant if unknown is None else plant._replace(unknown=unknown)
    return _with_estimator(plant, _replanned(plant, options, known=not plant.unknown), options)


def _with_estimator(plant: Plant, law: Tracking, options: dict[str, Any]) -> OutputFeedback:
    return OutputFeedback(Estimator(plant, unit=law.unit, **options), law, _fallback(plant))


def _law(plant: Plant, options: dict[str, Any], retimed: bool = True) -> Tracking:
    """Return the tracking law for options of a base controller, from which those of the law are removed."""
    weights, scales = _weights(plant, options)
    return Tracking(plant, weights, retimed, scales, options.pop("timing", TIME_OPTIMAL))


def _replanned(plant: Plant, options: dict[str, Any], known: bool) -> ReplannedTracking:
    """Return the law that plans in motion for options of a base controller, from which those of the law are removed."""
    time = positive("base.thinking", options.pop("thinking", PLANNING_TIME), "s")
    return ReplannedTracking(plant, *_weights(plant, options), time, known)


def _weights(plant: Plant, options: dict[str, Any]) -> tuple[CostWeights | None, ArmScales]:
    scales = ArmScales.of_plant(plant, options.pop("design", None))
    return parse_weights(options.pop("weights", None), scales), scales


def _fallback(plant: Plant) -> PD | None:
    """Return the PD with gains tuned for the arm and its delay; None for an arm without tuned gains."""
    try:
        return make_pd(plant)
    except ValueError:
        return None


def _privileged(plant: Plant, doubt: object = False, retimed: object = True, **options: Any) -> OutputFeedback:
    slowness = ArmScales.of_plant(plant, options.get("design")).slew / NAMED_SLEW
    law = _law(plant, options, flag("base.retimed", retimed))
    return OutputFeedback(Oracle(plant, flag("base.doubt", doubt), slowness), law)


def _privileged_planned(plant: Plant, **options: Any) -> OutputFeedback:
    return OutputFeedback(Oracle(plant), _replanned(plant, options, known=True))


LQG_ENTRY = ControllerEntry(
    _lqg,
    ("model",),
    ("weights", "design", "timing", "sensors", "noise", "disturbed", "biased", "fixed"),
    "a Kalman filter of the nominal arm with laboratory measurements, and `lqr-tracking`",
    passive="some",
)
ADAPTIVE_ENTRY = ControllerEntry(
    _adaptive,
    ("structure of the model",),
    ("weights", "design", "timing", "sensors", "unknown", "biased"),
    "an output-error estimator with eleven simulated arms, fitted to laboratory measurements, and `lqr-tracking` "
    "for the estimated arm; the PD if no fit explains the measurements",
    passive="some",
)
PRIVILEGED_ENTRY = ControllerEntry(
    _privileged,
    ("model", "true state", "true parameters"),
    ("weights", "design", "timing", "doubt", "retimed"),
    "`lqr-tracking` with true state and true parameters, the benchmark",
    passive="some",
)
ADAPTIVE_PLANNED_ENTRY = ControllerEntry(
    _adaptive_planned,
    ("structure of the model",),
    ("weights", "design", "sensors", "unknown", "biased", "thinking"),
    "`adaptive-lqr` whose slews are optimised while the arm moves, anew with each estimate",
    passive="some",
)
PRIVILEGED_PLANNED_ENTRY = ControllerEntry(
    _privileged_planned,
    ("model", "true state", "true parameters"),
    ("weights", "design", "thinking"),
    "`adaptive-planned` with true state and true parameters, the benchmark",
    passive="some",
)

"""Output feedback by name: an observer with the law of `lqr-tracking`."""

from typing import Any

from flexman_gym.agent.base_controllers import ControllerEntry
from flexman_gym.agent.controller import Plant
from flexman_gym.agent.pd import PD, make_pd
from flexman_gym.common.checks import flag
from flexman_gym.toolbox.controllers.arm_scales import ArmScales
from flexman_gym.toolbox.controllers.cost_weights import parse_weights
from flexman_gym.toolbox.controllers.observers.estimator import Estimator
from flexman_gym.toolbox.controllers.observers.kalman_filter import KalmanFilter
from flexman_gym.toolbox.controllers.observers.oracle import Oracle
from flexman_gym.toolbox.controllers.tracking import OutputFeedback, Tracking


def _lqg(plant: Plant, weights: object = None, design: object = None, **options: Any) -> OutputFeedback:
    return OutputFeedback(KalmanFilter(plant, **options), _law(plant, weights, design))


def _adaptive(
    plant: Plant, weights: object = None, unknown: Any = None, design: object = None, **options: Any
) -> OutputFeedback:
    plant = plant if unknown is None else plant._replace(unknown=unknown)
    law = _law(plant, weights, design)
    return OutputFeedback(Estimator(plant, unit=law.unit, **options), law, _fallback(plant))


def _law(plant: Plant, weights: object, design: object, retimed: bool = True) -> Tracking:
    scales = ArmScales.of_plant(plant, design)
    return Tracking(plant, parse_weights(weights, scales), retimed, scales)


def _fallback(plant: Plant) -> PD | None:
    """Return the PD with gains tuned for the arm and its delay; None for an arm without tuned gains."""
    try:
        return make_pd(plant)
    except ValueError:
        return None


def _privileged(
    plant: Plant, weights: object = None, doubt: object = False, retimed: object = True, design: object = None
) -> OutputFeedback:
    law = _law(plant, weights, design, flag("base.retimed", retimed))
    return OutputFeedback(Oracle(plant, flag("base.doubt", doubt)), law)


LQG_ENTRY = ControllerEntry(
    _lqg,
    ("model",),
    ("weights", "design", "sensors", "noise", "disturbed", "biased", "fixed"),
    "a Kalman filter of the nominal arm with laboratory measurements, and `lqr-tracking`",
)
ADAPTIVE_ENTRY = ControllerEntry(
    _adaptive,
    ("structure of the model",),
    ("weights", "design", "sensors", "unknown", "biased"),
    "an output-error estimator with eleven simulated arms, fitted to laboratory measurements, and `lqr-tracking` "
    "for the estimated arm; the PD if no fit explains the measurements",
)
PRIVILEGED_ENTRY = ControllerEntry(
    _privileged,
    ("model", "true state", "true parameters"),
    ("weights", "design", "doubt", "retimed"),
    "`lqr-tracking` with true state and true parameters, the benchmark",
)

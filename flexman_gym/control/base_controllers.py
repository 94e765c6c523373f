"""Base controllers by name: construction, required information and description."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Protocol

from flexman_gym.common.checks import flag, mapping, one_of, positive, text, value_error
from flexman_gym.common.renamed import BASE_ARGUMENTS, rename_keys
from flexman_gym.control.controller import Controller, Plant
from flexman_gym.control.input_shaping.shaped_controller import InputShapedController
from flexman_gym.control.lqr import LQR, CostWeights, TrackingLQR
from flexman_gym.control.observers.estimator import Estimator
from flexman_gym.control.observers.kalman_filter import KalmanFilter
from flexman_gym.control.observers.oracle import Oracle
from flexman_gym.control.pd import PD
from flexman_gym.control.references.optimised_slews import SHIPPED_TABLE, OptimisedController, SlewTable
from flexman_gym.control.torque_feedback_pd import TorqueFeedbackPD
from flexman_gym.control.tracking import OutputFeedback, Tracking


class _Entry(Protocol):
    """Entry of a table of base controllers or action modes: `arguments` are the names of its arguments."""

    @property
    def arguments(self) -> tuple[str, ...]: ...


def parse_kind(field: str, value: object, table: Mapping[str, _Entry]) -> tuple[str, dict[str, Any]]:
    """Return name and arguments of a base controller or an action mode.

    Args:
        field: name of the field, for error messages.
        value: name, or mapping with the name under "kind" and the arguments.
        table: `BASES` or `ACTIONS`.
    """
    if isinstance(value, str):
        return one_of(field, value, table), {}
    if not isinstance(value, Mapping) or "kind" not in value:
        raise value_error(field, value, "a name, or a mapping with the name under kind and its arguments")
    name = one_of(f"{field}.kind", text(f"{field}.kind", value["kind"]), table)
    given = {text(f"a key of {field}", key): each for key, each in value.items() if key != "kind"}
    return name, mapping(field, rename_keys(given, BASE_ARGUMENTS, field=field), table[name].arguments)


DEFAULT_TUNING = "none: default weights for every arm"  # tuning of controllers designed from a model


@dataclass(frozen=True)
class _BaseEntry:
    """Entry of the table of base controllers.

    Attributes:
        make: function of a Plant and the arguments that returns the controller.
        information: information beyond motor measurements that the controller requires.
        arguments: names of the arguments that a mapping may contain.
        description: noun phrase for the league page.
        tuning: origin of the gains.
    """

    make: Callable[..., Controller]
    information: tuple[str, ...]
    arguments: tuple[str, ...]
    description: str
    tuning: str = DEFAULT_TUNING


def _pd(plant: Plant, **gains: Any) -> PD:
    weight = plant.model if plant.model.constants.gravity.any() else None
    tuned = gains if len(gains) == 2 else {**plant.gains(), **gains}
    return PD(**tuned, torque_limit=plant.torque_limit, gravity_model=weight)


def _shaped_pd(plant: Plant, **given: Any) -> InputShapedController:
    gains = {name: given.pop(name) for name in ("stiffness", "damping") if name in given}
    return InputShapedController(_pd(plant, **gains), plant.model, **given)


def _regulator(regulator: type[LQR]) -> Callable[..., LQR]:
    def make(plant: Plant, weights: object = None, **options: Any) -> LQR:
        chosen = None if weights is None else _weights(weights)
        return regulator(plant.model, plant.torque_limit, plant.period, chosen, **options)

    return make


def _mpc(plant: Plant) -> Controller:
    from flexman_gym.control.mpc import MPC

    return MPC(plant.model, plant.torque_limit, plant.period, plant.integration)


def _optimised(plant: Plant, table: object = None) -> OptimisedController:
    slews = SlewTable.load(SHIPPED_TABLE if table is None else text("base.table", table))
    return OptimisedController(slews, plant.model, plant.torque_limit, plant.period)


def _weights(value: object) -> CostWeights:
    given = mapping("base.weights", value, CostWeights._fields)
    if len(given) < len(CostWeights._fields):
        raise value_error("base.weights", given, "a mapping with tip (m), tip_speed (m/s) and motor (rad)")
    return CostWeights(**{name: positive(f"base.weights.{name}", each) for name, each in given.items()})


def _adaptive(plant: Plant, weights: object = None, unknown: Any = None, **options: Any) -> OutputFeedback:
    plant = plant if unknown is None else plant._replace(unknown=unknown)
    return OutputFeedback(Estimator(plant, **options), _tracking(plant, weights), _safe(plant))


def _safe(plant: Plant) -> PD | None:
    """Return the PD with gains tuned for the arm and its delay; None for an arm without tuned gains."""
    try:
        return _pd(plant)
    except ValueError:
        return None


def _lqg(plant: Plant, weights: object = None, **options: Any) -> OutputFeedback:
    return OutputFeedback(KalmanFilter(plant, **options), _tracking(plant, weights))


def _hinf(plant: Plant, **options: Any) -> Controller:
    from flexman_gym.control.hinf import HInfinity

    return HInfinity(plant, **options)


def _privileged(plant: Plant, weights: object = None, doubt: object = False, retimed: object = True) -> OutputFeedback:
    law = _tracking(plant, weights, flag("base.retimed", retimed))
    return OutputFeedback(Oracle(plant, flag("base.doubt", doubt)), law)


def _tracking(plant: Plant, weights: object, retimed: bool = True) -> Tracking:
    return Tracking(plant, None if weights is None else _weights(weights), retimed)


BASES: dict[str, _BaseEntry] = {
    "pd": _BaseEntry(
        _pd,
        (),
        ("stiffness", "damping"),
        "a PD of the motors, with gains for each arm, task and delay",
        "by `flexman optimise gains`, about half a minute of computing time per environment, on the seeds 0 to 7",
    ),
    "pd-torque": _BaseEntry(
        TorqueFeedbackPD,
        ("data sheets", "payload class"),
        (),
        "a PD of the motors with joint-torque feedback along a minimum-jerk slew, designed from data sheets",
        "by random search of five numbers for all arms, about a minute of computing time for each delay, on the seeds "
        "5100 to 5115 of `FlexRRR-v0`",
    ),
    "lqr": _BaseEntry(
        _regulator(LQR), ("model", "true state"), ("weights",), "a linear-quadratic regulator about the goal"
    ),
    "lqr-tracking": _BaseEntry(
        _regulator(TrackingLQR),
        ("model", "true state"),
        ("weights", "timing_law"),
        "a linear-quadratic regulator that tracks a smooth slew, or a path",
    ),
    "lqg": _BaseEntry(
        _lqg,
        ("model",),
        ("weights", "sensors", "noise", "disturbed", "biased", "fixed"),
        "a Kalman filter of the nominal arm with laboratory measurements, and `lqr-tracking`",
    ),
    "hinf": _BaseEntry(
        _hinf,
        ("model",),
        ("sensors", "loss"),
        "H-infinity output feedback with laboratory measurements, designed for the ranges of the uncertain parameters",
        "weights for every arm, set by hand on the seeds 9000 to 9011 of `FlexRRR-v0` and `FlexRotary-v0`, which are "
        "test seeds",
    ),
    "mpc": _BaseEntry(_mpc, ("model", "true state"), (), "model predictive control within the torque limits"),
    "optimised": _BaseEntry(
        _optimised,
        ("model", "true state", "its episodes"),
        ("table",),
        "a replay of the fastest slew found by optimisation for each episode",
        "by `flexman optimise slews` on the test episodes themselves: a bound, not a competitor",
    ),
    "adaptive-lqr": _BaseEntry(
        _adaptive,
        ("structure of the model",),
        ("weights", "sensors", "unknown", "biased"),
        "an output-error estimator with eleven simulated arms, fitted to laboratory measurements, and `lqr-tracking` "
        "for the estimated arm; the PD if no fit explains the measurements",
    ),
    "privileged-lqr": _BaseEntry(
        _privileged,
        ("model", "true state", "true parameters"),
        ("weights", "doubt", "retimed"),
        "`lqr-tracking` with true state and true parameters, the benchmark",
    ),
    "pd-shaped": _BaseEntry(
        _shaped_pd,
        ("model",),
        ("stiffness", "damping", "shaper", "modes", "places", "duration"),
        "the PD with an input shaper (ZVD) for the lowest mode of the nominal arm",
        "that of the PD",
    ),
}
"""Base controllers: name -> construction, required information, arguments and description."""


def make_base(value: object, plant: Plant) -> Controller:
    """Make a base controller, given by name or mapping, for a plant; see `parse_kind`."""
    name, arguments = parse_kind("base", value, BASES)
    return BASES[name].make(plant, **arguments)

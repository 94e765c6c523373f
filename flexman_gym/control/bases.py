"""Bases: the controllers that have a name, what each needs to know, and how it is made for an arm."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from flexman_gym.checks import flag, mapping, positive, refusal, text
from flexman_gym.control.controller import Controller
from flexman_gym.control.discrete import Weights
from flexman_gym.control.estimator import Estimator
from flexman_gym.control.feedback import OutputFeedback
from flexman_gym.control.kalman import KalmanFilter
from flexman_gym.control.kind import checked_kind
from flexman_gym.control.lqr import LQR, TrackingLQR
from flexman_gym.control.optimised import Optimised
from flexman_gym.control.pd import PD
from flexman_gym.control.plant import Plant
from flexman_gym.control.shaped import Shaped
from flexman_gym.control.slew_table import SHIPPED, SlewTable
from flexman_gym.control.tracking import Tracking
from flexman_gym.control.truth import Truth


@dataclass(frozen=True)
class Base:
    """A controller with a name.

    Attributes:
        make: gives it for a Plant and its arguments.
        knows: what it needs to know beside what motors measure.
        takes: names of the arguments that a mapping may give.
    """

    make: Callable[..., Controller]
    knows: tuple[str, ...]
    takes: tuple[str, ...]


def _pd(plant: Plant, **gains: Any) -> PD:
    weight = plant.model if plant.model.constants.gravity.any() else None
    tuned = gains if len(gains) == 2 else {**plant.gains(), **gains}
    return PD(**tuned, torque_limit=plant.torque_limit, gravity_model=weight)


def _shaped_pd(plant: Plant, **given: Any) -> Shaped:
    gains = {name: given.pop(name) for name in ("stiffness", "damping") if name in given}
    return Shaped(_pd(plant, **gains), plant.model, **given)


def _regulator(law: type[LQR]) -> Callable[..., LQR]:
    def make(plant: Plant, weights: object = None, **options: Any) -> LQR:
        chosen = None if weights is None else _weights(weights)
        return law(plant.model, plant.torque_limit, plant.period, chosen, **options)

    return make


def _mpc(plant: Plant) -> Controller:
    from flexman_gym.control.mpc import MPC

    return MPC(plant.model, plant.torque_limit, plant.period, plant.moved)


def _optimised(plant: Plant, table: object = None) -> Optimised:
    slews = SlewTable.load(SHIPPED if table is None else text("base.table", table))
    return Optimised(slews, plant.model, plant.torque_limit, plant.period)


def _weights(value: object) -> Weights:
    given = mapping("base.weights", value, Weights._fields)
    if len(given) < len(Weights._fields):
        raise refusal("base.weights", given, "a mapping with tip (m), tip_speed (m/s) and motor (rad)")
    return Weights(**{name: positive(f"base.weights.{name}", each) for name, each in given.items()})


def _adaptive(plant: Plant, weights: object = None, unknown: Any = None, **options: Any) -> OutputFeedback:
    plant = plant if unknown is None else plant._replace(unknown=unknown)
    return OutputFeedback(Estimator(plant, **options), _tracking(plant, weights), _safe(plant))


def _safe(plant: Plant) -> PD | None:
    """The PD that was tuned for the arm and its delay, None for an arm for which none was."""
    try:
        return _pd(plant)
    except ValueError:
        return None


def _lqg(plant: Plant, weights: object = None, **options: Any) -> OutputFeedback:
    return OutputFeedback(KalmanFilter(plant, **options), _tracking(plant, weights))


def _privileged(plant: Plant, weights: object = None, doubt: object = False, retimed: object = True) -> OutputFeedback:
    law = _tracking(plant, weights, flag("base.retimed", retimed))
    return OutputFeedback(Truth(plant, flag("base.doubt", doubt)), law)


def _tracking(plant: Plant, weights: object, retimed: bool = True) -> Tracking:
    return Tracking(plant, None if weights is None else _weights(weights), retimed)


BASES: dict[str, Base] = {
    "pd": Base(_pd, (), ("stiffness", "damping")),
    "lqr": Base(_regulator(LQR), ("model", "true state"), ("weights",)),
    "lqr-tracking": Base(_regulator(TrackingLQR), ("model", "true state"), ("weights", "law")),
    "lqg": Base(_lqg, ("model",), ("weights", "sensors", "noise", "disturbed", "biased", "fixed")),
    "mpc": Base(_mpc, ("model", "true state"), ()),
    "optimised": Base(_optimised, ("model", "true state", "its episodes"), ("table",)),
    "adaptive-lqr": Base(_adaptive, ("structure of the model",), ("weights", "sensors", "unknown", "biased")),
    "privileged-lqr": Base(_privileged, ("model", "true state", "true parameters"), ("weights", "doubt", "retimed")),
    "pd-shaped": Base(_shaped_pd, ("model",), ("stiffness", "damping", "shaper", "modes", "places", "duration")),
}
"""Controllers that have a name: name -> how one is made, what it knows, and the arguments that it takes."""


def checked_base(value: object) -> tuple[str, dict[str, Any]]:
    """Gives name and arguments of a base that is a name, or a mapping with one at "kind" and its arguments.

    Raises:
        ValueError: one line with field, value and what is allowed.
    """
    return checked_kind("base", value, {name: base.takes for name, base in BASES.items()})


def make_base(value: object, plant: Plant) -> Controller:
    """Makes a base for a plant; see `checked_base`.

    Raises:
        ValueError: one line with field, value and what is allowed.
    """
    name, arguments = checked_base(value)
    return BASES[name].make(plant, **arguments)

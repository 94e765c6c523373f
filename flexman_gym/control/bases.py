"""Bases: the controllers that have a name, what each needs to know, and how it is made for an arm."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

from flexman_gym.arrays import Array, Vector
from flexman_gym.checks import mapping, one_of, positive, refusal, text
from flexman_gym.control.controller import Controller
from flexman_gym.control.discrete import Weights
from flexman_gym.control.lqr import LQR, TrackingLQR
from flexman_gym.control.pd import PD
from flexman_gym.control.shaped import Shaped
from flexman_gym.model.model import Model
from flexman_gym.simulation.families import Method
from flexman_gym.simulation.methods import DEFAULT

Gains = Mapping[str, Vector]


class Plant(NamedTuple):
    """What a base is made for.

    Attributes:
        model: of the arm, as the base knows it.
        torque_limit: (n,) N m.
        period: of control, s.
        gains: makes "stiffness" (N m/rad) and "damping" (N m s/rad) that were tuned for the arm, (n,) each.
        unknown: name -> (low, high) of the physical parameters that differ from arm to arm, see
            `simulation.parameters.PARAMETERS`; parts of the nominal value where the table there says factor.
        delay: fewest and most whole control periods by which torques come late.
        moved: method and step (s) by which the arm is simulated.
        push: N, how large forces on the tip may be that nobody tells.
        measured: gives, name -> (2, size), the range of each quantity that instruments measure and the standard
            deviation of their noise, in its unit.
    """

    model: Model
    torque_limit: tuple[float, ...]
    period: float
    gains: Callable[[], Gains]
    unknown: Mapping[str, tuple[float, float]] = {}
    delay: tuple[int, int] = (0, 0)
    moved: tuple[str | Method, float | str] = (DEFAULT, "auto")
    push: float = 0.0
    measured: Callable[[], Mapping[str, Array]] = dict


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


def _regulator(kind: type[LQR]) -> Callable[..., LQR]:
    def make(plant: Plant, weights: object = None) -> LQR:
        chosen = None if weights is None else _weights(weights)
        return kind(plant.model, plant.torque_limit, plant.period, chosen)

    return make


def _weights(value: object) -> Weights:
    given = mapping("base.weights", value, Weights._fields)
    if len(given) < len(Weights._fields):
        raise refusal("base.weights", given, "a mapping with tip (m), tip_speed (m/s) and motor (rad)")
    return Weights(**{name: positive(f"base.weights.{name}", each) for name, each in given.items()})


def _adaptive(plant: Plant, weights: object = None, **options: Any) -> Controller:
    from flexman_gym.control.estimator import Estimator
    from flexman_gym.control.feedback import OutputFeedback
    from flexman_gym.control.tracking import Tracking

    observer = Estimator(plant, **options)
    if options.get("unknown") is not None:
        plant = plant._replace(unknown=options["unknown"])
    return OutputFeedback(observer, Tracking(plant, None if weights is None else _weights(weights)))


def _privileged(plant: Plant, weights: object = None) -> Controller:
    from flexman_gym.control.feedback import OutputFeedback
    from flexman_gym.control.tracking import Tracking
    from flexman_gym.control.truth import Truth

    return OutputFeedback(Truth(plant), Tracking(plant, None if weights is None else _weights(weights)))


BASES: dict[str, Base] = {
    "pd": Base(_pd, (), ("stiffness", "damping")),
    "lqr": Base(_regulator(LQR), ("model", "true state"), ("weights",)),
    "lqr-tracking": Base(_regulator(TrackingLQR), ("model", "true state"), ("weights",)),
    "adaptive-lqr": Base(_adaptive, ("structure of the model",), ("weights", "sensors", "unknown", "biased")),
    "privileged-lqr": Base(_privileged, ("model", "true state", "true parameters"), ("weights",)),
    "pd-shaped": Base(_shaped_pd, ("model",), ("stiffness", "damping", "shaper", "modes", "places", "duration")),
}


def checked_base(value: object) -> tuple[str, dict[str, Any]]:
    """Gives name and arguments of a base that is a name, or a mapping with one at "kind" and its arguments.

    Raises:
        ValueError: one line with field, value and what is allowed.
    """
    if isinstance(value, str):
        return one_of("base", value, BASES), {}
    if not isinstance(value, Mapping) or "kind" not in value:
        raise refusal("base", value, "a name, or a mapping with a name at kind and its arguments")
    kind = one_of("base.kind", text("base.kind", value["kind"]), BASES)
    given = {text("a key of base", name): each for name, each in value.items() if name != "kind"}
    return kind, mapping("base", given, BASES[kind].takes)


def make_base(value: object, plant: Plant) -> Controller:
    """Makes a base for a plant; see `checked_base`.

    Raises:
        ValueError: one line with field, value and what is allowed.
    """
    kind, arguments = checked_base(value)
    return BASES[kind].make(plant, **arguments)

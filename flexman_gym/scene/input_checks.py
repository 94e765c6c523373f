"""Checks for common input errors: keywords of URDF and other libraries, and values in a wrong unit."""

import math
import warnings
from collections.abc import Callable, Mapping
from dataclasses import fields, replace
from functools import wraps
from typing import Any, TypeVar

from flexman_gym.common.errors import keyword_error, nearest, warn_caller

T = TypeVar("T")

_REVOLUTE = "nothing: every joint is revolute; for prismatic and other joints use MuJoCo, Drake or Pinocchio"
_SERIAL = "nothing: an arm is a serial chain in the order of its links; for trees and loops use MuJoCo or Drake"
_FIXED = (
    "nothing: the base of an arm is fixed, or has a prescribed motion, fm.Scene(base_acceleration=...); for a free "
    "base use MuJoCo or Drake"
)
_CONTACT = (
    "nothing: contact is not modelled, a force on the tip is set by tip_force; for contact use MuJoCo (flexman "
    "export mujoco) or Drake"
)
_SHAPE = "it to fm.Link.strip, fm.Link.tube or fm.Link.rod, which compute a section from sizes and a material"
_RUN = "it to fm.simulate(scene, method=..., step=...)"
_LIMITS = "fm.Limits(angle=...) to an environment: a joint turns without stops"

# Class -> keyword unknown to it -> advice, which follows the word "give" in the error message.
FOREIGN_KEYWORDS: dict[str, dict[str, str]] = {
    "Joint": {
        **dict.fromkeys(("kind", "type", "joint_type", "prismatic"), _REVOLUTE),
        **dict.fromkeys(("limits", "limit", "range", "lower", "upper"), _LIMITS),
        **dict.fromkeys(("parent", "child"), _SERIAL),
        "friction": "viscous_friction (N m s/rad) or coulomb_friction (N m)",
        "gear_ratio": "motor=fm.Motor(gear_ratio=..., torque_constant=..., rotor_inertia=...)",
        "inertia": "rotor_inertia (kg m^2)",
    },
    "Arm": {
        **dict.fromkeys(("base", "floating_base", "free_base", "fixed_base", "mobile_base"), _FIXED),
        **dict.fromkeys(("parents", "parent", "children", "tree", "branches"), _SERIAL),
        **dict.fromkeys(("contact", "contacts", "collision", "collisions"), _CONTACT),
        "torque_limit": "it to each joint: fm.Joint(axis, torque_limit=...)",
        "damping": "modal_damping_ratio (1) or stiffness_proportional_damping (s)",
    },
    "Scene": {
        **dict.fromkeys(("contact", "contacts", "collision", "collisions", "ground", "floor", "obstacles"), _CONTACT),
        **dict.fromkeys(("base", "floating_base", "free_base"), _FIXED),
        **dict.fromkeys(("method", "step", "dt", "timestep", "rtol", "atol"), _RUN),
        "gravity": "it to the arm: fm.Arm(..., gravity=(0, 0, -9.81))",
        "payload": "it to the arm: fm.Arm(..., payload=fm.Payload(0.5))",
    },
    "Link": dict.fromkeys(("material", "width", "thickness", "diameter", "radius", "wall"), _SHAPE),
}


def check_keywords(cls: type[T]) -> type[T]:
    """Decorate a dataclass so that unknown keywords of its constructor raise a one-line KeywordError with advice.

    The signature of the constructor is preserved.
    """
    construct: Callable[..., None] = cls.__init__
    known = [field.name for field in fields(cls)]  # type: ignore[arg-type]

    @wraps(construct)
    def constructor(self: Any, *values: Any, **named: Any) -> None:
        for name, value in named.items():
            if name not in known:
                allowed = FOREIGN_KEYWORDS.get(cls.__name__, {}).get(name)
                near = nearest(name, known)
                allowed = allowed or (
                    f"{near}, or another field of {cls.__name__}" if near else f"one of {', '.join(known)}"
                )
                raise keyword_error(f"{cls.__name__}.{name}", value, allowed, name)
        construct(self, *values, **named)

    cls.__init__ = constructor  # type: ignore[method-assign]
    return cls


# Field -> smallest and largest usual value with a wide margin, SI unit, units often used by mistake.
USUAL_RANGES: dict[str, tuple[float, float, str, str]] = {
    "Link.length": (1e-3, 100.0, "m", "mm"),
    "Link.youngs_modulus": (1e5, 2e12, "Pa", "GPa or MPa; 69 GPa is 69e9"),
    "Link.shear_modulus": (3e4, 1e12, "Pa", "GPa or MPa; 26 GPa is 26e9"),
    "Link.density": (20.0, 25e3, "kg/m^3", "g/cm^3 or kg/m; 2.7 g/cm^3 is 2700"),
    "Motor.rotor_inertia": (0.0, 1.0, "kg m^2", "g cm^2; 100 g cm^2 is 1e-5"),
    "Motor.torque_constant": (1e-6, 10.0, "N m/A", "mN m/A"),
    "Motor.speed_limit": (0.1, 5e3, "rad/s", "revolutions per minute"),
    "Motor.encoder_resolution": (0.0, 0.8, "rad", "counts per turn; 4096 per turn are 2 pi / 4096"),
    "Joint.backlash": (0.0, 0.1, "rad", "arc minutes; 3 arc minutes are 9e-4"),
    "Joint.rotor_inertia": (0.0, 1e5, "kg m^2", "g cm^2"),
    "Arm.modal_damping_ratio": (0.0, 0.3, "1", "per cent; 0.5 % is 0.005"),
    "Arm.stiffness_proportional_damping": (0.0, 1.0, "s", "ms"),
    "control_period": (0.0, 1.0, "s", "ms"),
    "horizon": (0.0, 300.0, "s", "steps; 500 steps of 0.02 s are 10 s"),
}


def warn_unusual_units(owner: str, values: Mapping[str, Any]) -> None:
    """Warn (UserWarning) of the first value outside its usual range, see USUAL_RANGES.

    Args:
        owner: class with these fields, such as "Link"; "" for keywords of environments.
        values: field name -> value in SI units; values of other types than float are ignored.
    """
    for name, value in values.items():
        field = f"{owner}.{name}".removeprefix(".")
        low, high, unit, hint = USUAL_RANGES.get(field, (-math.inf, math.inf, "", ""))
        if isinstance(value, float) and not low <= value <= high:
            usual = f"at most {high:g}" if value > high else f"at least {low:g}"
            warn_caller(f"{field}: {value:g} ({unit}) is unusual, expected {usual}; wrong unit ({hint})?")
            return


def replace_quietly(part: T, **changes: Any) -> T:
    """Return a part of an arm with changed fields, without the warnings that were issued when the part was made."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)
        return replace(part, **changes)  # type: ignore[type-var]

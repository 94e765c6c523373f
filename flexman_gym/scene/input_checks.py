"""Checks for common input errors: keywords of other libraries, and values in a wrong unit."""

import math
import sys
import warnings
from collections.abc import Callable, Mapping
from dataclasses import fields
from difflib import get_close_matches
from functools import wraps
from typing import Any, TypeVar

from flexman_gym.common.checks import value_error

Part = TypeVar("Part")

_REVOLUTE = "nothing: every joint is revolute; for prismatic and other joints take MuJoCo, Drake or Pinocchio"
_SERIAL = "nothing: an arm is one serial chain, in the order of its links; for trees and loops take MuJoCo or Drake"
_FIXED = (
    "nothing: the base of an arm is fixed, or has a given motion, fm.Scene(base_acceleration=...); for a free base "
    "take MuJoCo or Drake"
)
_CONTACT = (
    "nothing: arms touch nothing, a force on the tip may be given as tip_force; for contact take MuJoCo (flexman "
    "export mujoco) or Drake"
)
_SHAPE = "it to fm.Link.strip, fm.Link.tube or fm.Link.rod, which compute a section from sizes and a material"
_RUN = "it to fm.simulate(scene, method=..., step=...)"
_LIMITS = "fm.Limits(angle=...) to an environment: a joint turns without stops"

# Class -> keyword -> what may be given instead, behind the word "give".
FOREIGN_KEYWORDS: dict[str, dict[str, str]] = {
    "Joint": {
        **dict.fromkeys(("kind", "type", "joint_type", "prismatic"), _REVOLUTE),
        **dict.fromkeys(("limits", "limit", "range", "lower", "upper"), _LIMITS),
        **dict.fromkeys(("parent", "child"), _SERIAL),
        "backlash": "nothing: a gear is a linear spring and a damper with friction; for backlash take Modelica "
        "(ElastoBacklash)",
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
# Class -> member that it does not have -> what to do instead.
ABSENT_MEMBERS = {
    "Arm": {
        "from_urdf": "a URDF has rigid bodies, without sections and springs; build fm.Arm(links, joints), or take "
        "Pinocchio, MuJoCo or Drake for its rigid arm"
    }
}


class _AbsentMember:
    """A member that a class does not have: reading it raises an AttributeError with one line."""

    def __init__(self, line: str) -> None:
        self._line = line

    def __get__(self, instance: object, owner: type) -> Any:
        raise AttributeError(self._line)


def check_keywords(kind: type[Part]) -> type[Part]:
    """Let the constructor of a dataclass answer unknown keywords, by a TypeError of one line; its signature stays."""
    construct: Callable[..., None] = kind.__init__
    known = [field.name for field in fields(kind)]  # type: ignore[arg-type]

    @wraps(construct)
    def constructor(self: Any, *values: Any, **named: Any) -> None:
        for name, value in named.items():
            if name not in known:
                near = get_close_matches(name, known, 1, 0.0)[0]
                nearest = f"a known keyword: the nearest is {near}; all: {' '.join(known)}"
                allowed = FOREIGN_KEYWORDS.get(kind.__name__, {}).get(name) or nearest
                raise TypeError(str(value_error(f"{kind.__name__}.{name}", value, allowed)))
        construct(self, *values, **named)

    kind.__init__ = constructor  # type: ignore[method-assign]
    for name, line in ABSENT_MEMBERS.get(kind.__name__, {}).items():
        setattr(kind, name, _AbsentMember(f"{kind.__name__}.{name}: {line}"))
    return kind


# least and most of what is usual with room to spare, and what is often given in its place
USUAL_RANGES: dict[str, tuple[float, float, str, str]] = {
    "Link.length": (1e-3, 100.0, "m", "mm"),
    "Link.youngs_modulus": (1e5, 2e12, "Pa", "GPa or MPa; 69 GPa is 69e9"),
    "Link.shear_modulus": (3e4, 1e12, "Pa", "GPa or MPa; 26 GPa is 26e9"),
    "Link.density": (20.0, 25e3, "kg/m^3", "g/cm^3 or kg/m; 2.7 g/cm^3 is 2700"),
    "Motor.rotor_inertia": (0.0, 1.0, "kg m^2", "g cm^2; 100 g cm^2 is 1e-5"),
    "Motor.torque_constant": (1e-6, 10.0, "N m/A", "mN m/A"),
    "Motor.speed_limit": (0.1, 5e3, "rad/s", "revolutions per minute"),
    "Motor.encoder_resolution": (0.0, 0.8, "rad", "counts in a turn; 4096 of them are 2 pi / 4096"),
    "Joint.rotor_inertia": (0.0, 1e5, "kg m^2", "g cm^2"),
    "Arm.modal_damping_ratio": (0.0, 0.3, "1", "per cent; 0.5 % is 0.005"),
    "Arm.stiffness_proportional_damping": (0.0, 1.0, "s", "ms"),
    "control_period": (0.0, 1.0, "s", "ms"),
    "horizon": (0.0, 300.0, "s", "steps; 500 steps of 0.02 s are 10 s"),
}
OWN = ("flexman_gym", "gymnasium")  # packages whose lines are not the cause of a slip


def warn_unusual_units(owner: str, values: Mapping[str, Any]) -> None:
    """Warn (UserWarning) of the first of some values by name that is not usual, in one line.

    Args:
        owner: whose values they are, such as "Link"; "" for none.
        values: numbers by name; others and None are left alone.
    """
    for name, value in values.items():
        field = f"{owner}.{name}".removeprefix(".")
        least, most, unit, other = USUAL_RANGES.get(field, (-math.inf, math.inf, "", ""))
        if isinstance(value, float) and not least <= value <= most:
            usual = f"at most {most:g}" if value > most else f"at least {least:g}"
            warn_caller(f"{field}: {value:g} ({unit}) looks like a slip of units, usual is {usual}; was it in {other}?")
            return


def warn_caller(line: str) -> None:
    """Warn (UserWarning) with the line of the first caller outside this package and Gymnasium."""
    frame, depth = sys._getframe(1), 2
    while frame.f_back and frame.f_globals.get("__name__", "").partition(".")[0] in OWN:
        frame, depth = frame.f_back, depth + 1
    warnings.warn(line, UserWarning, stacklevel=depth)

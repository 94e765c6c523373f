"""Guesses: keywords of other libraries, with what is modelled here, or which tool models it."""

from collections.abc import Callable
from dataclasses import fields
from difflib import get_close_matches
from functools import wraps
from typing import Any, TypeVar

from flexman_gym.checks import refusal

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
GUESSES: dict[str, dict[str, str]] = {
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
ABSENT = {
    "Arm": {
        "from_urdf": "a URDF has rigid bodies, without sections and springs; build fm.Arm(links, joints), or take "
        "Pinocchio, MuJoCo or Drake for its rigid arm"
    }
}


class Absent:
    """A member that a class does not have: reading it raises an AttributeError with one line."""

    def __init__(self, line: str) -> None:
        self._line = line

    def __get__(self, instance: object, owner: type) -> Any:
        raise AttributeError(self._line)


def answer(kind: str, name: str) -> str:
    """Return what may be given in place of a keyword of a class, "" for one that is not in the table."""
    return GUESSES.get(kind, {}).get(name, "")


def answer_guesses(kind: type[Part]) -> type[Part]:
    """Let the constructor of a dataclass answer unknown keywords, by a TypeError of one line; its signature stays."""
    construct: Callable[..., None] = kind.__init__
    known = [field.name for field in fields(kind)]  # type: ignore[arg-type]

    @wraps(construct)
    def constructor(self: Any, *values: Any, **named: Any) -> None:
        for name, value in named.items():
            if name not in known:
                near = get_close_matches(name, known, 1, 0.0)[0]
                nearest = f"a known keyword: the nearest is {near}; all: {' '.join(known)}"
                allowed = answer(kind.__name__, name) or nearest
                raise TypeError(str(refusal(f"{kind.__name__}.{name}", value, allowed)))
        construct(self, *values, **named)

    kind.__init__ = constructor  # type: ignore[method-assign]
    for name, line in ABSENT.get(kind.__name__, {}).items():
        setattr(kind, name, Absent(f"{kind.__name__}.{name}: {line}"))
    return kind

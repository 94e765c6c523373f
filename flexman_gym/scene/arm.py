"""Arm: a serial chain of links and revolute joints with a payload, in SI units."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from flexman_gym.common.arrays import Vector
from flexman_gym.common.checks import (
    MAX_SIZE,
    check_magnitudes,
    instances,
    non_negative,
    set_fields,
    value_error,
    vector,
)
from flexman_gym.scene.input_checks import check_keywords, warn_caller, warn_unusual_units
from flexman_gym.scene.joint import Joint
from flexman_gym.scene.link import Link, NonUniformLink
from flexman_gym.scene.rigid_body import LumpedMass, Payload

MAX_GRAVITY = 300.0  # m/s^2
MAX_MASS_RATIO, MAX_REACH_RATIO = 100.0, 20.0  # of a carried body to the links: mass, and distance to their length


@check_keywords
@dataclass(frozen=True)
class Arm:
    """A serial arm on a fixed base: joint i turns link i, joint i + 1 sits on the tip of link i.

    Attributes:
        links: n of Link or NonUniformLink, base to tip; stored as a tuple.
        joints: n of Joint; stored as a tuple.
        payload: Payload at the last tip. A payload without mass is stored as None, as it is the same arm.
        gravity: (3,) acceleration of gravity in the base frame, m/s^2.
        stiffness_proportional_damping: beta in C = beta K of every link, s.
        modal_damping_ratio: damping ratio of every mode of a link, 0 <= ratio < 1; one number, or (n,) for each link.

    Raises:
        ValueError: when there is no link, when links and joints differ in number or hold something else, when gravity
            is not three finite numbers, and when a damping is outside its range.

    Examples:
        >>> joint = fm.Joint((0, 0, 1), rotor_inertia=0.01, stiffness=30.0)
        >>> arm = fm.Arm([fm.Link.tube(0.5, diameter=0.02, wall=0.001)], [joint], fm.Payload(0.1), (0, 0, -9.81))
        >>> arm.n_joints
        1
    """

    links: Sequence[Link | NonUniformLink]
    joints: Sequence[Joint]
    payload: Payload | None = None
    gravity: Vector = (0.0, 0.0, 0.0)
    stiffness_proportional_damping: float = 0.0
    modal_damping_ratio: float | Vector = 0.0

    def __post_init__(self) -> None:
        set_fields(
            self,
            links=instances("Arm.links", self.links, Link, NonUniformLink),
            joints=instances("Arm.joints", self.joints, Joint),
            gravity=vector("Arm.gravity", self.gravity, 3, "m/s^2"),
            stiffness_proportional_damping=non_negative(
                "Arm.stiffness_proportional_damping", self.stiffness_proportional_damping, "s"
            ),
            modal_damping_ratio=self._checked_ratio(),
        )
        check_magnitudes("Arm.gravity", self.gravity, MAX_SIZE, "m/s^2")
        if len(self.joints) != len(self.links):
            raise ValueError(
                f"Arm.joints: {len(self.joints)} joints are not allowed; give {len(self.links)}, one for each link"
            )
        if not isinstance(self.payload, Payload | None):
            raise value_error("Arm.payload", self.payload, "a Payload or None")
        if self.payload == Payload(0.0):
            set_fields(self, payload=None)
        self._warn_of_slips()

    def _warn_of_slips(self) -> None:
        warn_unusual_units("Arm", vars(self))
        _warn_of_gravity(tuple(self.gravity))
        length = sum(link.length for link in self.links)
        beams = sum(link.mass - sum(each.mass for each in link.masses) for link in self.links)
        carried: list[tuple[str, LumpedMass | Payload]] = [
            (f"Arm.links[{i}].masses[{j}]", each)
            for i, link in enumerate(self.links)
            for j, each in enumerate(link.masses)
        ]
        if self.payload:
            carried.append(("Arm.payload", self.payload))
        for name, each in carried:
            _warn_of_loads(name, each.mass, each.inertia, each.offset, (beams, length))

    def _checked_ratio(self) -> float | Vector:
        """One damping ratio, or one for each link."""
        given, field = self.modal_damping_ratio, "Arm.modal_damping_ratio"
        several = isinstance(given, list | tuple) or getattr(given, "ndim", 0) > 0
        ratios = vector(field, given, len(self.links)) if several else (non_negative(field, given),)
        if not all(0.0 <= ratio < 1.0 for ratio in ratios):
            raise value_error(field, given, "numbers >= 0 and < 1" if several else "a number >= 0 and < 1")
        return ratios if several else ratios[0]

    @property
    def damping_ratios(self) -> tuple[float, ...]:
        """The modal damping ratio of each link, (n,)."""
        ratio = self.modal_damping_ratio
        return ratio if isinstance(ratio, tuple) else (float(ratio),) * self.n_joints  # type: ignore[arg-type]

    @property
    def n_joints(self) -> int:
        """Number of joints, equal to the number of links."""
        return len(self.joints)


def _warn_of_loads(name: str, mass: float, inertia: Any, offset: Any, arm: tuple[float, float]) -> None:
    """Warn (UserWarning) of a body that is far too heavy or too large for an arm.

    Args:
        name: of the body.
        mass: kg.
        inertia: (3, 3) kg m^2, None where there is none.
        offset: (3,) m, None where there is none.
        arm: mass of its links (kg) and their length (m).
    """
    size = math.sqrt(max(inertia[i][i] for i in range(3)) / mass) if inertia is not None and mass > 0.0 else 0.0
    away = max(map(abs, offset)) if offset is not None else 0.0
    if mass > MAX_MASS_RATIO * arm[0]:
        said = f"{name}.mass: {mass:g} (kg) is {mass / arm[0]:.3g} times what the links weigh, a slip of units; in g?"
    elif away > MAX_REACH_RATIO * arm[1]:
        said = f"{name}.offset: {away:g} (m) is far beyond an arm of {arm[1]:g} m, a slip of units; was it in mm?"
    elif size > MAX_REACH_RATIO * arm[1]:
        said = f"{name}.inertia: the body would reach {size:.3g} m, a slip of units; was it in g cm^2 or kg mm^2?"
    else:
        return
    warn_caller(said)


def _warn_of_gravity(gravity: tuple[float, ...]) -> None:
    """Warn (UserWarning) of a gravity (m/s^2) that no place has where arms are."""
    size = math.hypot(*gravity)
    if size > MAX_GRAVITY:
        warn_caller(f"Arm.gravity: {size:g} (m/s^2) looks like a slip of units; was it in mm/s^2? 9810 mm/s^2 are 9.81")

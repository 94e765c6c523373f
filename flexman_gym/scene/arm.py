"""Arm: what a person describes, a serial chain of links and revolute joints with a payload, in SI units."""

import math
import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from flexman_gym.checks import (
    inertia_matrix,
    non_negative,
    positive,
    refusal,
    rotation,
    sequence,
    store,
    unit_vector,
    vector,
)

MOST_SECTIONS = 64  # of a link; a model has as many finite elements of it at most
IDENTITY = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))

_LINK_UNITS = {
    "length": "m",
    "area": "m^2",
    "second_moment_y": "m^4",
    "second_moment_z": "m^4",
    "torsion_constant": "m^4",
    "youngs_modulus": "Pa",
    "shear_modulus": "Pa",
    "density": "kg/m^3",
}


@dataclass(frozen=True)
class Link:
    """A straight uniform beam along the x axis of its own frame, from its joint to its tip.

    length            m
    area              m^2, of the cross-section
    second_moment_y   m^4, int z^2 dA: resists bending in the x-z plane
    second_moment_z   m^4, int y^2 dA: resists bending in the x-y plane
    torsion_constant  m^4, J in G J: resists twist (for a round section the polar moment)
    youngs_modulus    Pa
    shear_modulus     Pa
    density           kg/m^3
    orientation       (3, 3) rotation whose columns are the beam's axes in the joint's frame; stored as rows of floats

    Raises ValueError when a number is not finite and > 0, or when `orientation` is not a rotation within 1e-9. Warns
    (UserWarning) when second_moment_y + second_moment_z is less than area^2 / (2 pi), which no section can have: of all
    sections of one area a solid disc has the least polar moment.
    """

    length: float
    area: float
    second_moment_y: float
    second_moment_z: float
    torsion_constant: float
    youngs_modulus: float
    shear_modulus: float
    density: float
    orientation: Sequence[Sequence[float]] = IDENTITY

    def __post_init__(self) -> None:
        store(self, **{name: positive(f"Link.{name}", getattr(self, name), unit) for name, unit in _LINK_UNITS.items()})
        store(self, orientation=rotation("Link.orientation", self.orientation))
        polar, least = self.second_moment_y + self.second_moment_z, self.area * self.area / (2.0 * math.pi)
        if polar < (1.0 - 1e-9) * least:
            warnings.warn(
                f"Link.second_moment_y + second_moment_z: {polar:.6g} is less than any section of the area "
                f"{self.area:.6g} m^2 has; the least is {least:.6g} (m^4), area^2 / (2 pi) of a solid disc",
                UserWarning,
                stacklevel=3,  # who creates the Link; between are __init__ and this
            )

    @property
    def mass(self) -> float:
        """Mass of the link in kg."""
        return self.density * self.area * self.length

    @property
    def sections(self) -> tuple["Link", ...]:
        """The link itself, its only section."""
        return (self,)


@dataclass(frozen=True)
class NonUniformLink:
    """A straight beam of uniform pieces end to end, stepped or, with many of them, tapered; centroids on one line.

    sections     1 to 64 of Link, base to tip, each with its length, section and material; stored as a tuple
    orientation  (3, 3) as of a Link; the sections have none of their own, theirs is the identity

    Raises ValueError when `sections` holds something else or a link with an orientation, and when `orientation` is not
    a rotation within 1e-9.
    """

    sections: Sequence[Link]
    orientation: Sequence[Sequence[float]] = IDENTITY

    def __post_init__(self) -> None:
        sections = _chain("NonUniformLink.sections", self.sections, Link)
        if len(sections) > MOST_SECTIONS:
            raise refusal("NonUniformLink.sections", f"{len(sections)} sections", f"at most {MOST_SECTIONS}")
        for i, section in enumerate(sections):
            if section.orientation != IDENTITY:
                allowed = "the identity; the link as a whole has an orientation"
                raise refusal(f"NonUniformLink.sections[{i}].orientation", section.orientation, allowed)
        store(self, sections=sections, orientation=rotation("NonUniformLink.orientation", self.orientation))

    @property
    def length(self) -> float:
        """Length of the link in m, the sum of its sections'."""
        return sum(section.length for section in self.sections)

    @property
    def mass(self) -> float:
        """Mass of the link in kg."""
        return sum(section.mass for section in self.sections)


@dataclass(frozen=True)
class Joint:
    """A revolute joint: a rotor that turns the link behind it directly, or through a spring and a damper (Eq. 23).

    axis              (3,) unit vector in the frame of the previous link's tip (the base frame for the first joint)
    rotor_inertia     kg m^2, about the axis, on the link's side of any gear
    stiffness         N m/rad, of the spring between rotor and link; None for a rigid joint
    damping           N m s/rad, of the damper parallel to that spring
    viscous_friction  N m s/rad, of the rotor in its bearings and gear (of the link where the joint is rigid)
    coulomb_friction  N m, of the same; it opposes the rate r of the rotor with coulomb_friction tanh(r / coulomb_rate)
    coulomb_rate      rad/s, where friction has reached three quarters of its full size
    torque_limit      N m, the most that the motor gives; environments scale actions by it, a simulation applies what it
                      is told. None where nobody has said it

    Raises ValueError when the axis is not of length 1 within 1e-9 (it is not normalised), when a number is negative or
    not finite, for a damper without a spring, and for a spring without a rotor (its coordinate would have no mass).
    """

    axis: Sequence[float]
    rotor_inertia: float = 0.0
    stiffness: float | None = None
    damping: float = 0.0
    viscous_friction: float = 0.0
    coulomb_friction: float = 0.0
    coulomb_rate: float = 0.01
    torque_limit: float | None = None

    def __post_init__(self) -> None:
        store(
            self,
            axis=unit_vector("Joint.axis", self.axis),
            rotor_inertia=non_negative("Joint.rotor_inertia", self.rotor_inertia, "kg m^2"),
            damping=non_negative("Joint.damping", self.damping, "N m s/rad"),
            viscous_friction=non_negative("Joint.viscous_friction", self.viscous_friction, "N m s/rad"),
            coulomb_friction=non_negative("Joint.coulomb_friction", self.coulomb_friction, "N m"),
            coulomb_rate=positive("Joint.coulomb_rate", self.coulomb_rate, "rad/s"),
        )
        if self.torque_limit is not None:
            store(self, torque_limit=positive("Joint.torque_limit", self.torque_limit, "N m"))
        if self.stiffness is not None:
            store(self, stiffness=positive("Joint.stiffness", self.stiffness, "N m/rad; None for a rigid joint"))
            if self.rotor_inertia == 0.0:
                allowed = "a number > 0 (kg m^2): the rotor of a joint with stiffness has mass"
                raise refusal("Joint.rotor_inertia", self.rotor_inertia, allowed)
        elif self.damping > 0.0:
            raise refusal("Joint.damping", self.damping, "0 with stiffness None: the damper is parallel to the spring")


@dataclass(frozen=True)
class Payload:
    """A point mass at the tip of the last link.

    mass     kg
    inertia  (3, 3) kg m^2 about the centre of mass; None for a point
    offset   (3,) m from the tip to the centre of mass; None for the tip itself

    Both are in the frame that a next joint would have: parallel to the base frame at zero angles.

    Raises ValueError when the mass is negative or not finite, when a payload without mass has inertia or offset, and
    when no rigid body has the inertia.
    """

    mass: float
    inertia: Sequence[Sequence[float]] | None = None
    offset: Sequence[float] | None = None

    def __post_init__(self) -> None:
        store(self, mass=non_negative("Payload.mass", self.mass, "kg"))
        if self.mass == 0.0 and (self.inertia is not None or self.offset is not None):
            raise refusal("Payload.mass", self.mass, "a number > 0 (kg) where inertia or offset is given")
        if self.inertia is not None:
            store(self, inertia=inertia_matrix("Payload.inertia", self.inertia))
        if self.offset is not None:
            store(self, offset=vector("Payload.offset", self.offset, 3, "m"))


@dataclass(frozen=True)
class Arm:
    """A serial arm on a fixed base: joint i turns link i, joint i + 1 sits on the tip of link i.

    links                           n of Link or NonUniformLink, base to tip; stored as a tuple
    joints                          n of Joint; stored as a tuple
    payload                         Payload at the last tip; one of no mass is stored as None, the same arm
    gravity                         (3,) m/s^2, acceleration in the base frame
    stiffness_proportional_damping  s, beta in C = beta K of every link
    modal_damping_ratio             damping ratio of every mode of a link, 0 <= ratio < 1

    Raises ValueError when there is no link, when links and joints differ in number or hold something else, when gravity
    is not three finite numbers, and when a damping is outside its range.
    """

    links: Sequence[Link | NonUniformLink]
    joints: Sequence[Joint]
    payload: Payload | None = None
    gravity: Sequence[float] = (0.0, 0.0, 0.0)
    stiffness_proportional_damping: float = 0.0
    modal_damping_ratio: float = 0.0

    def __post_init__(self) -> None:
        store(
            self,
            links=_chain("Arm.links", self.links, Link, NonUniformLink),
            joints=_chain("Arm.joints", self.joints, Joint),
            gravity=vector("Arm.gravity", self.gravity, 3, "m/s^2"),
            stiffness_proportional_damping=non_negative(
                "Arm.stiffness_proportional_damping", self.stiffness_proportional_damping, "s"
            ),
            modal_damping_ratio=non_negative("Arm.modal_damping_ratio", self.modal_damping_ratio),
        )
        if len(self.joints) != len(self.links):
            raise ValueError(
                f"Arm.joints: {len(self.joints)} joints are not allowed; give {len(self.links)}, one for each link"
            )
        if self.modal_damping_ratio >= 1.0:
            raise refusal("Arm.modal_damping_ratio", self.modal_damping_ratio, "a number >= 0 and < 1")
        if not isinstance(self.payload, Payload | None):
            raise refusal("Arm.payload", self.payload, "a Payload or None")
        if self.payload == Payload(0.0):
            store(self, payload=None)

    @property
    def n_joints(self) -> int:
        """Number of joints, equal to the number of links."""
        return len(self.joints)


def _chain(name: str, value: object, *kinds: type) -> tuple[Any, ...]:
    """Return a list of at least one item, each of one of the `kinds`, as a tuple."""
    names = " or ".join(kind.__name__ for kind in kinds)
    items = sequence(name, value, f"at least one {names}")
    if not items:
        raise refusal(name, value, f"at least one {names}")
    for i, item in enumerate(items):
        if not isinstance(item, kinds):
            raise refusal(f"{name}[{i}]", item, f"a {names}")
    return tuple(items)

"""Arm: a serial chain of links and revolute joints with a payload, as a person describes it, in SI units."""

import math
import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from flexman_gym.arrays import Matrix, Vector
from flexman_gym.checks import (
    MOST,
    bounded,
    non_negative,
    physical,
    refusal,
    rotation,
    sequence,
    store,
    unit_vector,
    vector,
)
from flexman_gym.scene.inertia import inertia_matrix

MOST_SECTIONS = 64  # of a link, as a model has at most so many finite elements of it
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

    It warns (UserWarning) when second_moment_y + second_moment_z is less than area^2 / (2 pi). No section can have so
    little: of all sections of one area a solid disc has the least polar moment.

    Attributes:
        length: m.
        area: of the cross-section, m^2.
        second_moment_y: int z^2 dA, m^4; it resists bending in the x-z plane.
        second_moment_z: int y^2 dA, m^4; it resists bending in the x-y plane.
        torsion_constant: J in G J, m^4; it resists twist. For a round section it is the polar moment.
        youngs_modulus: Pa.
        shear_modulus: Pa.
        density: kg/m^3.
        orientation: (3, 3) rotation whose columns are the beam's axes in the joint's frame; stored as rows of floats.

    Raises:
        ValueError: for a number that is not from 1e-30 to 1e30, and for an orientation that is not a rotation within
            1e-9.
    """

    length: float
    area: float
    second_moment_y: float
    second_moment_z: float
    torsion_constant: float
    youngs_modulus: float
    shear_modulus: float
    density: float
    orientation: Matrix = IDENTITY

    def __post_init__(self) -> None:
        store(self, **{name: physical(f"Link.{name}", getattr(self, name), unit) for name, unit in _LINK_UNITS.items()})
        store(self, orientation=rotation("Link.orientation", self.orientation))
        polar, least = self.second_moment_y + self.second_moment_z, self.area * self.area / (2.0 * math.pi)
        if polar < (1.0 - 1e-9) * least:
            warnings.warn(
                f"Link.second_moment_y + second_moment_z: {polar:.6g} is less than any section of the area "
                f"{self.area:.6g} m^2 has; the least is {least:.6g} (m^4), area^2 / (2 pi) of a solid disc",
                UserWarning,
                stacklevel=3,  # the caller of Link(...): between are __init__ and this method
            )

    @property
    def mass(self) -> float:
        """Mass of the link, kg."""
        return self.density * self.area * self.length

    @property
    def sections(self) -> tuple["Link", ...]:
        """The link itself, as its only section."""
        return (self,)


@dataclass(frozen=True)
class NonUniformLink:
    """A straight beam of uniform sections end to end, with their centroids on one line.

    Sections of different size make a stepped beam; many short ones approximate a tapered beam.

    Attributes:
        sections: 1 to 64 of Link, base to tip, each with its own length, cross-section and material; stored as a tuple.
        orientation: (3, 3) rotation, as of a Link. The orientation of each section must be the identity.

    Raises:
        ValueError: for sections that are not links, a section with an orientation, and an orientation that is not a
            rotation within 1e-9.
    """

    sections: Sequence[Link]
    orientation: Matrix = IDENTITY

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
        """Length of the link, the sum of the lengths of its sections, m."""
        return sum(section.length for section in self.sections)

    @property
    def mass(self) -> float:
        """Mass of the link, kg."""
        return sum(section.mass for section in self.sections)


@dataclass(frozen=True)
class Joint:
    """A revolute joint: a rotor that turns the link behind it directly, or through a spring and a damper (Eq. 23).

    Attributes:
        axis: (3,) unit vector in the frame of the previous link's tip; for the first joint, in the base frame. It is
            not normalised.
        rotor_inertia: about the axis, on the link's side of any gear, kg m^2.
        stiffness: of the spring between rotor and link, N m/rad; None for a rigid joint.
        damping: of the damper parallel to that spring, N m s/rad.
        viscous_friction: of the rotor in its bearings and gear, N m s/rad; of the link where the joint is rigid.
        coulomb_friction: of the rotor in its bearings and gear, N m. It opposes the rate r of the rotor with the torque
            coulomb_friction tanh(r / coulomb_rate).
        coulomb_rate: rate at which the Coulomb friction has reached three quarters of its full size, rad/s.
        torque_limit: the most that the motor gives, N m; None where it is unknown. Environments scale actions by it; a
            simulation applies any torque that it is given.

    Raises:
        ValueError: for an axis whose length is not 1 within 1e-9, for a number that is negative or not finite, for a
            damper without a spring, and for a spring without a rotor (its coordinate would have no mass).
    """

    axis: Vector
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
            rotor_inertia=physical("Joint.rotor_inertia", self.rotor_inertia, "kg m^2", zero=True),
            damping=physical("Joint.damping", self.damping, "N m s/rad", zero=True),
            viscous_friction=physical("Joint.viscous_friction", self.viscous_friction, "N m s/rad", zero=True),
            coulomb_friction=physical("Joint.coulomb_friction", self.coulomb_friction, "N m", zero=True),
            coulomb_rate=physical("Joint.coulomb_rate", self.coulomb_rate, "rad/s"),
        )
        if self.torque_limit is not None:
            store(self, torque_limit=physical("Joint.torque_limit", self.torque_limit, "N m"))
        if self.stiffness is not None:
            store(self, stiffness=physical("Joint.stiffness", self.stiffness, "N m/rad; None for a rigid joint"))
            if self.rotor_inertia == 0.0:
                allowed = "a number > 0 (kg m^2): the rotor of a joint with stiffness has mass"
                raise refusal("Joint.rotor_inertia", self.rotor_inertia, allowed)
        elif self.damping > 0.0:
            raise refusal("Joint.damping", self.damping, "0 with stiffness None: the damper is parallel to the spring")


@dataclass(frozen=True)
class Payload:
    """A point mass or a rigid body at the tip of the last link.

    Inertia and offset are in the frame that a next joint would have: parallel to the base frame at zero angles.

    Attributes:
        mass: kg.
        inertia: (3, 3) about the centre of mass, kg m^2; None for a point mass.
        offset: (3,) from the tip to the centre of mass, m; None for a centre of mass at the tip.

    Raises:
        ValueError: for a mass that is negative or not finite, for an inertia or an offset without a mass, and for an
            inertia that no rigid body has.
    """

    mass: float
    inertia: Matrix | None = None
    offset: Vector | None = None

    def __post_init__(self) -> None:
        store(self, mass=physical("Payload.mass", self.mass, "kg", zero=True))
        if self.mass == 0.0 and (self.inertia is not None or self.offset is not None):
            raise refusal("Payload.mass", self.mass, "a number > 0 (kg) where inertia or offset is given")
        if self.inertia is not None:
            store(self, inertia=inertia_matrix("Payload.inertia", self.inertia))
        if self.offset is not None:
            store(self, offset=vector("Payload.offset", self.offset, 3, "m"))
            bounded("Payload.offset", self.offset, MOST, "m")


@dataclass(frozen=True)
class Arm:
    """A serial arm on a fixed base: joint i turns link i, joint i + 1 sits on the tip of link i.

    Attributes:
        links: n of Link or NonUniformLink, base to tip; stored as a tuple.
        joints: n of Joint; stored as a tuple.
        payload: Payload at the last tip. A payload without mass is stored as None, as it is the same arm.
        gravity: (3,) acceleration of gravity in the base frame, m/s^2.
        stiffness_proportional_damping: beta in C = beta K of every link, s.
        modal_damping_ratio: damping ratio of every mode of a link, 0 <= ratio < 1.

    Raises:
        ValueError: when there is no link, when links and joints differ in number or hold something else, when gravity
            is not three finite numbers, and when a damping is outside its range.
    """

    links: Sequence[Link | NonUniformLink]
    joints: Sequence[Joint]
    payload: Payload | None = None
    gravity: Vector = (0.0, 0.0, 0.0)
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
        bounded("Arm.gravity", self.gravity, MOST, "m/s^2")
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
    """Gives a list of at least one item, each of one of the `kinds`, as a tuple."""
    names = " or ".join(kind.__name__ for kind in kinds)
    items = sequence(name, value, f"at least one {names}")
    if not items:
        raise refusal(name, value, f"at least one {names}")
    for i, item in enumerate(items):
        if not isinstance(item, kinds):
            raise refusal(f"{name}[{i}]", item, f"a {names}")
    return tuple(items)

"""Arm: a serial chain of links and revolute joints with a payload, as a person describes it, in SI units."""

from collections.abc import Sequence
from dataclasses import dataclass

from flexman_gym.common.arrays import Matrix, Vector
from flexman_gym.common.checks import (
    MAX_SIZE,
    check_magnitudes,
    non_negative,
    physical,
    set_fields,
    value_error,
    vector,
)
from flexman_gym.scene.joint import Joint
from flexman_gym.scene.link import Link, LumpedMass, NonUniformLink, instances, rigid_body_fields, total_mass
from flexman_gym.scene.mistakes import check_keywords, warn_of_gravity, warn_of_loads, warn_of_units


@check_keywords
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

    Examples:
        >>> fm.Payload(0.1, offset=(0.0, 0.02, 0.0)).mass
        0.1
    """

    mass: float
    inertia: Matrix | None = None
    offset: Vector | None = None

    def __post_init__(self) -> None:
        set_fields(self, mass=physical("Payload.mass", self.mass, "kg", zero=True))
        if self.mass == 0.0 and (self.inertia is not None or self.offset is not None):
            raise value_error("Payload.mass", self.mass, "a number > 0 (kg) where inertia or offset is given")
        set_fields(self, **rigid_body_fields("Payload", self.inertia, self.offset))


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
        warn_of_units("Arm", vars(self))
        warn_of_gravity(tuple(self.gravity))
        length = sum(link.length for link in self.links)
        beams = sum(link.mass - total_mass(link.masses) for link in self.links)
        carried: list[tuple[str, LumpedMass | Payload]] = [
            (f"Arm.links[{i}].masses[{j}]", each)
            for i, link in enumerate(self.links)
            for j, each in enumerate(link.masses)
        ]
        if self.payload:
            carried.append(("Arm.payload", self.payload))
        for name, each in carried:
            warn_of_loads(name, each.mass, each.inertia, each.offset, (beams, length))

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

"""Lumped: rigid bodies that sit on a link and move with its section, such as an elbow motor, a gripper or a clamp."""

from collections.abc import Sequence
from dataclasses import dataclass

from flexman_gym.arrays import Matrix, Vector
from flexman_gym.checks import non_negative, physical, refusal, sequence, store
from flexman_gym.scene.inertia import body

MOST_MASSES = 64  # on a link


@dataclass(frozen=True)
class LumpedMass:
    """A point mass or a rigid body that is clamped to one section of a link.

    Inertia and offset are in the link's own frame. The body stiffens nothing.

    Attributes:
        mass: kg.
        position: of its section along the link, from the joint, m.
        inertia: (3, 3) about the centre of mass, kg m^2; None for a point mass.
        offset: (3,) from the axis at its section to the centre of mass, m; None for a centre on the axis.

    Raises:
        ValueError: for a mass that is not positive, a position that is negative, and an inertia that no rigid body has.
    """

    mass: float
    position: float
    inertia: Matrix | None = None
    offset: Vector | None = None

    def __post_init__(self) -> None:
        store(
            self,
            mass=physical("LumpedMass.mass", self.mass, "kg"),
            position=non_negative("LumpedMass.position", self.position, "m"),
            **body("LumpedMass", self.inertia, self.offset),
        )


def lumped_masses(name: str, value: object, length: float) -> tuple[LumpedMass, ...]:
    """Gives the lumped masses of a link of a length (m) as a tuple.

    Raises:
        ValueError: for something else, for more than 64 and for a position beyond the tip.
    """
    masses = tuple(sequence(name, value, "LumpedMass"))
    if len(masses) > MOST_MASSES:
        raise refusal(name, f"{len(masses)} masses", f"at most {MOST_MASSES}")
    for i, mass in enumerate(masses):
        if not isinstance(mass, LumpedMass):
            raise refusal(f"{name}[{i}]", mass, "a LumpedMass")
        if mass.position > length:
            raise refusal(f"{name}[{i}].position", mass.position, f"at most the length {length} of the link (m)")
    return masses


def total_mass(masses: Sequence[LumpedMass]) -> float:
    """Gives the mass of them all, kg."""
    return sum(mass.mass for mass in masses)

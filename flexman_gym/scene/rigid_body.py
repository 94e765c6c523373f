"""Rigid bodies of an arm: lumped masses on a link, and the payload at the tip."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from flexman_gym.common.arrays import Matrix, Vector
from flexman_gym.common.checks import MAX_SIZE, check_magnitudes, non_negative, physical, sequence, set_fields, vector
from flexman_gym.common.errors import value_error
from flexman_gym.scene.inertia import POSSIBLE, ROUNDING, triangle_excess
from flexman_gym.scene.input_checks import check_keywords


def _checked_fields(name: str, inertia: Matrix | None, offset: Vector | None) -> dict[str, Any]:
    """Return the checked inertia (3, 3), kg m^2, and offset (3,), m, of a rigid body as tuples; None stays None."""
    if inertia is not None:
        inertia = _inertia_matrix(f"{name}.inertia", inertia)
    if offset is not None:
        offset = vector(f"{name}.offset", offset, 3, "m")
        check_magnitudes(f"{name}.offset", offset, MAX_SIZE, "m")
    return {"inertia": inertia, "offset": offset}


def _inertia_matrix(name: str, value: object) -> tuple[tuple[float, ...], ...]:
    """Return the inertia matrix (3, 3) of a rigid body, kg m^2, as a tuple of rows.

    It must be symmetric with non-negative principal moments, none of which exceeds the sum of the other two.
    """
    allowed = f"a symmetric inertia matrix (kg m^2) with {POSSIBLE}"
    rows = sequence(name, value, "3 rows of 3 numbers")
    if len(rows) != 3:
        raise value_error(name, value, "3 rows of 3 numbers")
    rows = tuple(vector(f"{name}[{i}]", row, 3) for i, row in enumerate(rows))
    matrix = np.array(rows)
    if not np.array_equal(matrix, matrix.T) or triangle_excess(matrix) > ROUNDING:
        raise value_error(name, value, allowed)
    return rows


@dataclass(frozen=True)
class LumpedMass:
    """Point mass or rigid body clamped to one cross-section of a link.

    Inertia and offset refer to the axes of the beam (see `Link.orientation`). The body does not stiffen the link.

    Attributes:
        mass: mass, kg; greater than 0.
        position: distance of the cross-section from the joint, along the link, m.
        inertia: inertia matrix (3, 3) about the centre of mass, kg m^2; None for a point mass.
        offset: vector (3,) from the beam axis at the cross-section to the centre of mass, m; None for a centre of mass
            on the beam axis.

    Raises:
        ValueError: for a value outside its range and for an inertia impossible for a rigid body.

    Examples:
        >>> hub = fm.LumpedMass(mass=0.4, position=0.44)
        >>> link = fm.Link.rod(0.44, diameter=0.01, masses=[hub])
        >>> round(link.mass, 3)
        0.493
    """

    mass: float
    position: float
    inertia: Matrix | None = None
    offset: Vector | None = None

    def __post_init__(self) -> None:
        set_fields(
            self,
            mass=physical("LumpedMass.mass", self.mass, "kg"),
            position=non_negative("LumpedMass.position", self.position, "m"),
            **_checked_fields("LumpedMass", self.inertia, self.offset),
        )


@check_keywords
@dataclass(frozen=True)
class Payload:
    """Point mass or rigid body at the tip of the last link.

    Inertia and offset refer to axes fixed to the tip cross-section, which are parallel to the base frame at zero joint
    angles and without deformation.

    Attributes:
        mass: mass, kg; not negative.
        inertia: inertia matrix (3, 3) about the centre of mass, kg m^2; None for a point mass.
        offset: vector (3,) from the tip to the centre of mass, m; None for a centre of mass at the tip.

    Raises:
        ValueError: for a value outside its range, for an inertia or offset without a mass, and for an inertia
            impossible for a rigid body.

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
        set_fields(self, **_checked_fields("Payload", self.inertia, self.offset))

"""Rigid bodies of an arm: lumped masses on a link, and the payload at the tip."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from flexman_gym.common.arrays import Matrix, Vector
from flexman_gym.common.checks import (
    MAX_SIZE,
    check_magnitudes,
    non_negative,
    physical,
    sequence,
    set_fields,
    value_error,
    vector,
)
from flexman_gym.scene.input_checks import check_keywords


def _checked_fields(name: str, inertia: Matrix | None, offset: Vector | None) -> dict[str, Any]:
    """Return the inertia and the offset of a rigid body in their stored form; None stays None.

    Raises:
        ValueError: for an inertia that no rigid body has, and for an offset that is not three numbers up to 1e30.
    """
    if inertia is not None:
        inertia = _inertia_matrix(f"{name}.inertia", inertia)
    if offset is not None:
        offset = vector(f"{name}.offset", offset, 3, "m")
        check_magnitudes(f"{name}.offset", offset, MAX_SIZE, "m")
    return {"inertia": inertia, "offset": offset}


def _inertia_matrix(name: str, value: object) -> tuple[tuple[float, ...], ...]:
    """Return the (3, 3) inertia of a rigid body in kg m^2 as a tuple of rows.

    It is symmetric, its principal moments are not negative, and none exceeds the sum of the other two.

    Raises:
        ValueError: for anything else.
    """
    allowed = "a symmetric inertia (kg m^2) whose principal moments are >= 0, none above the sum of the others"
    rows = sequence(name, value, "3 rows of 3 numbers")
    if len(rows) != 3:
        raise value_error(name, value, "3 rows of 3 numbers")
    rows = tuple(vector(f"{name}[{i}]", row, 3) for i, row in enumerate(rows))
    matrix = np.array(rows)
    if not np.array_equal(matrix, matrix.T):
        raise value_error(name, value, allowed)
    moments = np.linalg.eigvalsh(matrix)
    rounding = 1e-12 * max(abs(moments))
    if moments[0] < -rounding or moments[2] > moments[0] + moments[1] + rounding:
        raise value_error(name, value, allowed)
    return rows


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
        set_fields(
            self,
            mass=physical("LumpedMass.mass", self.mass, "kg"),
            position=non_negative("LumpedMass.position", self.position, "m"),
            **_checked_fields("LumpedMass", self.inertia, self.offset),
        )


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
        set_fields(self, **_checked_fields("Payload", self.inertia, self.offset))

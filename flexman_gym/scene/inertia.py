"""Inertia of rigid bodies: combination, change of axes, the nearest inertia matrix of a body, spatial inertia.

The matrix of second moments of mass about the centre of a body is P = tr(I) / 2 - I. It is positive semidefinite for
every distribution of mass, which is equivalent to principal moments >= 0, none of which exceeds the sum of the other
two (Wensing, Kim and Slotine 2018, IEEE Robotics and Automation Letters 3, 60-67).
"""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from flexman_gym.common.arrays import Array

ROUNDING = 1e-12  # dimensionless; largest `triangle_excess` of an inertia matrix of an arm
POSSIBLE = "principal moments >= 0, none above the sum of the other two"  # allowed inertias, for errors


class Body(NamedTuple):
    """Rigid body: mass (kg), centre of mass (3,), m, and inertia matrix (3, 3) about it, kg m^2, in common axes."""

    mass: float
    centre: Array
    inertia: Array

    @classmethod
    def joined(cls, bodies: Sequence["Body"]) -> "Body":
        """Return several bodies as one; a mass of 0 without bodies."""
        mass = sum(body.mass for body in bodies)
        centre = sum((body.mass * body.centre for body in bodies), np.zeros(3)) / (mass or 1.0)
        inertia = np.zeros((3, 3))
        for body in bodies:
            r = body.centre - centre
            inertia += body.inertia + body.mass * (r @ r * np.eye(3) - np.outer(r, r))
        return cls(mass, centre, inertia)

    def seen_from(self, rotation: Array, origin: Array) -> "Body":
        """Return the body in a frame with given axes (columns of the rotation) and origin, in the present axes."""
        inertia = rotation.T @ self.inertia @ rotation
        return Body(self.mass, rotation.T @ (self.centre - origin), (inertia + inertia.T) / 2.0)

    def plain(self, position: float = 0.0) -> dict[str, Any]:
        """Return the plain form of a Payload, or of a LumpedMass at a position along its link, m; zeros left out."""
        parts = {"inertia": self.inertia, "offset": self.centre - [position, 0.0, 0.0]}
        return {"mass": self.mass} | {name: part.tolist() for name, part in parts.items() if part.any()}


def triangle_excess(inertia: Array) -> float:
    """Return the excess of the largest principal moment over the sum of the other two, relative to the largest.

    It is 0 for an inertia matrix (3, 3) that a body can have; a negative principal moment has an excess, too.
    """
    low, middle, high = np.linalg.eigvalsh(inertia)
    scale = max(abs(low), abs(high))
    return max(0.0, float((high - middle - low) / scale)) if scale else 0.0


def nearest_inertia(inertia: Array) -> Array:
    """Return the inertia matrix (3, 3) of the nearest distribution of mass, kg m^2.

    Negative second moments of mass are set to zero, which is the nearest positive semidefinite matrix in the Frobenius
    norm (Higham 1988, Linear Algebra and its Applications 103, 103-118). Where one of them is negative, the largest
    principal moment is unchanged and the other two increase.
    """
    values, axes = np.linalg.eigh(np.trace(inertia) / 2.0 * np.eye(3) - inertia)
    moments = (axes * np.maximum(values, 0.0)) @ axes.T
    nearest: Array = np.trace(moments) * np.eye(3) - (moments + moments.T) / 2.0
    return nearest


def spatial_inertia(mass: float, offset: Array, inertia: Array) -> Array:
    """Return the spatial inertia (6, 6) of a rigid body about a reference point, linear part first (kg, kg m, kg m^2).

    Args:
        mass: kg.
        offset: (3,) position of the centre of mass relative to the reference point, m.
        inertia: inertia matrix (3, 3) about the centre of mass, kg m^2.
    """
    centre = offset_velocity_transform(offset)[:3]
    result: Array = mass * centre.T @ centre
    result[3:, 3:] += inertia
    return result


def offset_velocity_transform(offset: Array) -> Array:
    """Return the matrix (6, 6) from the velocities (v, w) at the origin to (v + w x offset, w) at an offset (3,), m."""
    x, y, z = offset
    motion = np.eye(6)
    motion[:3, 3:] = [[0.0, z, -y], [-z, 0.0, x], [y, -x, 0.0]]
    return motion

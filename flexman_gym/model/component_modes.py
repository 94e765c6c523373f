"""Component modes of a clamped link with the inertia of the outboard arm at its tip.

Component modes are retained in the order of their frequencies. The torsion modes of the bare link have high
frequencies, although its torsion moves the whole outboard arm. Loaded modes therefore include the inertia of the rigid
outboard arm, at zero joint angles, at the tip of the link.
"""

from itertools import pairwise
from typing import NamedTuple, Self

import numpy as np

from flexman_gym.common.arrays import Array
from flexman_gym.common.errors import value_error
from flexman_gym.model.beam import Beam
from flexman_gym.scene.arm import Arm

NEGLIGIBLE = 1e-12  # off-diagonal entry / geometric mean of its diagonal entries, below which it is a rounded zero


def zero_pose_rotations(arm: Arm) -> Array:
    """Return the rotations (n, 3, 3) from each beam frame to that of the inboard link (or base), at zero angles."""
    orientations = [np.eye(3)] + [np.array(link.orientation) for link in arm.links]
    return np.array([before.T @ after for before, after in pairwise(orientations)])


def outboard_inertias(arm: Arm, beams: tuple[Beam, ...]) -> Array:
    """Return the spatial inertia (n, 6, 6) of the rigid outboard arm at the tip of each link, in its beam frame.

    It includes all outboard links and the payload, at zero joint angles. The linear part comes first: entries are
    masses (kg), first moments of mass (kg m) and moments of inertia (kg m^2).

    Args:
        arm: the arm.
        beams: its links, base to tip.
    """
    inertia = np.zeros((6, 6))
    if arm.payload is not None:
        mount = np.array(arm.links[-1].orientation).T
        offset, central = arm.payload.offset or np.zeros(3), arm.payload.inertia or np.zeros((3, 3))
        inertia = spatial_inertia(arm.payload.mass, mount @ offset, mount @ central @ mount.T)
    result = np.zeros((len(beams), 6, 6))
    rotations = zero_pose_rotations(arm)
    for i in reversed(range(len(beams))):
        result[i] = inertia
        tip = _transport(np.array([arm.links[i].length, 0.0, 0.0]))
        total = tip.T @ inertia @ tip
        for mass, position in zip(beams[i].masses, beams[i].positions, strict=True):
            point = _transport(position)[:3]
            total += mass * point.T @ point
        total[3, 3] += beams[i].polar.sum()
        rotation = np.kron(np.eye(2), rotations[i])
        inertia = rotation @ total @ rotation.T
    return result


class LoadedModes(NamedTuple):
    """Modes of a clamped link with a rigid inertia at its tip.

    Attributes:
        frequencies: (k,) angular frequencies, rad/s, ascending.
        shapes: (k, k) shapes as columns, normalised to unit modal mass, including the inertia at the tip.
    """

    frequencies: Array
    shapes: Array

    @classmethod
    def of(cls, beam: Beam, outboard: Array) -> Self:
        """Return the modes of a link.

        The eigenvalue problem is solved for each uncoupled group of coordinates, because two bending modes of equal
        frequency could otherwise lie in any two planes. Modes along y and z have more mass integrals equal to zero.

        Args:
            beam: the link, with k elastic coordinates.
            outboard: (6, 6) spatial inertia at its tip, linear part first; units as in `outboard_inertias`.
        """
        from scipy.linalg import eigh  # slow import, which most uses of the package do not need

        tip = np.vstack([beam.tip_translation, beam.tip_rotation])
        mass, stiffness = beam.mass_matrix + tip.T @ outboard @ tip, beam.stiffness
        frequencies, shapes, count = np.zeros(len(mass)), np.zeros_like(mass), 0
        for group in _uncoupled_groups(mass, stiffness):
            block, columns = np.ix_(group, group), slice(count, count + len(group))
            try:
                squares, shapes[group, columns] = eigh(stiffness[block], mass[block])
                if not (squares > 0.0).all():  # negative only by rounding, as the link is clamped
                    raise np.linalg.LinAlgError
            except (np.linalg.LinAlgError, ValueError):
                allowed = "links and loads whose masses are within fifteen digits of each other"
                raise value_error("arm", "this one", allowed) from None
            frequencies[columns] = np.sqrt(squares)
            count += len(group)
        # rounding must not determine the order of two equal frequencies
        order = np.argsort([float(f"{frequency:.9g}") for frequency in frequencies], kind="stable")
        return cls(frequencies[order], shapes[:, order])

    def basis(self, modes: int | tuple[int, ...] | None, field: str) -> Array:
        """Return the node coordinates (size, k) of the link per unit of each retained coordinate.

        Args:
            modes: number of retained modes, or a tuple of their indices; None retains all coordinates.
            field: name of the argument, for errors.
        """
        size = len(self.shapes)
        if modes is None:
            return np.eye(size)
        count = f"{size}, the elastic coordinates of this link's elements"
        if isinstance(modes, int) and modes > size:
            raise value_error(field, modes, f"at most {count}")
        if isinstance(modes, tuple) and modes[-1] >= size:
            raise value_error(field, modes, f"mode numbers below {count}")
        return self.shapes[:, range(modes) if isinstance(modes, int) else modes]

    def damping(self, stiffness: Array, ratio: float) -> Array:
        """Return the damping matrix (k, k) of a link by one damping ratio of all modes, from its stiffness matrix."""
        # K shapes / frequencies^2 = M shapes with the loaded mass matrix M; its transpose is the inverse of the shapes
        inverse = stiffness @ self.shapes / self.frequencies**2
        return 2.0 * ratio * inverse * self.frequencies @ inverse.T


def _uncoupled_groups(*matrices: Array) -> list[np.ndarray]:
    """Return groups of coordinates without coupling between different groups: the connected components.

    The matrices (k, k) are symmetric and positive definite.
    """
    coupled = np.zeros(matrices[0].shape, dtype=bool)
    for matrix in matrices:
        size = np.sqrt(np.diag(matrix))
        coupled |= np.abs(matrix) > NEGLIGIBLE * np.outer(size, size)
    group, previous = np.arange(len(coupled)), np.full(len(coupled), -1)
    while not np.array_equal(group, previous):  # the lowest index of a group spreads over the group
        previous, group = group, np.where(coupled, group, len(group)).min(axis=1, initial=len(group))
    return [np.flatnonzero(group == number) for number in np.unique(group)]


def spatial_inertia(mass: float, offset: Array, inertia: Array) -> Array:
    """Return the spatial inertia (6, 6) of a rigid body about a reference point, linear part first (kg, kg m, kg m^2).

    Args:
        mass: kg.
        offset: (3,) position of the centre of mass relative to the reference point, m.
        inertia: inertia matrix (3, 3) about the centre of mass, kg m^2.
    """
    centre = _transport(offset)[:3]
    result: Array = mass * centre.T @ centre
    result[3:, 3:] += inertia
    return result


def _transport(offset: Array) -> Array:
    """Return the matrix (6, 6) from the velocities (v, w) at the origin to (v + w x offset, w) at an offset (3,), m."""
    x, y, z = offset
    motion = np.eye(6)
    motion[:3, 3:] = [[0.0, z, -y], [-z, 0.0, x], [y, -x, 0.0]]
    return motion

"""Component modes of a link that carries the inertia of the outboard arm.

Modes of the bare clamped link, sorted by frequency, rank torsion far behind bending, although torsion carries the whole
outboard arm. Loaded modes include the inertia of the outboard arm, straight and rigid, at the link's tip.
"""

from itertools import pairwise

import numpy as np

from flexman_gym.common.arrays import Array
from flexman_gym.common.checks import value_error
from flexman_gym.model.beam import Beam
from flexman_gym.scene.arm import Arm

VANISHING = 1e-12  # of the geometric mean of two diagonal entries: a smaller coupling is rounding


def zero_pose_rotations(arm: Arm) -> Array:
    """Gives the rotation (n, 3, 3) of each beam frame relative to the one before it at zero angles.

    The first rotation is relative to the base.
    """
    orientations = [np.eye(3)] + [np.array(link.orientation) for link in arm.links]
    return np.array([before.T @ after for before, after in pairwise(orientations)])


def outboard_inertias(arm: Arm, beams: tuple[Beam, ...]) -> Array:
    """Gives the rigid inertia (n, 6, 6) at each link's tip at zero angles, in its beam frame, linear part first.

    It is the inertia of the payload and of all links behind the tip.
    """
    inertia = np.zeros((6, 6))
    if arm.payload is not None:
        mount = np.array(arm.links[-1].orientation).T
        offset, own = arm.payload.offset or np.zeros(3), arm.payload.inertia or np.zeros((3, 3))
        inertia = spatial_inertia(arm.payload.mass, mount @ offset, mount @ own @ mount.T)
    result = np.zeros((len(beams), 6, 6))
    rotations = zero_pose_rotations(arm)
    for i in reversed(range(len(beams))):
        result[i] = inertia
        tip = _carry(np.array([arm.links[i].length, 0.0, 0.0]))
        total = tip.T @ inertia @ tip
        for mass, position in zip(beams[i].masses, beams[i].positions, strict=True):
            point = _carry(position)[:3]
            total += mass * point.T @ point
        total[3, 3] += beams[i].polar.sum()
        rotation = np.kron(np.eye(2), rotations[i])
        inertia = rotation @ total @ rotation.T
    return result


def loaded_modes(beam: Beam, outboard: Array) -> tuple[Array, Array]:
    """Gives the modes of a clamped link that carries an inertia at its tip.

    Coordinates that nothing couples are solved apart. The bending of a round link has two modes of the same frequency,
    in any two planes. Solved apart, they lie along y and z, whose integrals vanish more often.

    Args:
        beam: the link, with k elastic coordinates.
        outboard: (6, 6) inertia that its tip carries.

    Returns:
        Angular frequencies (k,) in rad/s, ascending, and shapes (k, k) as columns. The shapes are normalised to unit
            modal mass including the outboard inertia.
    """
    from scipy.linalg import eigh  # its import takes long, and not every use of the package needs it

    tip = np.vstack([beam.tip_translation, beam.tip_rotation])
    mass, stiffness = beam.mass_matrix + tip.T @ outboard @ tip, beam.stiffness
    frequencies, shapes, count = np.zeros(len(mass)), np.zeros_like(mass), 0
    for group in _uncoupled_groups(mass, stiffness):
        block, columns = np.ix_(group, group), slice(count, count + len(group))
        try:
            squares, shapes[group, columns] = eigh(stiffness[block], mass[block])
            if not (squares > 0.0).all():  # of a clamped link they are, but for rounding
                raise np.linalg.LinAlgError
        except (np.linalg.LinAlgError, ValueError):
            allowed = "links and loads whose masses are within fifteen digits of each other"
            raise value_error("arm", "this one", allowed) from None
        frequencies[columns] = np.sqrt(squares)
        count += len(group)
    # rounding must not decide which of two equal frequencies comes first
    order = np.argsort([float(f"{frequency:.9g}") for frequency in frequencies], kind="stable")
    return frequencies[order], shapes[:, order]


def _uncoupled_groups(*matrices: Array) -> list[np.ndarray]:
    """Gives groups of coordinates that symmetric positive definite matrices (k, k) do not couple beyond rounding."""
    joined = np.zeros(matrices[0].shape, dtype=bool)
    for matrix in matrices:
        size = np.sqrt(np.diag(matrix))
        joined |= np.abs(matrix) > VANISHING * np.outer(size, size)
    group, before = np.arange(len(joined)), np.full(len(joined), -1)
    while not np.array_equal(group, before):  # the lowest number spreads over its group
        before, group = group, np.where(joined, group, len(group)).min(axis=1, initial=len(group))
    return [np.flatnonzero(group == number) for number in np.unique(group)]


def spatial_inertia(mass: float, offset: Array, inertia: Array) -> Array:
    """Gives the inertia (6, 6) about a point, linear part first, of a body whose centre is at an offset (3,) m from it.

    Args:
        mass: kg.
        offset: m.
        inertia: (3, 3) about the centre, kg m^2.
    """
    centre = _carry(offset)[:3]
    result: Array = mass * centre.T @ centre
    result[3:, 3:] += inertia
    return result


def _carry(offset: Array) -> Array:
    """Gives the motion (6, 6) of a point at an offset from the motion of the origin: v + w x offset, w."""
    x, y, z = offset
    motion = np.eye(6)
    motion[:3, 3:] = [[0.0, z, -y], [-z, 0.0, x], [y, -x, 0.0]]
    return motion

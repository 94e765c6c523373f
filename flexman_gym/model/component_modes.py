"""Component modes of a link loaded by the inertia of the outboard arm.

Modes of the bare clamped link, sorted by frequency, place torsion far behind bending, although torsion carries the
whole outboard arm. Loaded modes therefore include the inertia of the straight, rigid outboard arm at the tip of the
link.
"""

from itertools import pairwise

import numpy as np

from flexman_gym.common.arrays import Array
from flexman_gym.common.checks import value_error
from flexman_gym.model.beam import Beam
from flexman_gym.scene.arm import Arm

NEGLIGIBLE = 1e-12  # coupling relative to the geometric mean of the diagonal entries, below which it is rounding


def zero_pose_rotations(arm: Arm) -> Array:
    """Return the rotations (n, 3, 3) from each beam frame to the previous one (or the base) at zero joint angles."""
    orientations = [np.eye(3)] + [np.array(link.orientation) for link in arm.links]
    return np.array([before.T @ after for before, after in pairwise(orientations)])


def outboard_inertias(arm: Arm, beams: tuple[Beam, ...]) -> Array:
    """Return the rigid spatial inertia (n, 6, 6) at the tip of each link at zero joint angles, in its beam frame.

    It includes the payload and all links beyond the tip; the linear part comes first.

    Args:
        arm: the arm.
        beams: its links, base to tip.
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
        tip = _transport(np.array([arm.links[i].length, 0.0, 0.0]))
        total = tip.T @ inertia @ tip
        for mass, position in zip(beams[i].masses, beams[i].positions, strict=True):
            point = _transport(position)[:3]
            total += mass * point.T @ point
        total[3, 3] += beams[i].polar.sum()
        rotation = np.kron(np.eye(2), rotations[i])
        inertia = rotation @ total @ rotation.T
    return result


def loaded_modes(beam: Beam, outboard: Array) -> tuple[Array, Array]:
    """Return the modes of a clamped link with an inertia at its tip.

    Uncoupled groups of coordinates are solved separately. The bending of a round link has two modes of equal frequency
    in arbitrary planes; solved separately, they lie along y and z, and more of their mass integrals vanish.

    Args:
        beam: the link, with k elastic coordinates.
        outboard: (6, 6) spatial inertia at its tip.

    Returns:
        Angular frequencies (k,) in rad/s, ascending, and shapes (k, k) as columns, normalised to unit modal mass
            including the outboard inertia.
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
    return frequencies[order], shapes[:, order]


def _uncoupled_groups(*matrices: Array) -> list[np.ndarray]:
    """Return the groups of coordinates that symmetric positive definite matrices (k, k) couple beyond rounding."""
    joined = np.zeros(matrices[0].shape, dtype=bool)
    for matrix in matrices:
        size = np.sqrt(np.diag(matrix))
        joined |= np.abs(matrix) > NEGLIGIBLE * np.outer(size, size)
    group, before = np.arange(len(joined)), np.full(len(joined), -1)
    while not np.array_equal(group, before):  # the lowest index spreads over its group
        before, group = group, np.where(joined, group, len(group)).min(axis=1, initial=len(group))
    return [np.flatnonzero(group == number) for number in np.unique(group)]


def spatial_inertia(mass: float, offset: Array, inertia: Array) -> Array:
    """Return the spatial inertia (6, 6) of a rigid body about a reference point, linear part first.

    Args:
        mass: kg.
        offset: (3,) centre of mass relative to the point, m.
        inertia: (3, 3) about the centre of mass, kg m^2.
    """
    centre = _transport(offset)[:3]
    result: Array = mass * centre.T @ centre
    result[3:, 3:] += inertia
    return result


def _transport(offset: Array) -> Array:
    """Return the map (6, 6) from the motion (v, w) of the origin to that of a point at an offset: v + w x offset, w."""
    x, y, z = offset
    motion = np.eye(6)
    motion[:3, 3:] = [[0.0, z, -y], [-z, 0.0, x], [y, -x, 0.0]]
    return motion

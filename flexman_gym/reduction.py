"""Reduction: component modes of a link that carries the rest of the arm.

Modes of the bare clamped link, sorted by frequency, are a trap: they rank torsion far behind bending although torsion
carries everything outboard. Loaded modes see the inertia of the outboard arm, straight and rigid, at the link's tip.
"""

from itertools import pairwise

import numpy as np

from flexman_gym.arm import Arm
from flexman_gym.beam import Array, Beam


def zero_pose_rotations(arm: Arm) -> Array:
    """(n, 3, 3) rotation of each beam frame relative to the one before it (the base for the first) at zero angles."""
    orientations = [np.eye(3)] + [np.array(link.orientation) for link in arm.links]
    return np.array([before.T @ after for before, after in pairwise(orientations)])


def outboard_inertias(arm: Arm, beams: tuple[Beam, ...]) -> Array:
    """(n, 6, 6) rigid inertia that each link's tip carries at zero angles, in its beam frame, linear part first."""
    inertia = np.zeros((6, 6))
    if arm.payload is not None:
        mount = np.array(arm.links[-1].orientation).T
        centre = _carry(mount @ (arm.payload.offset or np.zeros(3)))[:3]
        inertia = arm.payload.mass * centre.T @ centre
        inertia[3:, 3:] += mount @ (arm.payload.inertia or np.zeros((3, 3))) @ mount.T
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
    """Angular frequencies (k,) rad/s, ascending, and shapes (k, k), columns, of a clamped link that carries an inertia.

    The shapes are normalised to unit modal mass including the outboard inertia (6, 6).
    """
    from scipy.linalg import eigh  # takes long to import, and not every use of the package needs it

    tip = np.vstack([beam.tip_translation, beam.tip_rotation])
    squares, shapes = eigh(beam.stiffness, beam.mass_matrix + tip.T @ outboard @ tip)
    return np.sqrt(squares), shapes


def modal_damping(beam: Beam, outboard: Array, ratio: float) -> Array:
    """(k, k) damping matrix of a link that gives each of its loaded modes the same damping ratio."""
    if len(beam.stiffness) == 0:
        return np.zeros((0, 0))
    frequencies, shapes = loaded_modes(beam, outboard)
    # K shape / frequency^2 is the loaded mass matrix times the shape, the inverse of the shapes.
    inverse = beam.stiffness @ shapes / frequencies**2
    return 2.0 * ratio * inverse * frequencies @ inverse.T


def _carry(offset: Array) -> Array:
    """(6, 6) motion of a point at an offset from the motion of the origin: v + w x offset, w."""
    x, y, z = offset
    motion = np.eye(6)
    motion[:3, 3:] = [[0.0, z, -y], [-z, 0.0, x], [y, -x, 0.0]]
    return motion

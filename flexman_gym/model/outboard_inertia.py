"""Inertia of the rigid outboard arm at the tip of each link, at zero joint angles."""

from itertools import pairwise

import numpy as np

from flexman_gym.common.arrays import Array
from flexman_gym.model.beam import Beam
from flexman_gym.scene.arm import Arm
from flexman_gym.scene.inertia import offset_velocity_transform, spatial_inertia


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
        tip = offset_velocity_transform(np.array([arm.links[i].length, 0.0, 0.0]))
        total = tip.T @ inertia @ tip
        for mass, position in zip(beams[i].masses, beams[i].positions, strict=True):
            point = offset_velocity_transform(position)[:3]
            total += mass * point.T @ point
        total[3, 3] += beams[i].polar.sum()
        rotation = np.kron(np.eye(2), rotations[i])
        inertia = rotation @ total @ rotation.T
    return result

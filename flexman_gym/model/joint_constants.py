"""Constants of the kernels for joints and their motors: springs with knees, friction and torque ripple."""

from collections.abc import Iterable

import numpy as np

from flexman_gym.common.arrays import Array
from flexman_gym.scene.arm import Arm
from flexman_gym.scene.scene import ModelChoice

# fields of `layout.Constants` that are equal to fields or properties of joints
EQUAL_FIELDS = (
    "rotor_inertia", "rotor_damping", "coulomb_friction", "coulomb_rate", "static_excess", "stribeck_rate",
    "knee_width", "ripple_torque", "ripple_cycles", "ripple_phase",
)  # fmt: skip


def joint_constants(arm: Arm, choice: ModelChoice) -> dict[str, np.ndarray]:
    """Return the fields of `layout.Constants` for joints and their rotors, by name."""
    passive = np.array([joint.passive for joint in arm.joints])
    springs = [joint.stiffness is not None and choice.flexible_joints and not joint.passive for joint in arm.joints]
    motors = arm.n_joints + np.cumsum(springs) - 1
    fields = {name: np.array([getattr(joint, name) for joint in arm.joints]) for name in EQUAL_FIELDS}
    bent = [i for i, joint in enumerate(arm.joints) if springs[i] and joint.has_knees]
    counts = np.zeros(arm.n_joints, dtype=np.int64)
    counts[bent] = [1 + len(arm.joints[i].stiffness_pieces) for i in bent]
    values = np.array([(joint.stiffness or 0.0, joint.backlash or 0.0, joint.soft_stiffness) for joint in arm.joints])
    twists, shares = spring_knees(arm, bent, *values.T[:, None])
    return fields | {
        "motor": np.where(springs, motors, -1).astype(np.int64),
        "joint_stiffness": np.where(passive, 0.0, values[:, 0]),
        "joint_damping": np.array([joint.damping * (not joint.passive) for joint in arm.joints]),
        "passive": passive.astype(np.int64),
        "passive_stiffness": np.where(passive, values[:, 0], 0.0),
        "carried_inertia": fields["rotor_inertia"] * choice.spinning_rotors,
        "has_coulomb_friction": (fields["coulomb_friction"] > 0.0).astype(np.int64),
        "knee_start": np.append(0, np.cumsum(counts)),
        "knee_twist": twists[0],
        "knee_share": shares[0],
        "has_ripple": (fields["ripple_cycles"] > 0.0).astype(np.int64),
        "prescribed": np.zeros(arm.n_joints, dtype=np.int64),
        "rotating": np.zeros(1, dtype=np.int64),
    }


def spring_knees(arm: Arm, bent: Iterable[int], stiffness: Array, backlash: Array, soft: Array) -> tuple[Array, Array]:
    """Return the knees of the torque-twist curves of the joint springs of r arms, see `layout.Constants`.

    Args:
        arm: arm whose joints have the torques at the ends of the pieces.
        bent: indices of the joints with knees.
        stiffness: (r, n) stiffness beyond all knees, N m/rad.
        backlash: (r, n) rad.
        soft: (r, n) stiffness of the first of several pieces / stiffness.

    Returns:
        Twists of the knees (r, e), rad, and increases of the stiffness there / stiffness (r, e).
    """
    none = np.zeros((len(stiffness), 0))
    twists, shares = [none], [none]
    for i in bent:
        pieces = np.array([(0.0, 0.0), *arm.joints[i].stiffness_pieces, (0.0, 1.0)])
        factors = np.tile(pieces[1:, 1], (len(stiffness), 1))
        if len(pieces) > 2:
            factors[:, 0] = soft[:, i]
        lengths = np.diff(pieces[:-1, 0]) / (factors[:, :-1] * stiffness[:, i : i + 1])
        twists.append(np.cumsum(np.hstack([backlash[:, i : i + 1] / 2, lengths]), axis=1))
        shares.append(np.diff(factors, axis=1, prepend=0.0))
    return np.hstack(twists), np.hstack(shares)

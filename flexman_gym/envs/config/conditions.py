"""Conditions of a named environment for an arm of the user: payloads, friction and ripple in the same proportion."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from flexman_gym.envs.config.arm_settings import arm_facts, arm_torque_limits
from flexman_gym.envs.config.named_environments import NAMED_ENVIRONMENTS, condition_settings
from flexman_gym.scene.arm import Arm
from flexman_gym.scene.joint import Joint, Motor
from flexman_gym.scene.serialization import find_arm

GEAR_RATIO, TORQUE_CONSTANT = 128.0, 0.04  # 1, N m/A; of the motor of a joint without one, whose torque ripples
EMPTY_SHARE = 0.025  # usual payload of an arm that carries none / mass of its links
SPRINGS = ("joint_stiffness_factor", "joint_damping", "backlash", "soft_stiffness")
LINKS = ("link_stiffness_factor", "link_damping_factor", "gauge_gain_factor")
TORQUES = ("coulomb_friction", "static_friction")  # N m, in proportion to the torque limit
RATES = ("coulomb_rate", "stribeck_rate")  # rad/s, in proportion to the rate of slews


def condition_for_arm(id: str, condition: object, arm: Arm, torque_limit: Any = None) -> dict[str, Any]:
    """Return the settings of a condition for an arm whose links or joints differ from those of the named environment.

    Payloads keep their ratio to the usual payload: the payload of the arm of the user, or EMPTY_SHARE of the mass of
    its links if it carries none.
    Friction and torque ripple keep their share of the torque limits, at the rates of slews of the arm; joints that have
    friction keep their own. Gains follow from the arm.

    Args:
        id: id of the environment.
        condition: name of the condition.
        arm: arm of the user.
        torque_limit: setting of the environment; None for the limits of the joints.

    Raises:
        ValueError: for an unknown condition, and for an arm without torque limits.
    """
    settings, named = condition_settings(id, condition), NAMED_ENVIRONMENTS[id].arm
    settings.pop("gains", None)
    settings.pop("settings", None)
    limits = arm_torque_limits(arm, torque_limit)
    usual = [float(joint.torque_limit or 1.0) for joint in named.joints]
    torque = np.mean([limit for limit in limits if limit]) / np.mean(usual)
    rate = arm_facts(arm, limits).rate / arm_facts(named, usual).rate
    payload = usual_payload(arm) / NAMED_ENVIRONMENTS[id].usual_payload
    ratios = {"payload_mass": payload, "ripple_torque": torque} | dict.fromkeys(RATES, rate)
    if "randomisation" in settings:
        settings["randomisation"] = {
            name: [float(f"{ratios[name] * each:.6g}") for each in span] if name in ratios else span
            for name, span in settings["randomisation"].items()
            if name not in missing_ranges(arm)
        }
    settings["arm"] = arm
    if "arm" in (of_condition := condition_settings(id, condition)):
        changed = find_arm(of_condition["arm"])
        settings["arm"] = replace(arm, joints=_worn_joints(arm, limits, (named, changed, usual), rate))
    return settings


def missing_ranges(arm: Arm) -> tuple[str, ...]:
    """Return the names of ranges of springs and flexible links that an arm does not have."""
    springs = any(joint.stiffness is not None and not joint.passive for joint in arm.joints)
    flexible = any(link.flexible for link in arm.links)
    return (() if springs else SPRINGS) + (() if flexible else LINKS)


def usual_payload(arm: Arm) -> float:
    """Return the payload of an arm, kg; a share of the mass of its links if it carries none."""
    mass = arm.payload.mass if arm.payload else 0.0
    return mass or EMPTY_SHARE * sum(link.mass for link in arm.links)


def _worn_joints(
    arm: Arm, limits: Sequence[float], named: tuple[Arm, Arm, Sequence[float]], rate: float
) -> tuple[Joint, ...]:
    """Return the joints of an arm with the mean friction, backlash and ripple of the joints of a condition.

    named = (arm of the environment, arm of the condition, torque limits).
    """
    before, after, usual = named
    pairs = [*zip(before.joints, after.joints, strict=True)]
    names = (*TORQUES, *RATES, "viscous_friction", "backlash", "stiffness_pieces")
    fields = [name for name in names if any(getattr(a, name) != getattr(b, name) for a, b in pairs)]
    shares = {
        name: np.mean([(getattr(joint, name) or 0.0) / limit for joint, limit in zip(after.joints, usual, strict=True)])
        for name in fields
        if name in (*TORQUES, "viscous_friction")
    }
    rippling = [joint.motor.ripple_cycles for joint in after.joints if joint.motor and joint.motor.ripple_cycles]
    joints = []
    for i, (joint, limit) in enumerate(zip(arm.joints, limits, strict=True)):
        if joint.passive:
            joints.append(joint)
            continue
        own: dict[str, Any] = {}
        missing = [name for name in shares if not getattr(joint, name)]
        own |= {name: float(shares[name] * limit) / (rate if name == "viscous_friction" else 1.0) for name in missing}
        if "coulomb_friction" in own:
            own |= {name: rate * getattr(after.joints[0], name) for name in fields if name in RATES}
        if joint.stiffness is not None:
            own |= {"backlash": after.joints[0].backlash} if "backlash" in fields and joint.backlash is None else {}
            if "stiffness_pieces" in fields and not joint.stiffness_pieces:
                share = after.joints[0].stiffness_pieces[0][0] / usual[0]
                own["stiffness_pieces"] = ((float(share * limit), after.joints[0].stiffness_pieces[0][1]),)
        if rippling and joint.rotor_inertia > 0.0:
            own["motor"] = _rippling_motor(joint, rippling[i % len(rippling)])
        joints.append(replace(joint, **own))
    return tuple(joints)


def _rippling_motor(joint: Joint, cycles: float) -> Motor:
    """Return the motor of a joint with a number of cycles of its torque ripple in a turn of the joint."""
    if joint.motor is not None:
        return replace(joint.motor, ripple_cycles=joint.motor.ripple_cycles or cycles)
    return Motor(GEAR_RATIO, TORQUE_CONSTANT, joint.rotor_inertia / GEAR_RATIO**2, ripple_cycles=cycles)

"""Scene: descriptions of an arm, its drive and its initial state, and their files."""

from typing import TYPE_CHECKING

from flexman_gym.common.lazy import lazy_names

if TYPE_CHECKING:
    from flexman_gym.scene import catalog
    from flexman_gym.scene.arm import Arm
    from flexman_gym.scene.joint import Joint, Motor
    from flexman_gym.scene.link import Link, NonUniformLink
    from flexman_gym.scene.rigid_body import LumpedMass, Payload
    from flexman_gym.scene.scene import Initial, ModelChoice, Scene
    from flexman_gym.scene.signals import (
        ConstantTorque,
        SampledAngles,
        SampledSignal,
        SampledTorque,
        Signal,
        SineTorque,
    )

__all__ = [
    "Arm",
    "ConstantTorque",
    "Initial",
    "Joint",
    "Link",
    "LumpedMass",
    "ModelChoice",
    "Motor",
    "NonUniformLink",
    "Payload",
    "SampledAngles",
    "SampledSignal",
    "SampledTorque",
    "Scene",
    "Signal",
    "SineTorque",
    "catalog",
]

__getattr__, __dir__ = lazy_names(__name__)

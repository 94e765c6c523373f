"""Scene: what a person describes, an arm and how it is driven, and the files that keep it."""

from flexman_gym.scene import catalog
from flexman_gym.scene.arm import Arm, Joint, Link, NonUniformLink, Payload
from flexman_gym.scene.choice import ModelChoice
from flexman_gym.scene.drive import ConstantTorque, Signal, SineTorque
from flexman_gym.scene.scene import Initial, Scene

__all__ = [
    "Arm",
    "ConstantTorque",
    "Initial",
    "Joint",
    "Link",
    "ModelChoice",
    "NonUniformLink",
    "Payload",
    "Scene",
    "Signal",
    "SineTorque",
    "catalog",
]

"""Scene: an arm and its drive, as a person describes them, and the files that keep them."""

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

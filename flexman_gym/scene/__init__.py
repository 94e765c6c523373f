"""Scene: an arm and its drive, as a person describes them, and the files that keep them."""

from flexman_gym.scene import catalog
from flexman_gym.scene.arm import Arm, Payload
from flexman_gym.scene.choice import ModelChoice
from flexman_gym.scene.drive import ConstantTorque, Signal, SineTorque
from flexman_gym.scene.joint import Joint
from flexman_gym.scene.link import Link, NonUniformLink
from flexman_gym.scene.lumped import LumpedMass
from flexman_gym.scene.motor import Motor
from flexman_gym.scene.samples import SampledAngles, SampledSignal, SampledTorque
from flexman_gym.scene.scene import Initial, Scene

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

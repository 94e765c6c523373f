"""flexman_gym: robot arms whose links and joints bend, as Gymnasium environments."""

from flexman_gym import catalog
from flexman_gym.arm import Arm, Joint, Link, Payload
from flexman_gym.dynamics import acceleration, frequencies, mass_matrix
from flexman_gym.methods import METHODS
from flexman_gym.model import Model, build_model
from flexman_gym.scene import ConstantTorque, Initial, ModelChoice, Scene, SineTorque
from flexman_gym.simulator import Simulator, Trajectory, simulate

__all__ = [
    "METHODS",
    "Arm",
    "ConstantTorque",
    "Initial",
    "Joint",
    "Link",
    "Model",
    "ModelChoice",
    "Payload",
    "Scene",
    "Simulator",
    "SineTorque",
    "Trajectory",
    "acceleration",
    "build_model",
    "catalog",
    "frequencies",
    "mass_matrix",
    "simulate",
]

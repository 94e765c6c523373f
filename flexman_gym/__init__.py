"""flexman_gym: robot arms whose links and joints bend, as Gymnasium environments."""

from gymnasium.envs.registration import register

from flexman_gym import catalog
from flexman_gym.arm import Arm, Joint, Link, NonUniformLink, Payload
from flexman_gym.drive import ConstantTorque, Signal, SineTorque
from flexman_gym.dynamics import (
    acceleration,
    frequencies,
    inverse_dynamics,
    linearize,
    mass_matrix,
    tip_acceleration,
)
from flexman_gym.fidelity import Choice, choose_model
from flexman_gym.methods import METHODS, generalised_alpha
from flexman_gym.model import Model, build_model
from flexman_gym.randomisation import Randomisation
from flexman_gym.scene import Initial, ModelChoice, Scene
from flexman_gym.sensors import Limits
from flexman_gym.simulator import Simulator, simulate
from flexman_gym.strain import curvature, strain
from flexman_gym.tasks import Slew
from flexman_gym.trajectory import Trajectory

__all__ = [
    "METHODS",
    "Arm",
    "Choice",
    "ConstantTorque",
    "Initial",
    "Joint",
    "Limits",
    "Link",
    "Model",
    "ModelChoice",
    "NonUniformLink",
    "Payload",
    "Randomisation",
    "Scene",
    "Signal",
    "Simulator",
    "SineTorque",
    "Slew",
    "Trajectory",
    "acceleration",
    "build_model",
    "catalog",
    "choose_model",
    "curvature",
    "frequencies",
    "generalised_alpha",
    "inverse_dynamics",
    "linearize",
    "mass_matrix",
    "simulate",
    "strain",
    "tip_acceleration",
]

register(
    id="FlexRRR-v0",
    entry_point="flexman_gym.envs:FlexManEnv",
    vector_entry_point="flexman_gym.vector_env:FlexManVectorEnv",
    max_episode_steps=500,
)

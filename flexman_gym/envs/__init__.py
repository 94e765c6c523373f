"""Environments: arms in episodes behind Gymnasium's interfaces, one or many."""

from flexman_gym.envs.env import FlexManEnv
from flexman_gym.envs.randomisation import Randomisation
from flexman_gym.envs.sensors.full import Limits
from flexman_gym.envs.tasks.slew import Slew
from flexman_gym.envs.vector_env import FlexManVectorEnv

__all__ = ["FlexManEnv", "FlexManVectorEnv", "Limits", "Randomisation", "Slew"]

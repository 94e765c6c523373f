"""Gymnasium environments of flexible robot arms, single and vectorised."""

from typing import TYPE_CHECKING

from flexman_gym.common.lazy import lazy_names

if TYPE_CHECKING:
    from flexman_gym.envs.config.named_environments import NAMED_ENVIRONMENTS
    from flexman_gym.envs.config.randomisation import Randomisation
    from flexman_gym.envs.env import FlexManEnv
    from flexman_gym.envs.limits import Limits
    from flexman_gym.envs.tasks import Slew
    from flexman_gym.envs.vector_env import FlexManVectorEnv

__all__ = ["NAMED_ENVIRONMENTS", "FlexManEnv", "FlexManVectorEnv", "Limits", "Randomisation", "Slew"]

__getattr__, __dir__ = lazy_names(__name__)

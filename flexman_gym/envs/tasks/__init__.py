"""Tasks: where episodes start, what their goals are and what a step is worth."""

from flexman_gym.envs.tasks.slew import Slew

__all__ = ["Slew"]

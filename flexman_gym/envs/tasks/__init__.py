"""Tasks: where episodes start, what their goals are and what a step is worth."""

from flexman_gym.envs.tasks.slew import Slew
from flexman_gym.envs.tasks.task import Goal, Task

__all__ = ["Goal", "Slew", "Task"]

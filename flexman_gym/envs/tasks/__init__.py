"""Tasks: where episodes start, what their goals are and what a step is worth."""

from flexman_gym.envs.tasks.slew import Slew
from flexman_gym.envs.tasks.task import Goal, Task

TASKS: dict[str, type[Slew]] = {"slew": Slew}

__all__ = ["TASKS", "Goal", "Slew", "Task"]

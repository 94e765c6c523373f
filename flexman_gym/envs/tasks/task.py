"""Task protocol: start, goal, observed goal and reward of an episode."""

from collections.abc import Mapping, Sequence
from typing import NamedTuple, Protocol, runtime_checkable

import numpy as np

from flexman_gym.common.arrays import Array
from flexman_gym.envs.sensors.sensor import Sensor
from flexman_gym.envs.view import Number, View

TASK_MEMBERS = ("sensors", "moves", "draw", "goal", "reward_terms", "info")
OPTIONAL_TASK_MEMBERS = ("metrics", "disturbances")
MOVING_METRICS = ("rms_error",)  # metrics of tasks with a moving goal or a goal at the start


class Goal(NamedTuple):
    """Goals of r arms: target of the tip (r, 3) in the base frame, m, and motor angles (r, n), rad."""

    target: Array
    angles: Array


@runtime_checkable
class Task(Protocol):
    """Protocol of a task; a class with these members needs no base class.

    A task stores nothing about an arm: the parameters of an episode are in its plan. Its results for one arm must not
    depend on the other arms, to the last bit. Lengths should be fractions of `view.reach`, so that the task suits arms
    of any size.

    Two further attributes are optional: `metrics`, the names of the `evaluation.METRICS` reported for the task in
    addition to the general ones (default: those of a slew), and `disturbances`, a dict of arguments of `Randomisation`.
    Misspelt names are refused.

    Attributes:
        sensors: sensors of the goal, added to those of the environment; () for none.
        moves: True if the goal changes during an episode; `goal` is then called in every control period.
    """

    @property
    def sensors(self) -> Sequence[Sensor]:
        """Sensors of the goal, added to those of the environment."""
        ...

    @property
    def moves(self) -> bool:
        """True if the goal changes during an episode."""
        ...

    def draw(self, random: np.random.Generator, view: View) -> dict[str, Array]:
        """Draw the plan of one episode.

        Args:
            random: generator of the episode.
            view: view of the arms, for constants such as the reach.

        Returns:
            "start", joint angles (n,) in rad, and any further arrays needed by `goal`. `reset(options=...)` may set
            each entry by its name, for all arms or with a leading axis for each.
        """
        ...

    def goal(self, plan: Mapping[str, Array], time: Array, view: View) -> Goal:
        """Return the goals of episodes with plans (r, ...), by name, at times (r,) s after their start."""
        ...

    def reward_terms(self, view: View) -> dict[str, Number]:
        """Return the named terms of the reward of the last step; their sum is the reward.

        Args:
            view: view of all arms, or of a single arm without the axis of the arms; use `...`, `axis=-1` and the
                functions of NumPy.
        """
        ...

    def info(self, view: View) -> dict[str, Number]:
        """Return the task's own entries of `info`; {} for none."""
        ...

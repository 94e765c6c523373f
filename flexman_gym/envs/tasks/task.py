"""Task protocol: start, goal, reward and sensors that observe the goal."""

from collections.abc import Mapping, Sequence
from typing import NamedTuple, Protocol, runtime_checkable

import numpy as np

from flexman_gym.common.arrays import Array
from flexman_gym.envs.sensors.sensor import Sensor
from flexman_gym.envs.view import Number, View

TASK_MEMBERS = ("sensors", "moves", "draw", "goal", "reward_terms", "info")
OPTIONAL_TASK_MEMBERS = ("metrics", "disturbances")
TRACKING_METRICS = ("rms_error",)  # metrics of tasks whose target moves, or equals the initial tip position


class Goal(NamedTuple):
    """Goals of r arms: targets of the tips (r, 3) in the base frame, m, and goals of the motor angles (r, n), rad."""

    target: Array
    angles: Array


@runtime_checkable
class Task(Protocol):
    """Protocol of a task; a class with these members needs no base class.

    A task has no state: `draw` returns the parameters of an episode, and the environment stores them. The results for
    an arm must not depend on other arms, to the last bit. Lengths should be fractions of `view.reach`, and times
    fractions of `view.slew_time`, so that the task suits arms of any size.

    Two further attributes are optional. `metrics` names the metrics in `evaluation.METRICS` reported for the task in
    addition to the general metrics; the default is the settling time and the final error. `disturbances` is a dict of
    arguments of `Randomisation`. Misspelt names raise ValueError.

    Attributes:
        sensors: sensors that observe the goal, added to the sensors of the environment; () for no sensors.
        moves: True if the goal changes during an episode; `goal` is then called in every control period.
    """

    @property
    def sensors(self) -> Sequence[Sensor]:
        """Sensors that observe the goal, added to the sensors of the environment."""
        ...

    @property
    def moves(self) -> bool:
        """True if the goal changes during an episode."""
        ...

    def draw(self, random: np.random.Generator, view: View) -> dict[str, Array]:
        """Draw the parameters of one episode.

        Args:
            random: random generator of the arm.
            view: view of the arms, for constants such as the reach.

        Returns:
            Parameters by name: "start", motor angles (n,) in rad, and any further arrays needed by `goal`. The options
            of `reset` may replace each of them.
        """
        ...

    def goal(self, parameters: Mapping[str, Array], time: Array, view: View) -> Goal:
        """Return the goals of r episodes.

        Args:
            parameters: name -> (r, ...) parameters of the episodes, from `draw`.
            time: (r,) times since the starts of the episodes, s.
            view: view of the arms, for constants such as the reach.
        """
        ...

    def reward_terms(self, view: View) -> dict[str, Number]:
        """Return the terms of the reward of the last control period by name; the reward is their sum.

        Args:
            view: view of all arms, or of a single arm without the axis of the arms; index with `...` and
                `axis=-1`, so that the same expression of NumPy serves both.
        """
        ...

    def info(self, view: View) -> dict[str, Number]:
        """Return additional entries of `info`; {} for no entries."""
        ...

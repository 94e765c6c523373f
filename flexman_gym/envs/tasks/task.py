"""Task: where an episode starts, where its goal is, what of the goal is observed and what a step is worth."""

from collections.abc import Mapping, Sequence
from typing import NamedTuple, Protocol, runtime_checkable

import numpy as np

from flexman_gym.common.arrays import Array
from flexman_gym.envs.sensors.sensor import Sensor
from flexman_gym.envs.view import Number, View

TASK_MEMBERS = ("sensors", "moves", "draw", "goal", "reward_terms", "info")  # of a task
OPTIONAL_TASK_MEMBERS = ("figures", "disturbances")
MOVING_METRICS = ("rms_error",)  # figures of a task whose goal moves, or at whose goal the arm is to stay


class Goal(NamedTuple):
    """Where arms should be: the target of the tip, (r, 3) m in the base frame, and the motor angles, (r, n) rad."""

    target: Array
    angles: Array


@runtime_checkable
class Task(Protocol):
    """A task. A class with these members is one; it needs no base class.

    A task keeps nothing of one arm: what describes an episode is in its plan. Lengths should be parts of `view.reach`,
    so that a task suits arms of any size. What it says of an arm must not depend on the others, to the last bit.

    Attributes:
        sensors: what of the goal is observed beside the sensors of the environment; () for nothing.
        moves: whether the goal changes during an episode; `goal` is then asked before every observation.

    Two further attributes are optional, and a misspelt one is refused: `figures`, names of `evaluation.METRICS` that
    matter beside those of every task, those of a slew without it; and `disturbances`, a dict of arguments of
    `Randomisation`.
    """

    @property
    def sensors(self) -> Sequence[Sensor]:
        """See the class."""
        ...

    @property
    def moves(self) -> bool:
        """See the class."""
        ...

    def draw(self, random: np.random.Generator, view: View) -> dict[str, Array]:
        """The plan of one episode: "start", joint angles (n,) rad, and whatever else `goal` needs.

        `reset(options=...)` may set each entry, by its name, for all arms or with a leading axis for each.
        """
        ...

    def goal(self, plan: Mapping[str, Array], time: Array, view: View) -> Goal:
        """The goals of episodes with these plans, name -> (r, ...), at times (r,) s after their start."""
        ...

    def reward_terms(self, view: View) -> dict[str, Number]:
        """What the step just made is worth, named terms whose sum is the reward.

        The view is that of all arms, or that of an arm alone without the axis of the arms: use `...` and `axis=-1`, and
        NumPy's functions.
        """
        ...

    def info(self, view: View) -> dict[str, Number]:
        """What goes to `info` beside what every environment says; {} for nothing."""
        ...


def goal_path(task: Task, plan: Mapping[str, Array], periods: int, view: View) -> Array:
    """Gives the postures (r, T + 1, n) rad of goals for T control periods of episodes with plans, name -> (r, ...)."""
    count, times = len(next(iter(plan.values()))), view.control_period * np.arange(periods + 1.0)
    alike = [{name: np.repeat(each[i : i + 1], len(times), 0) for name, each in plan.items()} for i in range(count)]
    return np.array([task.goal(each, times, view).angles for each in alike])

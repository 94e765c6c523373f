"""Hold: the task to keep the tip still while it is pushed, loaded and shaken."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from flexman_gym.common.arrays import Array, Vector
from flexman_gym.common.checks import non_negative, positive, set_fields, vector
from flexman_gym.envs.sensors.sensor import Sensor
from flexman_gym.envs.tasks.rewards import distance_reward
from flexman_gym.envs.tasks.task import MOVING_METRICS, Goal
from flexman_gym.envs.view import Number, View


@dataclass(frozen=True)
class Hold:
    """Hold the tip still under impulses, loads that change and a base that sways.

    Description
        The arm rests at a posture when it is disturbed: by impulses on the tip, by a force on the tip that changes at
        random times and stays until the next change, and by a base that swings to and fro. The tip is to stay where it
        was. The motors are free without torques, so that an arm that does nothing drifts away.

    Actions
        As of every environment: motor torques as parts of the torque limits.

    Observations
        As the sensors say; the task itself adds nothing. The disturbances are not seen.

    Reward
        At most 1 a control period, the sum of these terms:
            distance       1 - ln(1 + (e^2 + (0.1 s v)^2) / n^2) / ln(1 + (f / n)^2); e is the tip error, v the speed of
                           the tip, n = R / 425 (20 mm) and f = R / 1.7 (5 m) for a reach R, in brackets for 8.5 m
            failure        -failure_penalty when the step ended the episode by a limit or a divergence

    Start
        At rest, at motor angles drawn uniformly from +-start. The target is where the tip is then. The option
        "start" of a reset sets the angles.

    End
        Truncated after the horizon of the environment; terminated by a failure.

    Arguments
        Sizes of the disturbances are ranges (low, high) from which each is drawn uniformly; a randomisation may change
        or switch off each of them by its name.

    Version history
        v0: first version.

    Attributes:
        start: rad.
        impulse: N s, each a force during one control period.
        load: N.
        sway: m/s^2, the amplitude of the base's acceleration; its frequency is between 0.3 and 3 times that of the
            arm's first mode.
        gap: mean time between two impulses, and two changes of load, s.
        failure_penalty: reward lost by a failure, >= 0.

    Raises:
        ValueError: one line with field, value and what is allowed.
    """

    start: float = 0.8
    impulse: Vector = (2.0, 10.0)
    load: Vector = (0.0, 10.0)
    sway: Vector = (0.0, 0.1)
    gap: float = 3.0
    failure_penalty: float = 10.0
    sensors: ClassVar[tuple[Sensor, ...]] = ()
    moves: ClassVar[bool] = False
    figures: ClassVar[tuple[str, ...]] = MOVING_METRICS

    def __post_init__(self) -> None:
        set_fields(
            self,
            start=non_negative("Hold.start", self.start, "rad"),
            gap=positive("Hold.gap", self.gap, "s"),
            failure_penalty=non_negative("Hold.failure_penalty", self.failure_penalty),
        )
        for name, unit in (("impulse", "N s"), ("load", "N"), ("sway", "m/s^2")):
            set_fields(self, **{name: tuple(vector(f"Hold.{name}", getattr(self, name), 2, unit))})

    @property
    def disturbances(self) -> dict[str, Any]:
        """Arguments of `Randomisation`, which belong to the task."""
        return {
            "tip_impulse": self.impulse, "tip_load": self.load, "base_sway": self.sway, "impulse_gap": self.gap,
        }  # fmt: skip

    def draw(self, random: np.random.Generator, view: View) -> dict[str, Array]:
        """The posture (n,) rad of one episode."""
        return {"start": random.uniform(-self.start, self.start, view.n_joints)}

    def goal(self, plan: Mapping[str, Array], time: Array, view: View) -> Goal:
        """The tip of the arm at rest at its start."""
        return Goal(view.rest_tips(plan["start"]), plan["start"])

    def reward_terms(self, view: View) -> dict[str, Number]:
        """Terms of the reward, see the class."""
        return {
            "distance": distance_reward(view, view.tip_velocity),
            "failure": 0.0 - self.failure_penalty * view.failed,
        }

    def info(self, view: View) -> dict[str, Number]:
        """Nothing beside what every environment says."""
        return {}

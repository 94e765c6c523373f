"""Hold: keep the tip in place under disturbances."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from flexman_gym.common.arrays import Array, Vector
from flexman_gym.common.checks import non_negative, positive, set_fields, vector
from flexman_gym.envs.sensors.sensor import Sensor
from flexman_gym.envs.tasks.rewards import distance_reward
from flexman_gym.envs.tasks.task import TRACKING_METRICS, Goal
from flexman_gym.envs.view import Number, View


@dataclass(frozen=True)
class Hold:
    """Hold the tip in place under impulses, changing loads and base motion.

    Description
        The arm rests at a posture when the disturbances start: impulses at the tip, a force at the tip that changes at
        random times and is constant in between, and a sinusoidal motion of the base. The tip should stay at its initial
        position. The motors have no brakes, so that the arm drifts away under zero torque.

    Actions
        As in every environment: motor torques as fractions of the torque limits.

    Observations
        Readings of the sensors of the environment; the task adds none. The disturbances are not observed.

    Reward
        At most 1 per control period, the sum of these terms:
            distance       1 - ln(1 + (e^2 + (T v / 32)^2) / n^2) / ln(1 + (f / n)^2) with tip error e, speed v of
                           the tip, slew time T of the environment (3.2 s), n = R / 425 and f = R / 1.7 for a reach R
                           (20 mm and 5 m for R = 8.5 m)
            failure        -failure_penalty if the arm exceeded a limit or its simulation diverged, else 0

    Start
        At rest, at motor angles drawn uniformly from [-start, start], around the middle of an `angle_range`. The target
        is the initial position of the tip. The option "start" of a reset sets the angles.

    End
        Truncated after the horizon of the environment; terminated by a failure.

    Arguments
        Magnitudes of disturbances are drawn uniformly from ranges (low, high). The ranges tip_impulse, tip_load and
        base_sway of the setting randomisation override the ranges of the task; None disables a disturbance.

    Version history
        v0: first version.

    Attributes:
        start: largest initial motor angle, rad.
        impulse: range of the impulses at the tip, N s; each is a force during one control period.
        load: range of the changing force at the tip, N.
        sway: range of the amplitude of the base acceleration, m/s^2; its frequency is 0.3 to 3 times the first natural
            frequency of the arm with locked motors.
        gap: mean time between two impulses, and between two changes of the load, s.
        failure_penalty: penalty subtracted from the reward after a failure, >= 0.
    """

    start: float = 0.8
    impulse: Vector = (2.0, 10.0)
    load: Vector = (0.0, 10.0)
    sway: Vector = (0.0, 0.1)
    gap: float = 3.0
    failure_penalty: float = 10.0
    sensors: ClassVar[tuple[Sensor, ...]] = ()
    moves: ClassVar[bool] = False
    metrics: ClassVar[tuple[str, ...]] = TRACKING_METRICS

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
        """Disturbances of the task, as arguments of `Randomisation`."""
        return {
            "tip_impulse": self.impulse, "tip_load": self.load, "base_sway": self.sway, "impulse_gap": self.gap,
        }  # fmt: skip

    def draw(self, random: np.random.Generator, view: View) -> dict[str, Array]:
        """Draw the start of one episode, motor angles (n,) in rad."""
        return {"start": view.postures.draw_starts(random, self.start)}

    def goal(self, parameters: Mapping[str, Array], time: Array, view: View) -> Goal:
        """Return the initial positions of the tips and the initial motor angles as goals."""
        return Goal(view.rest_tips(parameters["start"]), parameters["start"])

    def reward_terms(self, view: View) -> dict[str, Number]:
        """Return the terms of the reward, see the class."""
        return {
            "distance": distance_reward(view, view.tip_velocity),
            "failure": 0.0 - self.failure_penalty * view.failed,
        }

    def info(self, view: View) -> dict[str, Number]:
        """Return no additional entries."""
        return {}

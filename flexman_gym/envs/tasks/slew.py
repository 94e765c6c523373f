"""Slew: the task to bring the tip to a target and to keep it still there."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from flexman_gym.common.arrays import Array
from flexman_gym.common.checks import non_negative, one_of, positive, set_fields, whole_number
from flexman_gym.envs.sensors.sensor import Sensor
from flexman_gym.envs.tasks.rewards import distance_reward
from flexman_gym.envs.tasks.task import Goal
from flexman_gym.envs.view import Number, View

BELL_WIDTHS = (2.0 / 8.5, 0.4 / 8.5, 0.08 / 8.5)  # of the reach: three bells that reward closeness
# weights, and lengths in reaches
CLOSENESS = {"far": (0.1, 0.6 / 8.5), "near": (0.25, 0.15 / 8.5), "at_goal": (0.65, 0.03 / 8.5)}
SLEW_SEED, MAX_SLEWS = 8_500, 100_000
VIBRATION_SCALE = 0.3 / 8.5  # reaches a second: tip vibration that halves the reward for calm


@dataclass(frozen=True)
class Slew:
    """Slew and settle: bring the tip to a target and keep it still there.

    Description
        The arm is at rest when a target appears. Its tip is to come there quickly and to stop vibrating.

    Actions
        As of every environment: motor torques as parts of the torque limits.

    Observations
        As the sensors say; the task itself adds nothing.

    Reward
        In [0, 1] a control period, less a penalty for a failure: the sum of these terms. R is the reach of the arm, in
        brackets for 8.5 m:
            tip_error      0.7 times the mean over the widths w of 1 / (1 + (tip error / w)^2); w is R times 0.24, 0.047
                           and 0.0094 (2, 0.4 and 0.08 m)
            tip_vibration  0.2 / (1 + (tip vibration / (0.035 R / s))^2)  (0.3 m/s)
            effort         0.1 (1 - mean of the squared actions)
            failure        -failure_penalty when the step ended the episode by a limit or a divergence
        With reward="distance" the terms tip_error and tip_vibration and effort give way to one with slope at every
        scale, of the tip error e and the speed v of the tip:
            distance       1 - ln(1 + (e^2 + (0.1 s v)^2) / n^2) / ln(1 + (f / n)^2), n = R / 425 (20 mm), f = R / 1.7
                           (5 m)
        It is 1 at rest on the target, 0 at a distance f and below zero beyond.
        With reward="exponential" it is a sum, in [0, 1], over three lengths l of weights times exp(-e / l), for
        policies that shape the motion of a controller which stops anyway:
            far, near, at_goal    0.1, 0.25 and 0.65 for l = R times 0.071, 0.018 and 0.0035 (0.6, 0.15 and 0.03 m)

    Start
        At rest at motor angles drawn uniformly from +-start, undeformed but for the weight of the arm. The target is
        where the tip of the resting arm would be at a posture drawn uniformly from +-slew around the start, so that it
        can be reached. The options "start" and "goal_angles" of a reset set both, or "start_tip" and "goal_tip" by
        places of the tip, see `FlexManEnv`.

    End
        Truncated after the horizon of the environment; terminated by a failure.

    Arguments
        Those below.

    Version history
        v0: first version.

    Attributes:
        start: largest angle of a motor at the start, rad.
        slew: largest change of an angle from the start to the goal, rad.
        reward: "bells", "distance" or "exponential".
        pairs: how many starts with their goals there are, of which an episode draws one; 0 for any. Controllers that
            plan remember those that they have seen, which makes training with few of them quicker.
        failure_penalty: reward lost by a failure, >= 0.

    Raises:
        ValueError: one line with field, value and what is allowed.
    """

    start: float = 0.8
    slew: float = 0.8
    failure_penalty: float = 10.0
    reward: str = "bells"
    pairs: int = 0
    sensors: ClassVar[tuple[Sensor, ...]] = ()
    moves: ClassVar[bool] = False

    def __post_init__(self) -> None:
        set_fields(
            self,
            start=non_negative("Slew.start", self.start, "rad"),
            slew=positive("Slew.slew", self.slew, "rad"),
            failure_penalty=non_negative("Slew.failure_penalty", self.failure_penalty),
            reward=one_of("Slew.reward", self.reward, ("bells", "distance", "exponential")),
            pairs=whole_number("Slew.pairs", self.pairs, 0, MAX_SLEWS),
        )

    def draw(self, random: np.random.Generator, view: View) -> dict[str, Array]:
        """Start and goal postures (n,) rad of one episode."""
        if self.pairs:
            random = np.random.default_rng([SLEW_SEED, int(random.integers(self.pairs))])
        start = random.uniform(-self.start, self.start, view.n_joints)
        return {"start": start, "goal_angles": start + random.uniform(-self.slew, self.slew, view.n_joints)}

    def goal(self, plan: Mapping[str, Array], time: Array, view: View) -> Goal:
        """The tip of the rigid arm at the goal posture."""
        return Goal(view.rest_tips(plan["goal_angles"]), plan["goal_angles"])

    def reward_terms(self, view: View) -> dict[str, Number]:
        """Terms of the reward, see the class."""
        failure = 0.0 - self.failure_penalty * view.failed
        if self.reward == "distance":
            return {"distance": distance_reward(view, view.tip_velocity), "failure": failure}
        if self.reward == "exponential":
            terms = {name: weight * np.exp(-view.tip_error / (length * view.reach))
                     for name, (weight, length) in CLOSENESS.items()}  # fmt: skip
            return {**terms, "failure": failure}
        square, vibration, calm = (
            view.tip_error * view.tip_error,
            view.tip_vibration,
            (VIBRATION_SCALE * view.reach) ** 2,
        )
        near = [width**2 / (width**2 + square) for width in (part * view.reach for part in BELL_WIDTHS)]
        return {
            "tip_error": 0.7 / 3.0 * (near[0] + near[1] + near[2]),
            "tip_vibration": 0.2 * calm / (calm + vibration * vibration),
            "effort": 0.1 * (1.0 - view.effort),
            "failure": failure,
        }

    def info(self, view: View) -> dict[str, Number]:
        """Nothing beside what every environment says."""
        return {}

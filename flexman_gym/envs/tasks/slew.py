"""Slew: move the tip to a target and stop it there."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from flexman_gym.common.arrays import Array
from flexman_gym.common.checks import non_negative, one_of, positive, set_fields, whole_number
from flexman_gym.envs.sensors.sensor import Sensor
from flexman_gym.envs.tasks.rewards import REWARDS
from flexman_gym.envs.tasks.task import Goal
from flexman_gym.envs.view import Number, View

PAIRS_SEED, MAX_PAIRS = 8_500, 100_000  # seed of the pairs of start and goal, and their largest number


@dataclass(frozen=True)
class Slew:
    """Slew and settle: move the tip to a target and stop it there without vibration.

    Description
        The arm is at rest when a target appears. The tip should reach it quickly and stop vibrating.

    Actions
        As in every environment: motor torques as fractions of the torque limits.

    Observations
        Readings of the sensors of the environment; the task adds none.

    Reward
        The reward of a control period is the sum of the following terms: from 0 to 1, minus a penalty after a failure.
        R is the reach of the arm, T the slew time of the environment, e the tip error and v the speed of the tip;
        values in brackets are for R = 8.5 m and T = 3.2 s.
            tip_error      0.7 times the mean of 1 / (1 + (e / w)^2) over three widths w, which are 0.24 R, 0.047 R and
                           0.0094 R (2, 0.4 and 0.08 m)
            tip_vibration  0.2 / (1 + (tip vibration / (0.035 R / s))^2)  (0.3 m/s)
            effort         0.1 (1 - mean square of the commanded torques as fractions of their limits)
            failure        -failure_penalty if the arm exceeded a limit or its simulation diverged, else 0
        With reward="distance" one term replaces tip_error, tip_vibration and effort. It changes noticeably at errors of
        metres and of millimetres:
            distance       1 - ln(1 + (e^2 + (T v / 32)^2) / n^2) / ln(1 + (f / n)^2), T / 32 (0.1 s), n = R / 425
                           (20 mm), f = R / 1.7 (5 m)
        It is 1 at rest on the target, 0 at rest at the distance f, and negative for larger distances.
        With reward="exponential" three terms replace them, weights times exp(-e / l) for three lengths l. This reward
        suits policies for reference shaping, where the base controller stops the arm:
            far, near, at_goal    weights 0.1, 0.25 and 0.65; l = 0.071 R, 0.018 R and 0.0035 R (0.6, 0.15 and 0.03 m)

    Start
        At rest at motor angles drawn uniformly from [-start, start], deformed only by gravity, as the nominal arm: with
        a drawn payload or stiffness it is not in equilibrium and begins to sway. The goal posture differs from the
        start by angles drawn uniformly from [-slew, slew]. Angles of joints with an `angle_range` are drawn around its
        middle, and start and goal are within it. The target is the tip position of the arm at rest at the goal posture
        and can therefore always be reached. The options "start" and "goal_angles" of a reset set both postures;
        "start_tip" and "goal_tip" set them by tip positions, see `FlexManEnv`.

    End
        Truncated after the horizon of the environment; terminated by a failure.

    Arguments
        The attributes below.

    Version history
        v0: first version.

    Attributes:
        start: largest initial motor angle, rad.
        slew: largest change of a motor angle from the start to the goal, rad.
        failure_penalty: penalty subtracted from the reward after a failure, >= 0.
        reward: "bells" (tip_error, tip_vibration and effort), "distance" or "exponential".
        pairs: number of different pairs of start and goal, from which each episode draws one; 0 for no restriction.
            Base controllers store the reference trajectories of known pairs, so that few pairs speed up training.

    Examples:
        >>> import gymnasium as gym
        >>> env = gym.make("FlexOne-v0", task=fm.Slew(slew=0.5, reward="distance"))
        >>> _, info = env.reset(seed=0)
        >>> list(info["reward_terms"])
        ['distance', 'failure']
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
            pairs=whole_number("Slew.pairs", self.pairs, 0, MAX_PAIRS),
        )

    def draw(self, random: np.random.Generator, view: View) -> dict[str, Array]:
        """Draw the start and goal postures (n,), rad, of one episode."""
        if self.pairs:
            random = np.random.default_rng([PAIRS_SEED, int(random.integers(self.pairs))])
        start = view.postures.draw_starts(random, self.start)
        return {"start": start, "goal_angles": start + view.postures.draw_changes(random, start, self.slew)}

    def goal(self, parameters: Mapping[str, Array], time: Array, view: View) -> Goal:
        """Return the goal postures, and the tip positions of the arm at rest at them."""
        return Goal(view.rest_tips(parameters["goal_angles"]), parameters["goal_angles"])

    def reward_terms(self, view: View) -> dict[str, Number]:
        """Return the terms of the reward, see the class."""
        velocity = view.tip_velocity if self.reward == "distance" else None
        failure = 0.0 - self.failure_penalty * view.failed
        return {**REWARDS[self.reward].terms(view, velocity), "failure": failure}

    def info(self, view: View) -> dict[str, Number]:
        """Return no additional entries."""
        return {}

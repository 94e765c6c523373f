"""Tasks: where an episode starts, what its goal is and what a step is worth."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from flexman_gym.arrays import Array
from flexman_gym.checks import non_negative, positive, store

Number = Any  # a float or an array (b,): only arithmetic is done with it
WIDTHS = (2.0, 0.4, 0.08)  # m, of the three bells that reward closeness
CALM = 0.3  # m/s of tip vibration that halves the reward for calm


@dataclass(frozen=True)
class Slew:
    """Slew and settle: bring the tip to a target and keep it still there.

    An episode starts at rest, undeformed, at joint angles drawn uniformly from +-start. The target is where the tip of
    the undeformed arm would be at a posture drawn uniformly from +-slew around the start, so that it can be reached.

    A step is worth the sum of these terms, which lies in [0, 1]:
        tip_error      0.7 times the mean over three widths w (2, 0.4, 0.08 m) of 1 / (1 + (tip error / w)^2)
        tip_vibration  0.2 / (1 + (tip vibration / 0.3 m/s)^2)
        effort         0.1 (1 - mean of the squared actions)
        failure        -failure_penalty when the step ended the episode by a limit or a divergence

    Attributes:
        start, slew: rad.
        failure_penalty: reward lost by a failure, >= 0.

    Raises:
        ValueError: one line with field, value and what is allowed.
    """

    start: float = 0.8
    slew: float = 0.8
    failure_penalty: float = 10.0

    def __post_init__(self) -> None:
        store(
            self,
            start=non_negative("Slew.start", self.start, "rad"),
            slew=positive("Slew.slew", self.slew, "rad"),
            failure_penalty=non_negative("Slew.failure_penalty", self.failure_penalty),
        )

    def draw(self, random: np.random.Generator, joints: int) -> tuple[Array, Array]:
        """Start and goal postures (joints,) rad of one episode."""
        start = random.uniform(-self.start, self.start, joints)
        return start, start + random.uniform(-self.slew, self.slew, joints)

    def reward_terms(self, tip_error: Number, tip_vibration: Number, effort: Number, failed: Number) -> dict[str, Any]:
        """Terms of the reward for a tip error (m), a tip vibration (m/s), the mean squared action and a failure.

        All are numbers, those of one arm, or all are arrays (b,), and so are the terms.
        """
        square = tip_error * tip_error
        near = [width**2 / (width**2 + square) for width in WIDTHS]
        return {
            "tip_error": 0.7 / 3.0 * (near[0] + near[1] + near[2]),
            "tip_vibration": 0.2 * CALM**2 / (CALM**2 + tip_vibration * tip_vibration),
            "effort": 0.1 * (1.0 - effort),
            "failure": 0.0 - self.failure_penalty * failed,
        }

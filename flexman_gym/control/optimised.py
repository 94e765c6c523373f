"""Optimised: torques from a table of optimised slews, then the LQR at the goal; the yardstick above all."""

import numpy as np

from flexman_gym.arrays import Array, IntArray, Vector, grown
from flexman_gym.checks import refusal
from flexman_gym.control.controller import Episode
from flexman_gym.control.lqr import LQR
from flexman_gym.control.slew_table import SlewTable, numbers_of
from flexman_gym.model.model import Model


class Optimised(LQR):
    """Replays the torques of a slew that a search found, then regulates the whole state about the goal.

    It knows its episodes beforehand, and nothing that acts on what it sees can be expected to be as quick.

    Args:
        table: of slews, of this arm.
        model: see `LQR`.
        torque_limit: see `LQR`.
        period: see `LQR`.

    Raises:
        ValueError: one line with field, value and what is allowed; also for a table of another arm, and in `reset` for
            an episode that the table does not have.
    """

    kept = ("_now",)

    def __init__(self, table: SlewTable, model: Model, torque_limit: float | Vector, period: float) -> None:
        super().__init__(model, torque_limit, period)
        table.check_arm(numbers_of(self.model, self.limits, self.period))
        self._table, self._slews, self._now = table, list[Array](), np.zeros(0, dtype=np.int64)

    def reset(self, arms: IntArray, episode: Episode) -> None:
        """Looks up the slews of the arms (r,)."""
        if episode.path is not None:
            raise refusal("episode", "a goal that moves", "one that stays, for which slews are optimised")
        found = [self._table.torques(*ends) for ends in zip(episode.start, episode.goal, strict=True)]
        super().reset(arms, episode)
        self._now = grown(self._now, len(self._held))
        self._slews += [np.zeros((0, len(self.limits)))] * (len(self._held) - len(self._slews))
        for arm, torques in zip(arms.tolist(), found, strict=True):
            self._slews[arm], self._now[arm] = torques, 0

    def torques(self, states: Array) -> Array:
        """Gives torques (b, n) N m for states (b, 2 d), and moves on by a period."""
        result = super().torques(states)
        for arm, now in enumerate(self._now.tolist()):
            if now < len(self._slews[arm]):
                result[arm] = self._slews[arm][now]
        self._now += 1
        return result

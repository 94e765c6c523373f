"""Prediction: where arms will be when torques that are asked for now begin to act, by those that are on their way."""

import numpy as np

from flexman_gym.arrays import Array, IntArray, grown
from flexman_gym.control.plant import Plant
from flexman_gym.control.twins import Twins


class Prediction:
    """Moves estimated states of b arms on through the delay of their torques, by the simulator.

    Args:
        plant: the arm and its delay.

    Attributes:
        past: (b, late + 1, n) torques that were asked for, N m, the newest first.
    """

    kept = ("past",)

    def __init__(self, plant: Plant) -> None:
        self._twins, self._usual = Twins(plant), np.array(plant.torque_limit)
        self.past, self._limits = np.zeros((0, plant.delay[1] + 1, len(self._usual))), np.zeros((0, len(self._usual)))

    def reset(self, arms: IntArray, limits: Array | None = None) -> None:
        """Starts new episodes of the arms (r,), whose torque limits (r, n) N m may be other than those of the plant."""
        count = int(arms.max(initial=-1)) + 1
        self.past, self._limits = grown(self.past, count), grown(self._limits, count)
        self.past[arms], self._limits[arms] = 0.0, self._usual if limits is None else limits

    def remember(self, delay: int) -> None:
        """Make room for the torques of a delay (control periods) that is longer than the plant's."""
        missing = delay + 1 - self.past.shape[1]
        if missing > 0:
            self.past = np.pad(self.past, ((0, 0), (0, missing), (0, 0)))

    def vary(self, arms: IntArray, parameters: dict[str, Array]) -> None:
        """Takes physical parameters, name -> (r, ...), of the arms (r,)."""
        if parameters:
            self._twins("prediction", len(self.past)).vary(arms, **parameters)

    def take(self, arms: IntArray, actions: Array) -> None:
        """Takes what the motors of arms (r,) were asked for in the last period, parts of the limits (r, n)."""
        self.past[arms, 1:] = self.past[arms, :-1]
        self.past[arms, 0] = actions * self._limits[arms]

    def __call__(self, arms: IntArray, states: Array, delays: IntArray, beside: Array | float = 0.0) -> Array:
        """Gives the states (r, 2 d) of arms (r,) after delays (r,) in control periods.

        Torques (r, n) N m may act on the motors beside those that were asked for.
        """
        longest = int(delays.max(initial=0))
        if not longest:
            return states
        batch = self._twins("prediction", len(self.past))
        drive, moving = np.zeros((len(self.past), len(self._usual) + 6)), np.zeros(len(self.past), dtype=bool)
        batch.place(arms, states)
        for period in range(longest):
            lag = delays - 1 - period
            moving[arms] = lag >= 0
            drive[arms, : len(self._usual)] = self.past[arms, np.maximum(lag, 0)] + beside
            batch.step(drive, moving)
        return batch.state[arms]

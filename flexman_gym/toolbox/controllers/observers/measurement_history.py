"""Measurement history: measurements and torques of episodes since their starts, with flags of lost samples."""

import numpy as np

from flexman_gym.agent.controller import Plant
from flexman_gym.common.arrays import Array, BoolArray, IntArray, pad_rows, row_dots
from flexman_gym.toolbox.controllers.observers.observer import MeasurementModel


class MeasurementHistory:
    """First k measurements (m,) of b episodes, the torques applied between them, and the weights of a fit to them.

    Args:
        instruments: measurement model.
        plant: plant model with the range of the delay.
        count: number k of measurements.
        starts: columns of the measurements without weight at the start of an episode, as they define its start; None
            for no columns.

    Attributes:
        readings: (b, k, m) measurements.
        lost: (b, k, m) True for lost measurements.
        weights: (k, m) reciprocal variances of the measurements.
    """

    state_fields = ("readings", "lost", "_torques", "_previous", "_motion", "_repeats")

    def __init__(self, instruments: MeasurementModel, plant: Plant, count: int, starts: slice | None) -> None:
        m, self._instruments, self._late = len(instruments.matrix), instruments, plant.delay[1]
        self.weights = np.tile(instruments.deviations**-2.0, (count, 1))
        if starts is not None:
            self.weights[0, starts] = 0.0
        self.readings, self.lost = np.zeros((0, count, m)), np.zeros((0, count, m), dtype=bool)
        self._torques = np.zeros((0, self._late + count, plant.model.n_joints))
        self._previous, self._repeats = np.zeros((0, m)), np.zeros((0, m), dtype=np.int64)  # of the last measurements
        self._motion = np.zeros((0, m))  # predicted changes of measurements since the last sample that was not lost

    def __len__(self) -> int:
        """Return the number of measurements of an episode."""
        return len(self.weights)

    def allocate(self, count: int) -> None:
        """Allocate memory for `count` arms."""
        for name in self.state_fields:
            setattr(self, name, pad_rows(getattr(self, name), count))

    def begin(self, arms: IntArray, now: Array) -> None:
        """Start the histories of arms (r,) with their first measurements (r, m), which are not lost."""
        self.readings[arms, 0] = self._previous[arms] = now
        self.lost[arms, 0], self._repeats[arms], self._motion[arms] = False, 0, 0.0

    def reset(self, arms: IntArray) -> None:
        """Set the torques of arms (r,) to zero, those before the start of an episode."""
        self._torques[arms] = 0.0

    def store_torques(self, arms: IntArray, ages: IntArray, torques: Array) -> None:
        """Store torques (r, n) N m commanded at the start of the last of `ages` (r,) periods; later ones are left."""
        early = ages <= len(self)
        self._torques[arms[early], self._late + ages[early] - 1] = torques[early]

    def store(self, arms: IntArray, ages: IntArray, now: Array, motion: Array) -> BoolArray:
        """Store the measurements of arms (r,) and find the lost ones.

        Args:
            arms: (r,) indices.
            ages: (r,) control periods since the start; measurements beyond the first k are not stored.
            now: (r, m) measurements.
            motion: (r, 2 d) changes of the estimated states in the previous period.

        Returns:
            Flags (r, m) of the measurements of lost samples.
        """
        change = self._motion[arms] + row_dots(self._instruments.matrix, motion[:, None])
        lost, self._repeats[arms] = self._instruments.lost(now, self._previous[arms], change, self._repeats[arms])
        self._motion[arms], self._previous[arms] = np.where(lost, change, 0.0), now
        early = ages < len(self)
        self.readings[arms[early], ages[early]], self.lost[arms[early], ages[early]] = now[early], lost[early]
        result: BoolArray = lost
        return result

    def count(self, arms: IntArray, age: int) -> IntArray:
        """Return the number (r,) of measurements up to an age that are not lost."""
        result: IntArray = self.weights[: age + 1].size - np.count_nonzero(self.lost[arms, : age + 1], axis=(1, 2))
        return result

    def recent_torques(self, arms: IntArray, period: int) -> Array:
        """Return the torques (r, delays, n) N m of a period for each delay from 0 to the largest one."""
        result: Array = self._torques[arms, period - 1 : period + self._late][:, ::-1]
        return result

    def data(self, arms: IntArray, age: int, delays: IntArray) -> tuple[Array, Array, Array]:
        """Return the torques, measurements and weights of arms (r,) up to an age.

        Args:
            arms: (r,) indices.
            age: control periods since the start.
            delays: (r,) delays of the torques, control periods.

        Returns:
            Applied torques (r, age, n) N m, measurements and weights (r, age + 1, m); a lost measurement has no weight.
        """
        torques = self._torques[arms[:, None], self._late + np.arange(age) - delays[:, None]]
        until = slice(age + 1)
        return torques, self.readings[arms, until], self.weights[until] * ~self.lost[arms, until]

"""Normalisation of observations by running mean and standard deviation."""

from pathlib import Path
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from flexman_gym.agent.network import VARIANCE_OFFSET
from flexman_gym.common.arrays import Array
from flexman_gym.common.checks import finite
from flexman_gym.common.files import open_arrays, reading, write_file
from flexman_gym.common.snapshot import get_state, set_state


class RunningMeanStd:
    """Running mean and variance of arrays of equal shape (Chan, Golub and LeVeque 1983).

    Args:
        shape: shape of one sample, such as an observation; () for a number.

    Attributes:
        count: number of samples.
        mean: (...) mean of the samples.
        squares: (...) sum of squared deviations from the mean.
    """

    state_fields = ("count", "mean", "squares")

    def __init__(self, shape: tuple[int, ...] = ()) -> None:
        self.count, self.mean, self.squares = 0.0, np.zeros(shape), np.zeros(shape)

    @property
    def deviation(self) -> Array:
        """Standard deviation (...); 1 before the first sample."""
        if self.count == 0.0:
            return np.ones_like(self.mean)
        result: Array = np.sqrt(self.squares / self.count + VARIANCE_OFFSET)
        return result

    def add(self, values: NDArray[Any]) -> None:
        """Add samples (b, ...), with any number of leading axes."""
        rows = np.asarray(values, dtype=np.float64).reshape(-1, *self.mean.shape)
        if len(rows):
            mean = rows.mean(axis=0)
            self._join(float(len(rows)), mean, np.square(rows - mean).sum(axis=0))

    def merge(self, other: Self) -> None:
        """Add the samples of another instance, which must share no sample with this instance."""
        if other.count:
            self._join(other.count, other.mean, other.squares)

    def apply(self, values: NDArray[Any], most: float = 10.0) -> NDArray[np.float32]:
        """Return values (b, ...) minus the mean, divided by the deviation, clipped to `most` in magnitude."""
        return np.clip((values - self.mean) / self.deviation, -most, most).astype(np.float32)

    def get_state(self) -> dict[str, Any]:
        """Return the statistics as arrays and numbers."""
        result: dict[str, Any] = get_state(self)
        return result

    def set_state(self, state: object) -> None:
        """Restore a state from `get_state` of an instance with the same shape."""
        set_state("scales", self, state)
        self.count = finite("scales.count", self.count)

    def save(self, path: str | Path) -> None:
        """Write the statistics to a file (npz); raises OSError if it cannot be written."""
        write_file(path, lambda file: np.savez(file, allow_pickle=False, **self.get_state()))

    @classmethod
    def load(cls, path: str | Path) -> Self:
        """Read a file written by `save`; no code in the file is executed.

        Args:
            path: path of the file.

        Raises:
            FileNotFoundError: if there is no file.
            ValueError: for a file without statistics.
        """
        with reading(path, "is not a file of RunningMeanStd.save"):
            with open_arrays(path) as file:
                state = {name: file[name] for name in cls.state_fields}
            result = cls(state["mean"].shape)
            result.set_state(state | {"count": float(state["count"])})
        return result

    def _join(self, count: float, mean: Array, squares: Array) -> None:
        total, difference = self.count + count, mean - self.mean
        self.mean = np.asarray(self.mean + difference * (count / total))  # an array for numbers too
        self.squares = np.asarray(self.squares + squares + np.square(difference) * (self.count * count / total))
        self.count = total

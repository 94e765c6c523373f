"""Normalisation of observations by running mean and standard deviation."""

from pathlib import Path
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from flexman_gym.common.arrays import Array
from flexman_gym.common.checks import finite, short_path, value_error
from flexman_gym.common.files import open_arrays
from flexman_gym.common.snapshot import get_state, set_state

VARIANCE_OFFSET = 1e-8  # added to a variance, so that what never changes can be divided by


class RunningMeanStd:
    """Mean and variance of numbers with a shape, from all that was added (Chan, Golub and LeVeque 1983).

    Attributes:
        count: how many were added.
        mean: of them, (...).
        squares: (...) sum of the squared deviations from the mean.

    Args:
        shape: of one of them, such as that of an observation; () for a number.
    """

    state_fields = ("count", "mean", "squares")

    def __init__(self, shape: tuple[int, ...] = ()) -> None:
        self.count, self.mean, self.squares = 0.0, np.zeros(shape), np.zeros(shape)

    @property
    def deviation(self) -> Array:
        """Standard deviation (...); 1 before anything was added."""
        if self.count == 0.0:
            return np.ones_like(self.mean)
        result: Array = np.sqrt(self.squares / self.count + VARIANCE_OFFSET)
        return result

    def add(self, values: NDArray[Any]) -> None:
        """Adds values (b, ...), or with more axes in front."""
        rows = np.asarray(values, dtype=np.float64).reshape(-1, *self.mean.shape)
        if len(rows):
            mean = rows.mean(axis=0)
            self._join(float(len(rows)), mean, np.square(rows - mean).sum(axis=0))

    def merge(self, other: Self) -> None:
        """Adds all that another object has been given; nothing of it may be in this one already."""
        if other.count:
            self._join(other.count, other.mean, other.squares)

    def apply(self, values: NDArray[Any], most: float = 10.0) -> NDArray[np.float32]:
        """Gives values (b, ...) less the mean, over the deviation, clipped to `most` in magnitude."""
        return np.clip((values - self.mean) / self.deviation, -most, most).astype(np.float32)

    def get_state(self) -> dict[str, Any]:
        """Gives all of it as arrays and plain data."""
        result: dict[str, Any] = get_state(self)
        return result

    def set_state(self, state: object) -> None:
        """Takes what `get_state` gave for the same shape; raises ValueError, one line, for anything else."""
        set_state("scales", self, state)
        self.count = finite("scales.count", self.count)

    def save(self, path: str | Path) -> None:
        """Writes a file (npz); raises OSError where it cannot be written."""
        with Path(path).open("wb") as file:
            np.savez(file, allow_pickle=False, **self.get_state())

    @classmethod
    def load(cls, path: str | Path) -> Self:
        """Reads such a file, in which nothing is run.

        Raises:
            FileNotFoundError: when there is none.
            ValueError: one line, for another file.
        """
        try:
            with open_arrays(path) as file:
                state = {name: file[name] for name in cls.state_fields}
            result = cls(state["mean"].shape)
            result.set_state(state | {"count": float(state["count"])})
        except FileNotFoundError:
            raise
        except Exception as error:  # whatever a zip file may hold
            allowed = f"a file that Scales.save wrote ({type(error).__name__})"
            raise value_error("scales", short_path(path), allowed) from None
        return result

    def _join(self, count: float, mean: Array, squares: Array) -> None:
        total, apart = self.count + count, mean - self.mean
        self.mean = np.asarray(self.mean + apart * (count / total))  # of numbers, too, an array
        self.squares = np.asarray(self.squares + squares + np.square(apart) * (self.count * count / total))
        self.count = total

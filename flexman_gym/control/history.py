"""History: past observations beside the present one, so that an agent without memory can tell what it does not see."""

import numpy as np

from flexman_gym.arrays import Array, IntArray
from flexman_gym.checks import positive, refusal, sequence, whole_number

MOST = 1000  # observations


class History:
    """The last k observations of b arms, the newest first, or the present one and exponential averages of all.

    In an episode that has just begun the first observation stands for those before it.

    Args:
        kind: k, or the times (s) of the averages: an observation counts 1/e of a new one so long after it was made.
        interval: between two observations, s.
        arms: b.
        size: of an observation.
    """

    kept = ("_memory",)

    def __init__(self, kind: int | tuple[float, ...], interval: float, arms: int, size: int) -> None:
        self._gains = None if isinstance(kind, int) else 1.0 - np.exp(-interval / np.array(kind))[:, None]
        self.parts = parts_of(kind)
        self._memory = np.zeros((arms, self.parts, size))

    def following(self, earlier: "History") -> "History":
        """Gives itself with what an earlier one of fewer arms remembers."""
        self._memory[: len(earlier._memory)] = earlier._memory
        return self

    def begin(self, observations: Array, arms: IntArray) -> Array:
        """Starts with the first observations (r, size) of the arms (r,); returns what is seen, (r, parts size)."""
        self._memory[arms] = observations[:, None]
        return self.seen(arms)

    def add(self, observations: Array, arms: IntArray) -> Array:
        """Adds observations (r, size) of the arms (r,); returns what is seen, (r, parts size)."""
        memory = self._memory
        if self._gains is None:
            memory[arms, 1:] = memory[arms, :-1]
        else:
            memory[arms, 1:] += self._gains * (observations[:, None] - memory[arms, 1:])
        memory[arms, 0] = observations
        return self.seen(arms)

    def seen(self, arms: IntArray) -> Array:
        """Gives what is seen of the arms (r,), (r, parts size)."""
        result: Array = self._memory[arms].reshape(len(arms), self._memory[0].size)  # of no arm too
        return result


def parts_of(kind: int | tuple[float, ...]) -> int:
    """How many observations a history shows."""
    return kind if isinstance(kind, int) else 1 + len(kind)


def checked_history(value: object) -> int | tuple[float, ...]:
    """A number of observations, or the times of averages; raises ValueError for anything else."""
    if not isinstance(value, list | tuple) and not (isinstance(value, np.ndarray) and value.ndim):
        return whole_number("history", value, 1, MOST)
    times = sequence("history", value, "times (s)")
    if not 0 < len(times) <= MOST:
        raise refusal("history", value, f"a whole number, or 1 to {MOST} times (s)")
    return tuple(positive(f"history[{i}]", time, "s") for i, time in enumerate(times))

"""Stopwatches: cost of a call, and time in all calls of a method."""

import time
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import numpy as np

from flexman_gym.common.arrays import Array


class Stopwatch:
    """Context manager that adds up the time of all calls of a method."""

    def __init__(self, owner: type, name: str) -> None:
        self._owner, self._name, self._method = owner, name, getattr(owner, name)
        self.cpu = self.wall = 0.0

    def __enter__(self) -> "Stopwatch":
        method: Callable[..., Any] = self._method

        def watched(*arguments: Any, **named: Any) -> Any:
            started = time.process_time(), time.perf_counter()
            try:
                return method(*arguments, **named)
            finally:
                self.cpu += time.process_time() - started[0]
                self.wall += time.perf_counter() - started[1]

        setattr(self._owner, self._name, watched)
        return self

    def __exit__(self, *error: object) -> None:
        setattr(self._owner, self._name, self._method)


class Cost(NamedTuple):
    """Cost of one step, evaluation or start: CPU time, clock time (s), and the share of simulation."""

    cpu: float
    wall: float
    share: float = float("nan")


Timer = Callable[[], Cost]


def _clock(call: Callable[[], object]) -> tuple[float, float]:
    """Return the CPU time of the process and the wall-clock time of a call, s."""
    started = time.process_time(), time.perf_counter()
    call()
    return time.process_time() - started[0], time.perf_counter() - started[1]


def timer(call: Callable[[], object], count: int, batches: int = 1) -> Timer:
    """Return a timer of the cost per operation of a call with `count` operations, the fastest of `batches` calls."""

    def measure() -> Cost:
        cpu, wall = min(_clock(call) for _ in range(batches))
        return Cost(cpu / count, wall / count)

    return measure


def in_turns(timers: Mapping[str, Timer], rounds: int) -> dict[str, Array]:
    """Return the costs (rounds, 3) of each timer; interleaved, so that disturbances affect all timers alike."""
    costs: dict[str, list[Cost]] = {name: [] for name in timers}
    for _ in range(rounds):
        for name, measure in timers.items():
            costs[name].append(measure())
    return {name: np.array(result) for name, result in costs.items()}


def repeated(call: Callable[[], object], times: int) -> Callable[[], None]:
    """Return a function that repeats a call."""

    def repeat() -> None:
        for _ in range(times):
            call()

    return repeat

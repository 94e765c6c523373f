"""Rows of the benchmark: calls that take turns, and what each costs."""

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from flexman_gym.arrays import Array

EVALUATIONS, ENVIRONMENTS, PARTS, STARTS = "evaluations", "environments", "parts", "starts"


class Cost(NamedTuple):
    """What one step, evaluation or start costs: seconds of the processor and of a clock; part that is simulation."""

    cpu: float
    wall: float
    share: float = float("nan")


Timer = Callable[[], Cost]


@dataclass(frozen=True)
class Row:
    """A row of the benchmark.

    Attributes:
        table: to which it belongs.
        name: what is timed.
        arms, threads: numbers of them, None where that says nothing.
        cpu, wall: seconds, medians over the rounds; wall of environments that of the quickest round.
        peer: name of the row that it is compared with, "" for none.
        times_peer: of evaluations the cost, of environments the speed, as a multiple of the peer's: median over the
            rounds by CPU time; for a row of several threads by the clock.
        share: part of the CPU time that is spent in the environment's steps.
    """

    table: str
    name: str
    arms: float | None
    threads: float | None
    cpu: float
    wall: float
    peer: str = ""
    times_peer: float | None = None
    share: float | None = None


def clock(call: Callable[[], object]) -> tuple[float, float]:
    """CPU time of the whole process and time of the clock of one call, s."""
    started = time.process_time(), time.perf_counter()
    call()
    return time.process_time() - started[0], time.perf_counter() - started[1]


def timer(call: Callable[[], object], count: int, batches: int = 1) -> Timer:
    """The cost of one of the `count` things that a call does, the cheapest of so many calls."""

    def measure() -> Cost:
        cpu, wall = min(clock(call) for _ in range(batches))
        return Cost(cpu / count, wall / count)

    return measure


def in_turns(timers: Mapping[str, Timer], rounds: int) -> dict[str, Array]:
    """Costs (rounds, 3) of each; they take turns, so that a slow moment of the machine hits all of them."""
    costs: dict[str, list[Cost]] = {name: [] for name in timers}
    for _ in range(rounds):
        for name, measure in timers.items():
            costs[name].append(measure())
    return {name: np.array(result) for name, result in costs.items()}

"""Grid: cells of a study, worked off one by one, by processes, or by machines, with the same results to the bit."""

import multiprocessing
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import dataclass
from typing import Any, TypeVar

from flexman_gym.checks import store, whole_number

Cell = TypeVar("Cell")
Result = TypeVar("Result")
MOST_JOBS = 10_000


@dataclass(frozen=True)
class Workers:
    """Who works off the cells of a grid.

    Attributes:
        jobs: processes of this machine; 1 for this process alone.

    Raises:
        ValueError: one line with field, value and what is allowed.
    """

    jobs: int = 1

    def __post_init__(self) -> None:
        store(self, jobs=whole_number("jobs", self.jobs, 1, MOST_JOBS))


def spread(
    task: Callable[[Cell], Result], cells: Sequence[Cell], workers: Workers | int = 1
) -> Iterator[tuple[int, Result]]:
    """Gives the number of each cell and what a task makes of it, as they end.

    Args:
        task: a function of a module; what it gives follows from the cell alone.
        cells: of at least a second each, since handing one over takes milliseconds.
        workers: who does it, or so many processes.
    """
    chosen = workers if isinstance(workers, Workers) else Workers(workers)
    if chosen.jobs == 1 or len(cells) < 2:
        yield from enumerate(map(task, cells))
        return
    with ProcessPoolExecutor(chosen.jobs, multiprocessing.get_context("forkserver")) as pool:
        numbers: dict[Any, int] = {pool.submit(task, cell): number for number, cell in enumerate(cells)}
        try:
            for done in as_completed(numbers):
                yield numbers[done], done.result()
        finally:
            pool.shutdown(cancel_futures=True)

"""Grid: cells of a study, worked off one by one, by processes, or by machines, with the same results to the bit."""

import argparse
import hashlib
import sys
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any, TypeVar

from flexman_gym.checks import one_of, refusal, store, whole_number
from flexman_gym.evaluation import workers as ways
from flexman_gym.evaluation.folder import read_data, write_data
from flexman_gym.progress import Progress
from flexman_gym.verification.machine import machine_text

Cell = TypeVar("Cell")
Result = TypeVar("Result")
MOST_JOBS = 10_000
PACKAGE = Path(__file__).parents[1]


@dataclass(frozen=True)
class Workers:
    """Who works off the cells of a grid: this process alone, or one of the following.

    Attributes:
        jobs: cells at once, in processes of this machine, or in tasks of Ray or SLURM; 1 for this process.
        ray: address of a Ray cluster, or "local" for one of this machine that ends with the grid; None for none.
        submitit: "slurm" for an array job, or "local" for the same on this machine; None for none.

    Raises:
        ValueError: one line with field, value and what is allowed.
    """

    jobs: int = 1
    ray: str | None = None
    submitit: str | None = None

    def __post_init__(self) -> None:
        store(self, jobs=whole_number("jobs", self.jobs, 1, MOST_JOBS))
        if self.submitit is not None:
            one_of("submitit", self.submitit, ("slurm", "local"))
            if self.ray is not None:
                raise refusal("ray", self.ray, "nothing beside submitit")

    @staticmethod
    def arguments(parser: argparse.ArgumentParser) -> None:
        """Says what the command line of a grid takes."""
        parser.add_argument("--jobs", type=int, default=1, help="cells at once, in processes")
        parser.add_argument("--ray", metavar="ADDRESS", help="in tasks of a Ray cluster, or of a local one: local")
        parser.add_argument("--submitit", metavar="CLUSTER", help="in an array job: slurm, or local")

    @classmethod
    def of(cls, options: argparse.Namespace) -> "Workers":
        """Gives those that a command line asks for."""
        return cls(options.jobs, options.ray, options.submitit)


def spread(
    task: Callable[[Cell], Result],
    cells: Sequence[Cell],
    workers: Workers | int = 1,
    kept: Path | None = None,
) -> Iterator[tuple[int, Result]]:
    """Gives the number of each cell and what a task makes of it, as they end.

    A cell whose worker dies is tried again; one that fails ends the grid with its error. A line on stderr says now and
    then how much is left.

    Args:
        task: a function of a module; what it gives follows from the cell alone.
        cells: of at least a second each, since handing one over takes milliseconds.
        workers: who does it, or so many processes.
        kept: a folder for what is done, from which a grid that was killed goes on; the results are then plain data and
            arrays, the cells have a `repr` that tells them apart. None keeps nothing.

    Raises:
        RuntimeError: where workers die again and again.
        ImportError: where Ray or submitit is asked for and not installed.
    """
    chosen = workers if isinstance(workers, Workers) else Workers(workers)
    files = [kept / f"{_key(task, cell)}.npz" if kept else None for cell in cells]
    known = [number for number, file in enumerate(files) if file and file.is_file()]
    for number in known:
        yield number, read_data(files[number])["result"]  # type: ignore[arg-type]
    left = sorted({*range(len(cells))} - {*known})
    progress = Progress("cells", len(left))
    for place, result in _way(chosen)(task, [cells[number] for number in left]) if left else ():
        if file := files[left[place]]:
            file.parent.mkdir(parents=True, exist_ok=True)
            write_data(file, {"result": result})
        progress.count()
        yield left[place], result


def gathered(
    task: Callable[[Cell], Result], cells: Sequence[Cell], workers: Workers | int = 1, kept: Path | None = None
) -> list[Result]:
    """Gives what a task makes of all cells, in their order; arguments and errors as of `spread`."""
    results = dict(spread(task, cells, workers, kept))
    return [results[number] for number in range(len(cells))]


def _way(workers: Workers) -> Callable[..., Iterator[tuple[int, Any]]]:
    """What hands cells over."""
    if workers.ray is not None:
        return ways.Ray(workers.jobs, workers.ray)
    if workers.submitit is not None:
        return ways.Submitit(workers.jobs, workers.submitit)
    return ways.alone if workers.jobs == 1 else ways.Processes(workers.jobs)


def _key(task: Callable[..., Any], cell: object) -> str:
    """Hash of all that a result follows from: task, cell, sources and versions."""
    own = sys.modules[task.__module__].__file__ or ""
    parts = (task.__module__, task.__qualname__, repr(cell), _digest(Path(own).parent), machine_text())
    return hashlib.sha256("\n".join(parts).encode()).hexdigest()[:20]


@cache
def _digest(folder: Path) -> str:
    """Hash of the sources of the package and of the folder of a task."""
    files = sorted({*PACKAGE.rglob("*.py"), *PACKAGE.rglob("*.yaml"), *folder.glob("*.py")})
    return hashlib.sha256(b"".join(path.read_bytes() for path in files)).hexdigest()

"""Parallel map: independent items of work run serially, in processes, on a Ray cluster or as a SLURM array job."""

import argparse
import hashlib
import multiprocessing
import os
import sys
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any, TypeVar

from flexman_gym.common.checks import one_of, set_fields, value_error, whole_number
from flexman_gym.common.computer import computer_text
from flexman_gym.common.progress import Progress
from flexman_gym.common.run_folder import read_npz, write_npz

Task = Callable[[Any], Any]
Prepare = Callable[[], object]
Results = Iterator[tuple[int, Any]]
MAX_DEATHS = 3  # of workers in a row, without a cell that was done in between
SHARES = 2  # of an array job's tasks, for each that runs at once: a killed one loses no more than its share
MOST_SHARES = 1000  # tasks of an array job that SLURM takes by default
MINUTES = 24 * 60  # of an array job's task, where SBATCH_TIMELIMIT does not say
OBJECTS = 200_000_000  # bytes of a local Ray cluster for what tasks hand over


def _run_serially(task: Task, cells: Sequence[Any], prepare: Prepare | None) -> Results:
    """Run the cells in this process, one after the other."""
    yield from enumerate(map(task, cells))


class _Processes:
    """Processes of this machine, which end with the one that started them, however that ends."""

    def __init__(self, jobs: int) -> None:
        self._jobs = jobs

    def __call__(self, task: Task, cells: Sequence[Any], prepare: Prepare | None) -> Results:
        if prepare is not None:
            prepare()
        left, deaths, context = dict(enumerate(cells)), 0, multiprocessing.get_context("forkserver")
        context.set_forkserver_preload(["flexman_gym"])
        while left:
            with ProcessPoolExecutor(min(self._jobs, len(left)), context, _end_with_parent) as pool:
                numbers = {pool.submit(task, cell): number for number, cell in left.items()}
                try:
                    for done in as_completed(numbers):
                        result, deaths = done.result(), 0
                        del left[numbers[done]]
                        yield numbers[done], result
                except BrokenProcessPool:
                    deaths = _count_death(deaths)
                finally:
                    pool.shutdown(cancel_futures=True)


class _RayTasks:
    """Tasks of a Ray cluster, one a cell; of a local one, so many at once."""

    def __init__(self, jobs: int, address: str) -> None:
        self._jobs, self._address = jobs, address

    def __call__(self, task: Task, cells: Sequence[Any], prepare: Prepare | None) -> Results:
        with ray_cluster(self._jobs, self._address) as ray:
            own = {"env_vars": {"PYTHONPATH": _python_path()}}
            remote = ray.remote(num_cpus=1, max_retries=MAX_DEATHS, runtime_env=own)(_run_prepared)
            waiting = {remote.remote(prepare, task, cell): number for number, cell in enumerate(cells)}
            while waiting:
                for done in ray.wait(list(waiting))[0]:
                    yield waiting.pop(done), _ray_result(ray, done)


@contextmanager
def ray_cluster(jobs: int, address: str = "local", **variables: str) -> Iterator[Any]:
    """Gives Ray where it runs; a cluster that is started for it ends here.

    Args:
        jobs: tasks at once of a local cluster.
        address: of one that runs already, or "local".
        settings: what else `ray.init` takes.

    Raises:
        ImportError: without Ray.
    """
    ray = _import_package("ray")
    own = not ray.is_initialized()
    if own:
        os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")
        here = {"num_cpus": jobs, "include_dashboard": False, "object_store_memory": OBJECTS}
        there = here if address == "local" else {"address": address}
        workers = {"runtime_env": {"env_vars": {"PYTHONPATH": _python_path(), **variables}}} if variables else {}
        ray.init(log_to_driver=False, logging_level="ERROR", **there, **workers)
    try:
        yield ray
    finally:
        if own:
            ray.shutdown()


def _ray_result(ray: Any, done: Any) -> Any:
    """A result; the error of a cell as it was there."""
    try:
        return ray.get(done)
    except ray.exceptions.RayTaskError as error:
        raise error.cause from None


class _ArrayJob:
    """Tasks of an array job of SLURM, or processes that submitit starts, each with a share of the cells.

    What SLURM asks beside is said as its environment variables say it: SBATCH_PARTITION, SBATCH_ACCOUNT,
    SBATCH_TIMELIMIT. Logs are in the folder `submitit`, which all nodes see.
    """

    def __init__(self, jobs: int, cluster: str, logs: str | Path = "submitit", every: float = 0.5) -> None:
        self._jobs, self._cluster, self._logs, self._every = jobs, cluster, logs, every

    def __call__(self, task: Task, cells: Sequence[Any], prepare: Prepare | None) -> Results:
        submitit = _import_package("submitit")
        executor = submitit.AutoExecutor(self._logs, cluster=self._cluster)
        executor.update_parameters(name="flexman", timeout_min=MINUTES, cpus_per_task=1,
                                   slurm_array_parallelism=self._jobs)  # fmt: skip
        shares = min(len(cells), SHARES * self._jobs, MOST_SHARES)
        left, deaths = {first: cells[first::shares] for first in range(shares)}, 0
        running: dict[int, Any] = {}
        while left:
            room = len(left) if self._cluster == "slurm" else self._jobs
            waiting = [first for first in left if first not in running][: room - len(running)]
            if waiting:
                os.environ["PYTHONPATH"] = _python_path()
                with executor.batch():
                    running |= {first: executor.submit(_run_share, prepare, task, left[first]) for first in waiting}
            for first in [first for first, job in running.items() if job.done()]:
                try:
                    results = running.pop(first).result()
                except submitit.core.utils.UncompletedJobError:
                    deaths = _count_death(deaths)
                    continue
                if isinstance(results, Exception):
                    raise results
                deaths, own = 0, left.pop(first)
                yield from ((first + shares * i, results[i]) for i in range(len(own)))
            time.sleep(self._every)


def _run_share(prepare: Prepare | None, task: Task, cells: Sequence[Any]) -> list[Any] | Exception:
    """Run a share of the cells; return the error of one that fails, which submitit would turn into a text."""
    try:
        return [_run_prepared(prepare, task, cell) for cell in cells]
    except Exception as error:
        return error


def _run_prepared(prepare: Prepare | None, task: Task, cell: Any) -> Any:
    """Run a task in a process that may not have been prepared yet."""
    if prepare is not None:
        prepare()
    return task(cell)


def _python_path() -> str:
    """Gives what a process that is started needs as PYTHONPATH to find what this one can import."""
    return os.pathsep.join(filter(None, sys.path))


def _count_death(deaths: int) -> int:
    """Counts the death of a worker; raises RuntimeError for too many in a row."""
    if deaths + 1 == MAX_DEATHS:
        raise RuntimeError(f"workers died {MAX_DEATHS} times in a row: memory may be short, or a cell may crash")
    print("a worker died: its cells are tried again", file=sys.stderr, flush=True)
    return deaths + 1


def _import_package(name: str) -> Any:
    """A package that this way needs; raises ImportError, one line, where it is not installed."""
    try:
        return __import__(name)
    except ImportError:
        raise ImportError(f"{name} is not installed: pip install 'flexman_gym[scale]'") from None


def _end_with_parent() -> None:
    """Ends this process when the one that asked for it is gone, also where that was killed."""
    threading.Thread(target=_outlive, daemon=True).start()


def _outlive() -> None:
    parent = multiprocessing.parent_process()
    assert parent is not None
    parent.join()
    os._exit(1)


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
        set_fields(self, jobs=whole_number("jobs", self.jobs, 1, MOST_JOBS))
        if self.submitit is not None:
            one_of("submitit", self.submitit, ("slurm", "local"))
            if self.ray is not None:
                raise value_error("ray", self.ray, "nothing beside submitit")

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


def parallel_map_unordered(
    task: Callable[[Cell], Result],
    cells: Sequence[Cell],
    workers: Workers | int = 1,
    kept: Path | None = None,
    prepare: Prepare | None = None,
) -> Iterator[tuple[int, Result]]:
    """Run a task for each cell; yield the number of the cell and its result, in the order in which they end.

    A cell whose worker dies is tried again; one that fails ends the grid with its error. A line on stderr shows from
    time to time how much is left.

    Args:
        task: a function of a module; what it gives follows from the cell alone.
        cells: of at least a second each, since handing one over takes milliseconds.
        workers: who does it, or so many processes.
        kept: a folder for what is done, from which a grid that was killed goes on; the results are then plain data and
            arrays, the cells have a `repr` that tells them apart. None keeps nothing.
        prepare: a function of a module, called before workers start: once on this computer for local processes, before
            each cell in tasks of Ray and SLURM, which run on other computers. Cells in this process need none.

    Raises:
        RuntimeError: where workers die again and again.
        ImportError: where Ray or submitit is asked for and not installed.
    """
    chosen = workers if isinstance(workers, Workers) else Workers(workers)
    files = [kept / f"{_key(task, cell)}.npz" if kept else None for cell in cells]
    known = [number for number, file in enumerate(files) if file and file.is_file()]
    for number in known:
        yield number, read_npz(files[number])["result"]  # type: ignore[arg-type]
    left = sorted({*range(len(cells))} - {*known})
    progress = Progress("cells", len(left))
    for place, result in _executor(chosen)(task, [cells[number] for number in left], prepare) if left else ():
        if file := files[left[place]]:
            file.parent.mkdir(parents=True, exist_ok=True)
            write_npz(file, {"result": result})
        progress.count()
        yield left[place], result


def parallel_map(
    task: Callable[[Cell], Result],
    cells: Sequence[Cell],
    workers: Workers | int = 1,
    kept: Path | None = None,
    prepare: Prepare | None = None,
) -> list[Result]:
    """Return the results of all cells, in their order; arguments and errors as of `parallel_map_unordered`."""
    results = dict(parallel_map_unordered(task, cells, workers, kept, prepare))
    return [results[number] for number in range(len(cells))]


def _executor(workers: Workers) -> Callable[..., Iterator[tuple[int, Any]]]:
    """What hands cells over."""
    if workers.ray is not None:
        return _RayTasks(workers.jobs, workers.ray)
    if workers.submitit is not None:
        return _ArrayJob(workers.jobs, workers.submitit)
    return _run_serially if workers.jobs == 1 else _Processes(workers.jobs)


def _key(task: Callable[..., Any], cell: object) -> str:
    """Hash of all that a result follows from: task, cell, sources and versions."""
    own = sys.modules[task.__module__].__file__ or ""
    parts = (task.__module__, task.__qualname__, repr(cell), _digest(Path(own).parent), computer_text())
    return hashlib.sha256("\n".join(parts).encode()).hexdigest()[:20]


@cache
def _digest(folder: Path) -> str:
    """Hash of the sources of the package and of the folder of a task."""
    files = sorted({*PACKAGE.rglob("*.py"), *PACKAGE.rglob("*.yaml"), *folder.glob("*.py")})
    return hashlib.sha256(b"".join(path.read_bytes() for path in files)).hexdigest()

"""Parallel map: a function over independent cells, serially, in processes, on a Ray cluster or as a SLURM array job.

A cell is one argument of the function, whose name here is `task`.
"""

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
from functools import cache, partial
from multiprocessing import forkserver
from pathlib import Path
from typing import Any, TypeVar

from flexman_gym.common.checks import one_of, set_fields, whole_number
from flexman_gym.common.computer import computer_text, optional_module
from flexman_gym.common.errors import value_error
from flexman_gym.common.progress import Progress
from flexman_gym.common.run_folder import read_npz, write_npz

Task = Callable[[Any], Any]
Prepare = Callable[[], object]
Results = Iterator[tuple[int, Any]]
MAX_DEATHS = 3  # number of workers that die in a row, without a finished cell in between, before the map fails
SHARES_PER_JOB = 2  # shares of the cells per simultaneous job of an array; a killed job loses one share
MAX_SHARES = 1000  # largest number of jobs of an array, the default limit of SLURM
TIME_LIMIT = 24 * 60  # min; time limit of a job of an array unless SBATCH_TIMELIMIT is set
LOGS = "submitit"  # folder for the logs of an array
POLL_INTERVAL = 0.5  # s; interval at which the jobs of an array are polled
THREADS = "OMP_NUM_THREADS"  # variable with the number of threads of linear algebra, read when its library is loaded
OBJECT_STORE_BYTES = 200_000_000  # bytes of shared memory of a local Ray cluster


def _run_serially(task: Task, cells: Sequence[Any], prepare: Prepare | None) -> Results:
    """Run the cells in this process, one after the other."""
    yield from enumerate(map(task, cells))


def _run_in_processes(jobs: int, task: Task, cells: Sequence[Any], prepare: Prepare | None) -> Results:
    """Run the cells in processes on this computer, which end with the parent process even if it is killed."""
    if prepare is not None:
        prepare()
    remaining, deaths, context = dict(enumerate(cells)), 0, multiprocessing.get_context("forkserver")
    context.set_forkserver_preload(["flexman_gym"])
    with _one_thread():
        forkserver.ensure_running()
    while remaining:
        with ProcessPoolExecutor(min(jobs, len(remaining)), context, _end_with_parent) as pool:
            numbers = {pool.submit(task, cell): number for number, cell in remaining.items()}
            try:
                for done in as_completed(numbers):
                    result, deaths = done.result(), 0
                    del remaining[numbers[done]]
                    yield numbers[done], result
            except BrokenProcessPool:
                deaths = _count_death(deaths)
            finally:
                pool.shutdown(cancel_futures=True)


@contextmanager
def _one_thread() -> Iterator[None]:
    """Start processes with one thread of linear algebra each, unless the environment gives a number.

    Processes with more threads than cores take several times as long. Ray does the same by itself.
    """
    given = THREADS in os.environ
    os.environ.setdefault(THREADS, "1")
    try:
        yield
    finally:
        if not given:
            del os.environ[THREADS]


def _run_on_ray(jobs: int, address: str, task: Task, cells: Sequence[Any], prepare: Prepare | None) -> Results:
    """Run the cells by one Ray call each on a Ray cluster; a local cluster runs at most `jobs` calls at once."""
    with _ray_cluster(jobs, address) as ray:
        own = {"env_vars": {"PYTHONPATH": _python_path()}}
        remote = ray.remote(num_cpus=1, max_retries=MAX_DEATHS, runtime_env=own)(_run_prepared)
        waiting = {remote.remote(prepare, task, cell): number for number, cell in enumerate(cells)}
        while waiting:
            for done in ray.wait(list(waiting))[0]:
                yield waiting.pop(done), _ray_result(ray, done)


@contextmanager
def _ray_cluster(jobs: int, address: str) -> Iterator[Any]:
    """Start Ray if it is not running, and shut it down if it was started here.

    Args:
        jobs: number of simultaneous calls on a local cluster.
        address: address of a running cluster, or "local".

    Yields:
        Any: The module `ray`.

    Raises:
        ImportError: if Ray is not installed.
    """
    ray = optional_module("ray", "a Ray cluster", "scale")
    own = not ray.is_initialized()
    if own:
        os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")
        local = {"num_cpus": jobs, "include_dashboard": False, "object_store_memory": OBJECT_STORE_BYTES}
        cluster = local if address == "local" else {"address": address}
        ray.init(log_to_driver=False, logging_level="ERROR", **cluster)
    try:
        yield ray
    finally:
        if own:
            ray.shutdown()


def _ray_result(ray: Any, done: Any) -> Any:
    """Return the result of a Ray call, or raise its original error."""
    try:
        return ray.get(done)
    except ray.exceptions.RayTaskError as error:
        raise error.cause from None


def _run_array_job(jobs: int, cluster: str, task: Task, cells: Sequence[Any], prepare: Prepare | None) -> Results:
    """Run shares of the cells by the jobs of a SLURM array, or by processes started by submitit.

    Further options are read from environment variables of SLURM: SBATCH_PARTITION, SBATCH_ACCOUNT, SBATCH_TIMELIMIT.
    Logs are written to the folder LOGS, which must be on a file system of all nodes.
    """
    submitit = optional_module("submitit", "an array job", "scale")
    executor = submitit.AutoExecutor(LOGS, cluster=cluster)
    executor.update_parameters(name="flexman", timeout_min=TIME_LIMIT, cpus_per_task=1,
                               slurm_array_parallelism=jobs)  # fmt: skip
    shares = min(len(cells), SHARES_PER_JOB * jobs, MAX_SHARES)
    remaining, deaths = {first: cells[first::shares] for first in range(shares)}, 0
    running: dict[int, Any] = {}
    while remaining:
        slots = len(remaining) if cluster == "slurm" else jobs
        waiting = [first for first in remaining if first not in running][: slots - len(running)]
        if waiting:
            os.environ["PYTHONPATH"] = _python_path()
            with _one_thread(), executor.batch():
                running |= {first: executor.submit(_run_share, prepare, task, remaining[first]) for first in waiting}
        for first in [first for first, job in running.items() if job.done()]:
            try:
                results = running.pop(first).result()
            except submitit.core.utils.UncompletedJobError:
                deaths = _count_death(deaths)
                continue
            if isinstance(results, Exception):
                raise results
            deaths, own = 0, remaining.pop(first)
            yield from ((first + shares * i, results[i]) for i in range(len(own)))
        time.sleep(POLL_INTERVAL)


def _run_share(prepare: Prepare | None, task: Task, cells: Sequence[Any]) -> list[Any] | Exception:
    """Return the results of a share of the cells, or the error of a cell, which submitit would convert to text."""
    try:
        return [_run_prepared(prepare, task, cell) for cell in cells]
    except Exception as error:
        return error


def _run_prepared(prepare: Prepare | None, task: Task, cell: Any) -> Any:
    """Return the result of the function `task` for a cell, after the function `prepare`."""
    if prepare is not None:
        prepare()
    return task(cell)


def _python_path() -> str:
    """Return the value of PYTHONPATH with which a new process finds the modules importable here."""
    return os.pathsep.join(filter(None, sys.path))


def _count_death(deaths: int) -> int:
    """Return the number of workers that died in a row; raise RuntimeError at MAX_DEATHS."""
    if deaths + 1 == MAX_DEATHS:
        raise RuntimeError(f"workers died {MAX_DEATHS} times in a row: memory may be short, or a cell may crash")
    print("a worker died: its cells are run again", file=sys.stderr, flush=True)
    return deaths + 1


def _end_with_parent() -> None:
    """End this process when its parent ends, even if the parent is killed."""
    threading.Thread(target=_exit_after_parent, daemon=True).start()


def _exit_after_parent() -> None:
    """Wait for the end of the parent process, then end this process."""
    parent = multiprocessing.parent_process()
    assert parent is not None
    parent.join()
    os._exit(1)


Cell = TypeVar("Cell")
Result = TypeVar("Result")
MAX_JOBS = 10_000
PACKAGE = Path(__file__).parents[1]


@dataclass(frozen=True)
class Workers:
    """Workers of a parallel map: this process, local processes, a Ray cluster or an array job.

    Attributes:
        jobs: number of cells run at once, in local processes, Ray calls or SLURM jobs; 1 for this process.
        ray: address of a Ray cluster, "local" for a temporary cluster on this computer, or None.
        submitit: "slurm" for an array job, "local" for the same on this computer, or None.
    """

    jobs: int = 1
    ray: str | None = None
    submitit: str | None = None

    def __post_init__(self) -> None:
        set_fields(self, jobs=whole_number("jobs", self.jobs, 1, MAX_JOBS))
        if self.submitit is not None:
            one_of("submitit", self.submitit, ("slurm", "local"))
            if self.ray is not None:
                raise value_error("ray", self.ray, "no Ray cluster together with submitit")

    @staticmethod
    def arguments(parser: argparse.ArgumentParser) -> None:
        """Add the command-line arguments of the workers to a parser."""
        parser.add_argument("--jobs", type=int, default=1, help="number of simultaneous processes or tasks")
        parser.add_argument(
            "--ray",
            metavar="ADDRESS",
            help="use a Ray cluster at this address, or a new one: local",
        )
        parser.add_argument("--submitit", metavar="CLUSTER", help="use an array job: slurm, or local")

    @classmethod
    def of(cls, options: argparse.Namespace) -> "Workers":
        """Return the workers selected on a command line."""
        return cls(options.jobs, options.ray, options.submitit)


def parallel_map_unordered(
    task: Callable[[Cell], Result],
    cells: Sequence[Cell],
    workers: Workers | int = 1,
    cache: Path | None = None,
    prepare: Prepare | None = None,
) -> Iterator[tuple[int, Result]]:
    """Run a function for each cell, and yield the results in the order of completion.

    The cells of a worker that dies are run again; an error of the function ends the map. The remaining work is reported
    on stderr every 10 s.

    Args:
        task: function at the top level of a module; the result depends on the cell only.
        cells: the cells, each with at least a second of work, because transferring a cell takes milliseconds.
        workers: the workers, or a number of local processes.
        cache: folder for results, from which an interrupted map resumes; results must be JSON-compatible data and
            arrays, and the `repr` of each cell unique. None stores nothing.
        prepare: function at the top level of a module that prepares a worker. It is called once before local processes
            start and before each cell on Ray and SLURM, but not if the cells run in this process.

    Yields:
        tuple[int, Result]: Index and result of a cell.

    Raises:
        RuntimeError: if workers die repeatedly.
        ImportError: if Ray or submitit is requested but not installed.
    """
    chosen = workers if isinstance(workers, Workers) else Workers(workers)
    files = [cache / f"{_key(task, cell)}.npz" if cache else None for cell in cells]
    known = [number for number, file in enumerate(files) if file and file.is_file()]
    for number in known:
        yield number, read_npz(files[number])["result"]  # type: ignore[arg-type]
    remaining = sorted({*range(len(cells))} - {*known})
    progress = Progress("cells", len(remaining))
    for place, result in _executor(chosen)(task, [cells[number] for number in remaining], prepare) if remaining else ():
        if file := files[remaining[place]]:
            file.parent.mkdir(parents=True, exist_ok=True)
            write_npz(file, {"result": result})
        progress.count()
        yield remaining[place], result


def parallel_map(
    task: Callable[[Cell], Result],
    cells: Sequence[Cell],
    workers: Workers | int = 1,
    cache: Path | None = None,
    prepare: Prepare | None = None,
) -> list[Result]:
    """Return the results of all cells in their order; arguments and errors as in `parallel_map_unordered`."""
    results = dict(parallel_map_unordered(task, cells, workers, cache, prepare))
    return [results[number] for number in range(len(cells))]


def _executor(workers: Workers) -> Callable[..., Results]:
    """Return the function that runs cells by the workers."""
    if workers.ray is not None:
        return partial(_run_on_ray, workers.jobs, workers.ray)
    if workers.submitit is not None:
        return partial(_run_array_job, workers.jobs, workers.submitit)
    return _run_serially if workers.jobs == 1 else partial(_run_in_processes, workers.jobs)


def _key(task: Callable[..., Any], cell: object) -> str:
    """Return a hash of all inputs of a result: function, cell, sources and package versions."""
    own = sys.modules[task.__module__].__file__ or ""
    parts = (task.__module__, task.__qualname__, repr(cell), _digest(Path(own).parent), computer_text())
    return hashlib.sha256("\n".join(parts).encode()).hexdigest()[:20]


@cache
def _digest(folder: Path) -> str:
    """Return a hash of the sources of the package and of the folder of a function."""
    files = sorted({*PACKAGE.rglob("*.py"), *PACKAGE.rglob("*.yaml"), *folder.glob("*.py")})
    return hashlib.sha256(b"".join(path.read_bytes() for path in files)).hexdigest()

"""Workers: the ways in which the cells of a grid reach processes of this machine, a Ray cluster, or SLURM."""

import fcntl
import multiprocessing
import os
import sys
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from functools import cache
from pathlib import Path
from typing import Any

import gymnasium as gym

from flexman_gym.kernels import FOLDER

Task = Callable[[Any], Any]
Done = Iterator[tuple[int, Any]]
DEATHS = 3  # of workers in a row, without a cell that was done in between
SHARES = 2  # of an array job's tasks, for each that runs at once: a killed one loses no more than its share
MOST_SHARES = 1000  # tasks of an array job that SLURM takes by default
MINUTES = 24 * 60  # of an array job's task, where SBATCH_TIMELIMIT does not say
OBJECTS = 200_000_000  # bytes of a local Ray cluster for what tasks hand over


def alone(task: Task, cells: Sequence[Any]) -> Done:
    """Works them off in this process, one after the other."""
    yield from enumerate(map(task, cells))


class Processes:
    """Processes of this machine, which end with the one that started them, however that ends."""

    def __init__(self, jobs: int) -> None:
        self._jobs = jobs

    def __call__(self, task: Task, cells: Sequence[Any]) -> Done:
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
                    deaths = _mourned(deaths)
                finally:
                    pool.shutdown(cancel_futures=True)


class Ray:
    """Tasks of a Ray cluster, one a cell; of a local one, so many at once."""

    def __init__(self, jobs: int, address: str) -> None:
        self._jobs, self._address = jobs, address

    def __call__(self, task: Task, cells: Sequence[Any]) -> Done:
        with cluster(self._jobs, self._address) as ray:
            own = {"env_vars": {"PYTHONPATH": paths()}}
            remote = ray.remote(num_cpus=1, max_retries=DEATHS, runtime_env=own)(prepared)
            waiting = {remote.remote(task, cell): number for number, cell in enumerate(cells)}
            while waiting:
                for done in ray.wait(list(waiting))[0]:
                    yield waiting.pop(done), _of_ray(ray, done)


@contextmanager
def cluster(jobs: int, address: str = "local", **settings: Any) -> Iterator[Any]:
    """Gives Ray where it runs; a cluster that is started for it ends here.

    Args:
        jobs: tasks at once of a local cluster.
        address: of one that runs already, or "local".
        settings: what else `ray.init` takes.

    Raises:
        ImportError: without Ray.
    """
    ray = _needed("ray")
    own = not ray.is_initialized()
    if own:
        os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")
        here = {"num_cpus": jobs, "include_dashboard": False, "object_store_memory": OBJECTS}
        there = here if address == "local" else {"address": address}
        ray.init(log_to_driver=False, logging_level="ERROR", **there, **settings)
    try:
        yield ray
    finally:
        if own:
            ray.shutdown()


def _of_ray(ray: Any, done: Any) -> Any:
    """A result; the error of a cell as it was there."""
    try:
        return ray.get(done)
    except ray.exceptions.RayTaskError as error:
        raise error.cause from None


class Submitit:
    """Tasks of an array job of SLURM, or processes that submitit starts, each with a share of the cells.

    What SLURM asks beside is said as its environment variables say it: SBATCH_PARTITION, SBATCH_ACCOUNT,
    SBATCH_TIMELIMIT. Logs are in the folder `submitit`, which all nodes see.
    """

    def __init__(self, jobs: int, cluster: str, logs: str | Path = "submitit", every: float = 0.5) -> None:
        self._jobs, self._cluster, self._logs, self._every = jobs, cluster, logs, every

    def __call__(self, task: Task, cells: Sequence[Any]) -> Done:
        submitit = _needed("submitit")
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
                os.environ["PYTHONPATH"] = paths()
                with executor.batch():
                    running |= {first: executor.submit(_share, task, left[first]) for first in waiting}
            for first in [first for first, job in running.items() if job.done()]:
                try:
                    results = running.pop(first).result()
                except submitit.core.utils.UncompletedJobError:
                    deaths = _mourned(deaths)
                    continue
                if isinstance(results, Exception):
                    raise results
                deaths, own = 0, left.pop(first)
                yield from ((first + shares * i, results[i]) for i in range(len(own)))
            time.sleep(self._every)


def _share(task: Task, cells: Sequence[Any]) -> list[Any] | Exception:
    """Works off a share of the cells; gives the error of one that fails, which submitit would give as a text."""
    try:
        return [prepared(task, cell) for cell in cells]
    except Exception as error:
        return error


def prepared(task: Task, cell: Any) -> Any:
    """Does a task where no other process may have compiled the kernels yet."""
    prepare()
    return task(cell)


@cache
def prepare() -> None:
    """Compiles the kernels that environments need, unless that was done; of several processes of a node one does."""
    with _alone_on_node():
        for env in (gym.make("FlexRRR-v0"), gym.make_vec("FlexRRR-v0", 2, "vector_entry_point")):
            env.reset(seed=0)
            env.step(env.action_space.sample())


@contextmanager
def _alone_on_node() -> Iterator[None]:
    """Waits until no other process of the node compiles."""
    if FOLDER is None:
        yield
        return
    with (Path(FOLDER) / "lock").open("w") as file:
        fcntl.flock(file, fcntl.LOCK_EX)
        yield


def paths() -> str:
    """Gives what a process that is started needs as PYTHONPATH to find what this one can import."""
    return os.pathsep.join(filter(None, sys.path))


def _mourned(deaths: int) -> int:
    """Counts the death of a worker; raises RuntimeError for too many in a row."""
    if deaths + 1 == DEATHS:
        raise RuntimeError(f"workers died {DEATHS} times in a row: memory may be short, or a cell may crash")
    print("a worker died: its cells are tried again", file=sys.stderr, flush=True)
    return deaths + 1


def _needed(name: str) -> Any:
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

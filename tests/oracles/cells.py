"""Functions of cells of grids, importable by worker processes."""

import os
import signal
import threading
import time
from pathlib import Path

import numpy as np


def waves(cell):
    """Return plain data and an array made from a seed and a size."""
    seed, size = cell
    values = np.random.default_rng(seed).normal(size=size)
    return {"seed": seed, "values": np.sin(values), "mean": float(values.mean()), "nothing": None, "nan": float("nan")}


def mortal(cell):
    """Return the result of `waves`; the first worker that computes a certain cell dies, recorded by a file."""
    folder, seed = cell
    grave = Path(folder) / f"{seed}"
    if seed == 2 and not grave.exists():
        grave.touch()
        os.kill(os.getpid(), signal.SIGKILL)
    return waves((seed, 5))


def dying_once(grave, task, cell):
    """Return the result of a cell; the first worker to call it dies instead."""
    try:
        Path(grave).touch(exist_ok=False)
    except FileExistsError:
        return task(cell)
    os.kill(os.getpid(), signal.SIGKILL)


def counted(cell):
    """Return the result of `waves` and append a line per call to a file; slow from a certain cell on."""
    folder, seed, slow = cell
    with (Path(folder) / "done").open("a") as file:
        file.write(f"{seed}\n")
    time.sleep(30.0 if slow else 0.0)
    return waves((seed, 5))


def waking():
    """Append a line to a file for each prepared process."""
    with Path("prepared").open("a") as file:
        file.write(f"{os.getpid()}\n")


def refusing(cell):
    """Raise a custom error."""
    raise ValueError(f"cell: {cell} is not allowed; give another")


def deadly(cell):
    """End the process."""
    os.kill(os.getpid(), signal.SIGKILL)


def threads(cell):
    """Return the number of threads that the environment gives, and that of the process beyond those of Python."""
    return os.environ.get("OMP_NUM_THREADS"), len(os.listdir("/proc/self/task")) - threading.active_count()

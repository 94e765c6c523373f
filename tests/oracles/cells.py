"""Cells: tasks of grids that other processes import by their names."""

import os
import signal
import time
from pathlib import Path

import numpy as np


def waves(cell):
    """Plain data and an array, from a seed and a size."""
    seed, size = cell
    values = np.random.default_rng(seed).normal(size=size)
    return {"seed": seed, "values": np.sin(values), "mean": float(values.mean()), "nothing": None, "nan": float("nan")}


def mortal(cell):
    """The same, but a worker dies the first time that it gets a certain cell; a file remembers that."""
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
    """The same, and a line in a file for each time that it is done; slow from a certain cell on."""
    folder, seed, slow = cell
    with (Path(folder) / "done").open("a") as file:
        file.write(f"{seed}\n")
    time.sleep(30.0 if slow else 0.0)
    return waves((seed, 5))


def waking():
    """A line in a file for each process that is prepared."""
    with Path("prepared").open("a") as file:
        file.write(f"{os.getpid()}\n")


def refusing(cell):
    """An error of its own."""
    raise ValueError(f"cell: {cell} is not allowed; give another")


def deadly(cell):
    """The end of its process."""
    os.kill(os.getpid(), signal.SIGKILL)

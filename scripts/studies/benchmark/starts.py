"""Starts: what a new process pays before its first step, with and without compiled kernels on disk."""

import json
import os
import subprocess
import sys
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from studies.benchmark.rows import STARTS, Row

ROOT = Path(__file__).parents[3]
IMPORT, FIRST, MORE = "import flexman_gym", "gym.make and first reset", "then gym.make_vec of 64 arms and first reset"
COLD, WARM = "nothing compiled yet", "compiled kernels on disk"
SCRIPT = f"""
import json, time
marks = [(time.process_time(), time.perf_counter())]
def mark():
    marks.append((time.process_time(), time.perf_counter()))
import flexman_gym
mark()
import gymnasium as gym
gym.make("FlexRRR-v0").reset(seed=0)
mark()
gym.make_vec("FlexRRR-v0", 64, "vector_entry_point").reset(seed=0)
mark()
names = {[IMPORT, FIRST, MORE]}
print(json.dumps({{n: [b - a for a, b in zip(*p)] for n, p in zip(names, zip(marks, marks[1:]))}}))
"""


def start(cache: str | None = None) -> dict[str, list[float]]:
    """CPU time and time of the clock (s) of each part of the start of a new process; cache is a folder for kernels."""
    environment = os.environ | {"PYTHONPATH": os.pathsep.join([str(ROOT), *_paths()])}
    if cache is not None:
        environment["NUMBA_CACHE_DIR"] = cache
    done = subprocess.run([sys.executable, "-c", SCRIPT], capture_output=True, text=True, env=environment, check=True)
    result: dict[str, list[float]] = json.loads(done.stdout)
    return result


def _paths() -> list[str]:
    return [path for path in os.environ.get("PYTHONPATH", "").split(os.pathsep) if path]


def rows(rounds: int, cold: bool) -> list[Row]:
    """Rows of warm starts, medians over the rounds, and of a cold one, which takes more than a minute."""
    result: list[Row] = []
    if cold:
        with TemporaryDirectory() as cache:
            for name, (cpu, wall) in start(cache).items():
                result.append(Row(STARTS, f"{name}, {COLD}", None, None, cpu, wall))
    start()  # compiles what is not on disk
    starts = [start() for _ in range(rounds)]
    for name in starts[0]:
        cpu, wall = np.median([each[name] for each in starts], axis=0)
        result.append(Row(STARTS, f"{name}, {WARM}", None, None, float(cpu), float(wall)))
    return result

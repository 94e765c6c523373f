"""Time of the phases of a first use, in new processes: with a wheel, without compiled kernels, and with them."""

import json
import os
import subprocess
import sys
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

ROOT = Path(__file__).parents[3]
WHEEL, COLD, WARM = "wheel with machine code", "kernels to be compiled", "compiled kernels on disk"
WAYS = (WHEEL, COLD, WARM)
PHASES = {  # name -> code
    "imports": "import gymnasium as gym, flexman_gym as fm",
    "one arm": "env = gym.make('FlexRRR-v0'); env.reset(seed=0); env.step(env.action_space.sample())",
    "64 arms": "envs = gym.make_vec('FlexRRR-v0', 64, 'vector_entry_point'); envs.reset(seed=0);"
               "envs.step(envs.action_space.sample())",
    "simulation": "fm.simulate(fm.catalog.paper_scene('rr'))",
    "evaluation": "fm.evaluate('lqr-tracking', 'FlexRRR-v0', seeds=range(9000, 9010))",
}  # fmt: skip
SCRIPT = f"""
import json, os, time
marks = [(sum(os.times()[:4]), time.perf_counter())]  # CPU time of this process and of those that it waited for
for code in {list(PHASES.values())!r}:
    exec(code)
    marks.append((sum(os.times()[:4]), time.perf_counter()))
print(json.dumps([[b - a for a, b in zip(*pair)] for pair in zip(marks, marks[1:])]))
"""


@dataclass(frozen=True)
class StartRow:
    """Time of a phase of a first use.

    Attributes:
        way: one of `WAYS`.
        phase: a name of `PHASES`; each follows the ones before it in the same process.
        run: number of the process, from 0.
        cpu, wall: CPU time, of all processes, and wall-clock time, s.
    """

    way: str
    phase: str
    run: float
    cpu: float
    wall: float


def start_rows(runs: int, wheel: str | None, cold: bool = True) -> Iterator[StartRow]:
    """Yield the rows of a number of runs; the ways take turns.

    Args:
        runs: number of processes of each way.
        wheel: interpreter of an environment with an installed wheel; None measures no wheel.
        cold: measure starts with compilations, too.
    """
    with TemporaryDirectory() as folder:
        warm = Path(folder, "warm")
        _times(sys.executable, warm)
        for run in range(runs):
            if wheel is not None:
                yield from _rows(WHEEL, run, _times(wheel, Path(folder, f"wheel-{run}")))
            if cold:
                yield from _rows(COLD, run, _times(sys.executable, Path(folder, f"cold-{run}")))
            yield from _rows(WARM, run, _times(sys.executable, warm))


def _rows(way: str, run: int, times: Mapping[str, tuple[float, float]]) -> Iterator[StartRow]:
    for phase, (cpu, wall) in times.items():
        yield StartRow(way, phase, run, cpu, wall)


def _times(python: str, cache: Path) -> dict[str, tuple[float, float]]:
    """Return CPU and wall-clock time (s) of each phase of a new process; `cache` is the folder of compiled kernels.

    The interpreter of this process imports the package of this checkout, others what they have installed.
    """
    cache.mkdir(exist_ok=True)
    paths = {"PYTHONPATH": str(ROOT) if python == sys.executable else ""}
    command, settings = [python, "-c", SCRIPT], os.environ | paths | {"NUMBA_CACHE_DIR": str(cache)}
    done = subprocess.run(command, capture_output=True, text=True, env=settings, cwd=cache, check=True)
    return dict(zip(PHASES, json.loads(done.stdout), strict=True))

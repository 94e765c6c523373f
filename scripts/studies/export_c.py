"""Durations of steps of controllers that are exported as C, with real-time priority."""

import re
import subprocess
from dataclasses import dataclass
from pathlib import Path

from flexman_gym.common.computer import computer_text
from flexman_gym.toolbox.deployment.c_code import begin_agent, write_c

AGENTS = ("pd", "pd-shaped", "lqr", "lqr-tracking", "lqg", "ppo-flexrrr")
ENVIRONMENT = "FlexRRR-v0"  # three joints
PRIORITY = ("chrt", "-f", "50")  # SCHED_FIFO


@dataclass(frozen=True)
class StepRow:
    """Durations of 10^6 steps of a controller in C.

    Attributes:
        agent: agent on `ENVIRONMENT`.
        longest, most, median: longest, 99.9th percentile and median of the wall time of a step, us.
        cpu_longest, cpu_most, cpu_median: the same of the CPU time of the thread.
        code: code and constants, bytes.
        state: size of the state, bytes.
    """

    agent: str
    longest: float
    most: float
    median: float
    cpu_longest: float
    cpu_most: float
    cpu_median: float
    code: float
    state: float


def measure(agent: str, place: Path) -> StepRow:
    """Export an agent into a folder, compile it with gcc -O2 and time its steps with real-time priority."""
    paths = write_c(begin_agent(agent, "" if agent.endswith("flexrrr") else ENVIRONMENT), place)
    (source,) = (path for path in paths if path.suffix == ".c" and path.name != "main.c")
    _run("gcc", "-std=c99", "-O2", "-c", str(source), "-o", str(place / "step.o"))
    _run("gcc", "-std=c99", "-O2", str(source), str(place / "main.c"), "-lm", "-o", str(place / "test"))
    numbers = [float(each) / 1e3 for each in re.findall(r"(\d+) ns", _run(*PRIORITY, str(place / "test"), "time"))]
    text, data, *_ = map(int, _run("size", str(place / "step.o")).splitlines()[1].split()[:3])
    state = re.search(r"state (\d+) bytes", _run(str(place / "test")))
    sizes = float(text + data), float(state[1] if state else "nan")
    return StepRow(agent, *[*numbers, *sizes])


def conditions() -> str:
    """Return processor, versions, compiler and priority."""
    compiler = _run("gcc", "-dumpfullversion").strip()
    return f"{computer_text()}, gcc {compiler} -O2, SCHED_FIFO {PRIORITY[-1]}"


def _run(*words: str) -> str:
    return subprocess.run(words, capture_output=True, text=True, check=True).stdout

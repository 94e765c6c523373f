"""Compilation of all kernels that the first use of the package needs, in one wait.

The first kernel that is neither in the machine code of a wheel nor in the cache starts it: processes, one for each
idle core and at most three, compile the kernels of `JOBS`, while other processes that need kernels wait. A file in the
cache folder records the end; kernels for other uses compile when they are needed. FLEXMAN_COMPILE_AHEAD=0 turns it off.
"""

import fcntl
import os
import subprocess
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from tempfile import TemporaryFile
from typing import IO, Any, NamedTuple

from numba.core import event

from flexman_gym.kernels.cache import is_quiet

PACKAGE = Path(__file__).parents[1]
SETTING = "FLEXMAN_COMPILE_AHEAD"
DONE, LOCK = "first_use", "first_use.lock"  # files in the cache folder
INTERVAL = 0.25  # s; time between two looks at the processes
ERASE = "\r\x1b[K"  # erases a line of the terminal


class Share(NamedTuple):
    """Jobs of a process, which compiles functions that they have in common once.

    Attributes:
        jobs: names of the jobs.
        seconds: duration on a processor of 2024, s.
        functions: number of functions that are compiled.
        half: duration until half of them are compiled, s.
    """

    jobs: tuple[str, ...]
    seconds: float
    functions: int
    half: float


JOBS = {  # name -> purpose of the kernels; `commands.compile` runs the jobs
    "single": "one arm", "simulation": "simulation", "control": "controllers", "batch": "many arms",
}  # fmt: skip
SHARES = {  # number of processes -> their shares
    1: (Share(tuple(JOBS), 54.0, 414, 30.0),),
    2: (Share(("single", "simulation", "control"), 41.0, 245, 12.0), Share(("batch",), 29.0, 246, 10.0)),
    3: (Share(("batch",), 29.0, 246, 10.0), Share(("single", "simulation"), 28.0, 160, 8.0),
        Share(("control",), 17.0, 165, 9.0)),
}  # fmt: skip
_tried = False  # True after an attempt in this process


class _Process:
    """Process with a share of the jobs; it prints a line for each function that it has compiled."""

    def __init__(self, share: Share) -> None:
        paths = [str(PACKAGE.parent), *filter(None, [os.environ.get("PYTHONPATH")])]
        settings = os.environ | {SETTING: "0", "FLEXMAN_QUIET": "1", "PYTHONPATH": os.pathsep.join(paths)}
        self._share, self._factor = share, 1.0  # factor: duration / that of the share, measured in its first half
        self._started, self._compiled = time.monotonic(), 0
        self._errors = TemporaryFile()  # noqa: SIM115  closed by `error`
        self._process = subprocess.Popen(_command(share), env=settings, stdout=subprocess.PIPE, stderr=self._errors)
        os.set_blocking(self._output.fileno(), False)

    @property
    def _output(self) -> Any:
        return self._process.stdout

    def ends(self) -> bool:
        """Return True if the process has ended; read its output and measure its speed."""
        if 2 * self._compiled < self._share.functions:
            self._compiled += (self._output.read() or b"").count(b"\n")
            factor = (time.monotonic() - self._started) / self._share.half
            self._factor = factor if 2 * self._compiled >= self._share.functions else max(1.0, factor)
        return self._process.poll() is not None

    def remaining(self) -> float:
        """Return the estimated time until the end, s."""
        return max(INTERVAL, self._factor * self._share.seconds - time.monotonic() + self._started)

    def error(self) -> str:
        """Return the last line of the error of a process that has ended; empty if it succeeded."""
        with self._errors as file:
            file.seek(0)
            lines = file.read().decode(errors="replace").split("\n")
        status = self._process.returncode
        return next((line for line in reversed(lines) if line.strip()), f"exit status {status}") if status else ""


def _command(share: Share) -> list[str]:
    """Return the command of a process."""
    return [sys.executable, "-m", PACKAGE.name, "compile", *share.jobs, "--count"]


def is_first_use(folder: str) -> bool:
    """Return True if the kernels of the first use are not in a cache folder, and this process may compile them."""
    allowed = os.environ.get(SETTING) != "0" and bool(sys.executable)
    return allowed and not _tried and not is_done(folder)


def is_done(folder: str) -> bool:
    """Return True if the kernels of the first use are in a cache folder."""
    return (Path(folder) / DONE).exists()


def compile_first_use(folder: str) -> str:
    """Compile the kernels of all jobs into a cache folder, or wait for the process that does.

    A line on a terminal tells the remaining time.

    Returns:
        The error of a process that failed; empty if all kernels are in the folder.
    """
    global _tried
    _tried = True
    with (Path(folder) / LOCK).open("w") as lock:
        _wait_for(lock)
        if is_done(folder):
            return ""
        error = _run(SHARES[min(_idle_cores(), max(SHARES))])
        if not error:
            (Path(folder) / DONE).touch()
        return error


def compile_when_needed() -> None:
    """Let this process compile each kernel at its first use, as its kernels are others than those of `JOBS`."""
    global _tried
    _tried = True


def _wait_for(lock: IO[str]) -> None:
    """Lock a file; a line on the terminal tells that another process compiles meanwhile."""
    try:
        fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        show_line("flexman_gym waits for another process that compiles its kernels")
        fcntl.flock(lock, fcntl.LOCK_EX)
        show_line("")


def count_functions() -> None:
    """Print an empty line for each function that Numba compiles in this process."""

    class Count(event.Listener):
        def on_start(self, event: Any) -> None:
            """Do nothing when a compilation starts."""

        def on_end(self, event: Any) -> None:
            """Print a line."""
            print(flush=True)

    event.register("numba:compile", Count())


def _idle_cores() -> int:
    """Return the number of cores without work, at least 1."""
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    return max(1, round(cores - os.getloadavg()[0]))


def _run(shares: Sequence[Share]) -> str:
    """Run a process for each share at once; return the error of one that failed."""
    running, error = [_Process(each) for each in shares], ""
    while running:
        _show_remaining(max(each.remaining() for each in running))
        time.sleep(INTERVAL)
        ended = [each for each in running if each.ends()]
        running = [each for each in running if each not in ended]
        error = next(filter(None, (each.error() for each in ended)), error)
    _show_remaining(0.0)
    return error


def _show_remaining(seconds: float) -> None:
    """Write the remaining time (s) in the line of the terminal; erase the line at the end."""
    show_line(f"flexman_gym compiles its kernels, once: about {seconds:.0f} s left" if seconds else "")


def show_line(text: str) -> None:
    """Replace the last line of the terminal, if stderr is one; an empty text erases it."""
    if not is_quiet() and sys.stderr.isatty():
        sys.stderr.write(f"{ERASE}{text}")
        sys.stderr.flush()

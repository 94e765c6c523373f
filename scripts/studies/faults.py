"""Fault tolerance of training runs: kills, interrupts, a full disk, and two runs in one folder.

Each row is one kind of fault, tested on real processes that run `flexman train`.
"""

import random
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from flexman_gym.common import files
from flexman_gym.common.markdown import markdown_table
from flexman_gym.common.run_folder import NEWEST, SETTINGS, read_npz
from studies.screen import screen

TRAIN = "-m", "flexman_gym", "train"
PART = f".{NEWEST}.part"
ENVIRONMENT = {
    "id": "FlexOne-v0", "base": "pd", "action_repeat": 5, "sensors": ["full", "fine"], "horizon": 2.0,
    "randomisation": {"payload_mass": [0.0, 0.1], "delay": [0, 1], "sensor_noise": [0.0, 0.01]},
}  # fmt: skip
RECIPES: dict[str, dict[str, Any]] = {
    "ppo": {"algo": "ppo", "steps": 24_000, "envs": 16, "hyperparameters": {"n_steps": 10, "net_arch": [64, 64]}},
    "sac": {
        "algo": "sac", "steps": 6_000, "envs": 16,
        "hyperparameters": {"learning_starts": 320, "batch_size": 64, "net_arch": [64, 64], "buffer_size": 50_000},
    },
}  # fmt: skip
EVERY = {"ppo": 160, "sac": 64}  # steps between checkpoints, short so that saving takes much of the time
POLL_INTERVAL = 2e-4  # s; a saving takes milliseconds; to wait without a pause takes the time of a processor
DISK = "8m"  # size of the disk that becomes full
HEADS = ("fault", "tried", "survived", "lost")
QUESTION = "What is lost if a training is killed, interrupted, started twice or runs on a full disk?"
ANSWER = """**{survived} of {tried} trainings that were disturbed could be resumed, and all of these end bitwise
equal to an undisturbed training.** A kill costs the steps since the last checkpoint."""
BODY = """{table}

The trainings run `FlexOne-v0` with randomised payloads, delays and noise, with a checkpoint every few rollouts. *Equal*
refers to networks, optimiser, normalisation, replay buffer, random generators and arms. Damaged caches of kernels and
files that attempt to run code are covered by `tests/kernels/test_cache.py` and `tests/agents/test_run_folder.py`."""


@dataclass(frozen=True)
class Fault:
    """Row of the table: fault, number of trials, survived trials, and losses."""

    fault: str
    tried: int
    survived: int
    lost: str


def page(faults: Sequence[Fault], comments: Mapping[str, str]) -> str:
    """Return the page as Markdown; `comments` is the file of the rows with its comment."""
    survived, tried = (sum(getattr(row, name) for row in faults) for name in ("survived", "tried"))
    answer = ANSWER.format(survived=f"{survived:g}", tried=f"{tried:g}")
    cells = [(row.fault, f"{row.tried:g}", f"{row.survived:g}", row.lost) for row in faults]
    body = BODY.format(table="\n".join(markdown_table(HEADS, cells)))
    return screen("Fault tolerance of training", QUESTION, answer, body, comments, "faults")


def faults(folder: Path, kills: tuple[int, int]) -> Iterator[Fault]:
    """Test all faults in a folder; `kills` are the numbers of kills during saving and at any time, per algorithm."""
    for algo, recipe in RECIPES.items():
        path = folder / f"{algo}.yaml"
        files.write_data(path, {"environment": ENVIRONMENT, **recipe})
        whole = folder / f"{algo}-whole"
        _finish(["--folder", whole], path, algo)
        yield _killed(f"kill -9 inside saving, {algo}", (path, algo, whole), kills[0], _inside_saving)
        yield _killed(f"kill -9 at any time, {algo}", (path, algo, whole), kills[1], _any_time)
    path = folder / "ppo.yaml"
    yield _interrupted("Ctrl-C before the first saving", path, folder / "early", 0)
    yield _interrupted("Ctrl-C after the first saving", path, folder / "late", EVERY["ppo"])
    yield _two_at_once(path, folder / "two")


def same(first: Path, second: Path) -> bool:
    """Return whether two runs are bitwise equal except for wall-clock times."""
    result = []
    for folder in (first, second):
        data = read_npz(folder / NEWEST)
        del data["training"]["environment"]["action_space"]  # random state of an unused space
        data["training"]["episodes"] = [each[:2] for each in data["training"]["episodes"]]
        result.append(data)
    try:
        np.testing.assert_equal(*result)
    except AssertionError:
        return False
    return True


def _start(arguments: list[Any], algo: str) -> subprocess.Popen[str]:
    command = [sys.executable, *TRAIN, *arguments, "--quiet", "--checkpoint-every", EVERY[algo]]
    return subprocess.Popen([str(word) for word in command], stderr=subprocess.PIPE, stdout=subprocess.PIPE, text=True)


def _finish(arguments: list[Any], recipe: Path | None, algo: str) -> tuple[int, str]:
    """Run to the end; return the exit status and the error output."""
    process = _start([recipe, *arguments] if recipe else arguments, algo)
    _, errors = process.communicate()
    return process.returncode, errors


def _killed(name: str, run: tuple[Path, str, Path], kills: int, moment: Callable[[Path, random.Random], None]) -> Fault:
    """Kill and resume a run repeatedly, and compare its end with that of an uninterrupted run."""
    recipe, algo, whole = run
    folder, chance = whole.with_name(f"{algo}-{moment.__name__}"), random.Random(0)
    shutil.rmtree(folder, ignore_errors=True)
    done = survived = before = 0
    most = 0
    while done < kills:
        begun = (folder / SETTINGS).is_file()
        process = _start(["--resume", "--folder", folder] if begun else [recipe, "--folder", folder], algo)
        moment(folder, chance)
        if process.poll() is not None:  # the run finished before the kill: repeat
            shutil.rmtree(folder)
            before = 0
            continue
        process.kill()
        process.communicate()
        done += 1
        steps = _steps(folder)
        survived += steps >= before
        most, before = max(most, steps - before), steps
    code, errors = _finish(["--resume", "--folder", folder], None, algo)
    equal = code == 0 and same(whole, folder)
    lost = f"steps since the last saving; the end {'has the same bits' if equal else f'is another: {errors}'}"
    return Fault(name, kills, survived if equal else 0, lost)


def _steps(folder: Path) -> int:
    """Return the training step of the newest checkpoint, 0 without one, -1 if it cannot be read."""
    if not (folder / NEWEST).is_file():
        return 0
    try:
        return int(read_npz(folder / NEWEST)["training"]["counts"]["num_timesteps"])
    except ValueError:
        return -1


def _inside_saving(folder: Path, chance: random.Random) -> None:
    """Wait for one of the next savings and for a random part of its duration."""
    for _ in range(chance.randint(1, 4)):
        _wait_for(lambda: (folder / PART).exists())
        last = time.perf_counter()
        _wait_for(lambda: not (folder / PART).exists(), 0.002)
    _wait_for(lambda: (folder / PART).exists())
    time.sleep(chance.uniform(0.0, 0.004) * (time.perf_counter() >= last))


def _any_time(folder: Path, chance: random.Random) -> None:
    _wait_for(lambda: (folder / NEWEST).exists())
    time.sleep(chance.uniform(2.0, 7.0))


def _wait_for(happened: Callable[[], bool], longest: float = 60.0) -> None:
    end = time.perf_counter() + longest
    while not happened() and time.perf_counter() < end:
        time.sleep(POLL_INTERVAL)


def _interrupted(name: str, recipe: Path, folder: Path, steps: int) -> Fault:
    """Interrupt a run once with Ctrl-C and resume it."""
    process = _start([recipe, "--folder", folder], "ppo")
    if steps:
        _wait_for(lambda: _steps(folder) >= steps)
    else:
        _wait_for(lambda: any(folder.glob("events.out.*")))
    process.send_signal(signal.SIGINT)
    _, errors = process.communicate()
    saved = "the run is saved" in errors and process.returncode == 130
    _finish(["--resume", "--folder", folder], None, "ppo")
    whole = folder.with_name("ppo-whole")
    return Fault(name, 1, int(saved and same(whole, folder)), "nothing; the end has the same bits" if saved else errors)


def _two_at_once(recipe: Path, folder: Path) -> Fault:
    """Start a second training in the folder of a running one."""
    process = _start([recipe, "--folder", folder], "ppo")
    _wait_for(lambda: (folder / NEWEST).exists())
    code, errors = _finish(["--resume", "--folder", folder], None, "ppo")
    process.communicate()
    refused = code == 2 and f"process {process.pid} trains in it" in errors
    fine = refused and process.returncode == 0 and same(folder.with_name("ppo-whole"), folder)
    return Fault("two trainings in one folder", 1, int(fine), "nothing; the second is refused in one line")


@contextmanager
def small_disk(folder: Path) -> Iterator[Path]:
    """Mount a file system of a few MB at a new folder, and yield the folder.

    Raises:
        OSError: if it cannot be mounted.
    """
    folder.mkdir()
    words = ["mount", "-t", "tmpfs", "-o", f"size={DISK}", "tmpfs", str(folder)]
    done = subprocess.run(words, capture_output=True, text=True)
    if done.returncode:
        raise OSError(f"{folder}: {done.stderr.strip()}; run the study as root, which may mount a small file system")
    try:
        yield folder
    finally:
        subprocess.run(["umount", "--lazy", str(folder)], check=False)


def disk_full(folder: Path, small: Path) -> Fault:
    """Train on a small file system, fill the disk, free it again, and resume."""
    run, ballast = small / "run", small / "ballast"
    process = _start([folder / "ppo.yaml", "--folder", run], "ppo")
    _wait_for(lambda: _steps(run) > 0)
    with suppress(OSError), ballast.open("wb") as filled:
        while True:
            filled.write(bytes(4096))
            filled.flush()
    _, errors = process.communicate()
    full = process.returncode == 2 and "No space left" in errors and len(errors.strip().splitlines()) == 1
    steps = _steps(run)
    ballast.unlink()
    code, more = _finish(["--resume", "--folder", run], None, "ppo")
    fine = full and steps > 0 and code == 0 and same(folder / "ppo-whole", run)
    return Fault("disk full", 1, int(fine), "steps since the last saving; one line" if fine else errors + more)

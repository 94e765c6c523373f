"""One wait for the kernels of the first use: in processes, of which a small package has its own."""

import fcntl
import os
import pty
import subprocess
import sys
import threading
from pathlib import Path

import pytest

from flexman_gym.kernels import first_use

from oracles.files import ROOT
from oracles.small_package import CALL, copied, process, run

USE = """import sys
from pathlib import Path
print(*sys.argv[1:], file=Path(__file__).with_name("calls").open("a"))
from flexman_gym.kernels.caller import doubled
doubled()
"""
ALLOWED = {"FLEXMAN_COMPILE_AHEAD": "1"}


@pytest.fixture
def package(tmp_path):
    """Return a package whose command uses its kernels and keeps its arguments in the file `calls`."""
    copied(tmp_path, 1)
    (tmp_path / "flexman_gym" / "__main__.py").write_text(USE)
    return tmp_path


def calls(package):
    """Return the jobs that were run, without repetitions of the same call."""
    return (package / "flexman_gym" / "calls").read_text().splitlines()


@pytest.mark.slow
def test_the_first_missing_kernel_waits_for_the_jobs_and_is_loaded(package):
    """All jobs run once; a file in the folder tells later processes."""
    assert run(package, package / "cache", CALL, **ALLOWED)[:2] == ["2", "1"]
    jobs = [word for line in calls(package) for word in line.split() if word in first_use.JOBS]
    assert sorted(jobs) == sorted(first_use.JOBS)
    (done,) = (package / "cache").glob(f"flexman_gym/*/{first_use.DONE}")
    for kernel in done.parent.glob("*.nb?"):
        kernel.unlink()
    assert run(package, package / "cache", CALL, **ALLOWED)[:2] == ["2", "0"], "a kernel of a later use compiles here"
    assert len(jobs) == len([word for line in calls(package) for word in line.split() if word in first_use.JOBS])


@pytest.mark.slow
def test_two_processes_that_start_at_once_wait_for_the_same_jobs(package):
    results = []
    threads = [
        threading.Thread(target=lambda: results.append(run(package, package / "cache", CALL, **ALLOWED)[:2]))
        for _ in range(2)
    ]
    for each in threads:
        each.start()
    for each in threads:
        each.join()
    assert results == [["2", "1"]] * 2
    assert sum(line.split().count("batch") for line in calls(package)) == 1


@pytest.mark.slow
@pytest.mark.parametrize("command", ["raise SystemExit('no kernels')", "import nothing_of_this_name"])
def test_kernels_compile_in_the_process_itself_if_the_jobs_fail(package, command):
    (package / "flexman_gym" / "__main__.py").write_text(command)
    assert run(package, package / "cache", CALL, **ALLOWED)[:2] == ["2", "0"]
    assert not list((package / "cache").glob(f"flexman_gym/*/{first_use.DONE}"))


@pytest.mark.slow
def test_a_setting_turns_it_off(package):
    assert run(package, package / "cache", CALL)[:2] == ["2", "0"]
    assert not (package / "flexman_gym" / "calls").exists()


@pytest.mark.slow
def test_a_process_can_compile_each_kernel_when_it_is_needed(package):
    script = f"from flexman_gym.kernels import first_use; first_use.compile_when_needed(); {CALL}"
    assert run(package, package / "cache", script, **ALLOWED)[:2] == ["2", "0"]
    assert not (package / "flexman_gym" / "calls").exists()


def test_a_process_that_waits_for_another_one_tells_so(tmp_path, monkeypatch):
    lines, told = [], threading.Event()
    monkeypatch.setattr(first_use, "show_line", lambda text: (lines.append(text), told.set()))
    with (tmp_path / "lock").open("w") as theirs, (tmp_path / "lock").open("w") as own:
        fcntl.flock(theirs, fcntl.LOCK_EX)
        waiting = threading.Thread(target=first_use._wait_for, args=(own,))
        waiting.start()
        assert told.wait(60.0)
        assert lines == ["flexman_gym waits for another process that compiles its kernels"] and waiting.is_alive()
        fcntl.flock(theirs, fcntl.LOCK_UN)
        waiting.join(60.0)
        assert lines[1:] == [""]


@pytest.mark.slow
def test_the_error_of_a_failed_job_is_returned(package):
    (package / "flexman_gym" / "__main__.py").write_text("raise SystemExit('no kernels')")
    script = "from flexman_gym import kernels; print(kernels.first_use.compile_first_use(kernels.CACHE_FOLDER))"
    assert process(package, package / "cache", script).stdout == "no kernels\n"


@pytest.mark.slow
def test_a_terminal_shows_the_remaining_time_in_one_line_that_is_erased(package):
    names = {key: value for key, value in os.environ.items() if key != "FLEXMAN_QUIET"} | ALLOWED
    settings = {"PYTHONPATH": str(package), "NUMBA_CACHE_DIR": str(package / "cache")}
    terminal, theirs = pty.openpty()
    done = subprocess.run(
        [sys.executable, "-c", CALL], stdout=subprocess.PIPE, stderr=theirs, env=names | settings, cwd=package
    )
    os.close(theirs)
    words = os.read(terminal, 10_000).decode()
    os.close(terminal)
    assert done.returncode == 0 and done.stdout.split()[:2] == [b"2", b"1"]
    first, *_, last = words.split(first_use.ERASE)[1:]
    assert first.startswith("flexman_gym compiles its kernels, once: about ") and first.endswith(" s left")
    assert last == "" and "\n" not in words


@pytest.mark.slow
def test_without_a_terminal_nothing_is_written(package):
    done = process(package, package / "cache", CALL, **ALLOWED, FLEXMAN_QUIET="0")
    assert done.returncode == 0 and done.stderr == ""


def test_the_remaining_time_follows_the_measured_speed(monkeypatch):
    """A process as fast as listed, and others, measured when half of its functions are compiled."""
    share, clock = first_use.Share(("batch",), 30.0, 10, 12.0), [100.0]
    monkeypatch.setattr(first_use.time, "monotonic", lambda: clock[0])
    script = "import time; print('\\n' * 4, flush=True); time.sleep(600)"  # 5 functions
    monkeypatch.setattr(first_use, "_command", lambda share: [sys.executable, "-c", script])
    for factor in (0.5, 1.0, 2.0):
        started = clock[0]
        running = first_use._Process(share)
        assert running.remaining() == 30.0
        clock[0] = started + 12.0 * factor
        while running._compiled < 5:
            assert not running.ends()
        assert running.remaining() == pytest.approx(18.0 * factor)
        running._process.kill()
        running._process.communicate()


@pytest.mark.parametrize(("cores", "load", "idle"), [(1, 0.0, 1), (2, 0.1, 2), (8, 1.0, 7), (4, 9.0, 1)])
def test_idle_cores_are_those_without_work(monkeypatch, cores, load, idle):
    monkeypatch.setattr(first_use.os, "sched_getaffinity", lambda _: set(range(cores)))
    monkeypatch.setattr(first_use.os, "getloadavg", lambda: (load, 0.0, 0.0))
    assert first_use._idle_cores() == idle


def test_the_package_of_the_processes_is_this_one():
    assert Path(first_use.__file__).parents[2] == ROOT

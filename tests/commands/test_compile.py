"""Command line, and the words while kernels compile."""

import os
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import pytest

import flexman_gym
from flexman_gym import __main__, kernels
from flexman_gym.commands import check, compile
from flexman_gym.kernels import batch, first_use, implicit, machine_code
from flexman_gym.kernels.first_use import ERASE

ROOT = Path(flexman_gym.__file__).parents[1]
OTHER = """import numba, flexman_gym
@numba.njit
def one():
    return 1
one()
"""


def run(*arguments, cache=None, **settings):
    """A Python process of its own, with the kernels of `cache` or else of this process."""
    names = {key: value for key, value in os.environ.items() if key != "FLEXMAN_QUIET"}
    environment = names | {"PYTHONPATH": str(ROOT)} | settings | ({"NUMBA_CACHE_DIR": str(cache)} if cache else {})
    return subprocess.run([sys.executable, *arguments], capture_output=True, text=True, env=environment, timeout=600)


def test_a_line_of_the_terminal_tells_that_a_kernel_compiles(capsys, monkeypatch):
    """It is erased at the end; without a terminal, with FLEXMAN_QUIET and for kernels of others there is none."""
    monkeypatch.delenv("FLEXMAN_QUIET", raising=False)
    line = "flexman_gym compiles a kernel, once"

    def written(kernel):
        words = kernels._CompileMessages()
        words.on_start(SimpleNamespace(data={"dispatcher": kernel}))
        words.on_start(SimpleNamespace(data={"dispatcher": implicit.midpoint_step}))  # called by the kernel
        words.on_end(None)
        words.on_end(None)
        return capsys.readouterr().err

    assert written(batch.advance_single) == ""
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True)
    assert written(batch.advance_single) == f"{ERASE}{line}{ERASE}"
    assert written(SimpleNamespace(py_func=test_a_line_of_the_terminal_tells_that_a_kernel_compiles)) == ""
    monkeypatch.setenv("FLEXMAN_QUIET", "1")
    assert written(batch.advance_single) == ""


@pytest.mark.slow
def test_kernels_of_others_compile_without_words(tmp_path):
    assert run("-c", OTHER, cache=tmp_path).stderr == ""


@pytest.mark.slow
def test_compile_says_what_it_does():
    done = run("-m", "flexman_gym", "compile")
    assert done.returncode == 0, done.stderr
    first, last = done.stdout.splitlines()
    assert first == f"compiling kernels for {', '.join(first_use.JOBS.values())}, into {kernels.CACHE_FOLDER}"
    assert last.startswith("ready after ") and done.stderr == ""


def test_every_job_of_the_first_use_is_in_one_share_and_has_a_use():
    assert list(first_use.SHARES) == [1, 2, 3] and compile.USES.keys() == first_use.JOBS.keys()
    for count, shares in first_use.SHARES.items():
        assert len(shares) == count
        assert sorted(job for each in shares for job in each.jobs) == sorted(first_use.JOBS)


@pytest.mark.slow
def test_check_says_versions_kernels_and_steps():
    run("-m", "flexman_gym", "compile")
    done = run("-m", "flexman_gym", "check")
    assert done.returncode == 0, done.stderr
    result = dict(line.split(": ", 1) for line in done.stdout.splitlines())
    assert {"python", "flexman_gym", "numba", "numpy", "scipy", "gymnasium", "processor"} <= result.keys()
    assert result["compiled kernels"] == f"in {kernels.CACHE_FOLDER}"
    assert result["machine code of the wheel"] == "not used: this installation brings none"
    assert result["vector registers"].endswith(" bits") and " per CPU second" in result["steps of FlexRRR-v0"]


def test_check_says_where_kernels_come_from(tmp_path, monkeypatch, capsys):
    """Compiled later, compiled in every process, and machine code for the level in use."""
    monkeypatch.setattr(check, "_steps_per_second", lambda: 1.0)

    def said():
        assert __main__.main(["check"]) == 0
        return capsys.readouterr().out.splitlines()

    monkeypatch.setattr(kernels, "CACHE_FOLDER", str(tmp_path))
    assert f"compiled kernels: not yet, in {tmp_path}" in said()
    monkeypatch.setattr(kernels, "CACHE_FOLDER", None)
    assert "compiled kernels: in every process, as no folder has write access for this user only" in said()
    monkeypatch.setattr(machine_code, "LEVEL", "x86-64-v3")
    assert "machine code of the wheel: x86-64-v3" in said()
    assert __main__.main(["compile"]) == 0
    assert "nothing to compile: this installation brings machine code for x86-64-v3" in capsys.readouterr().out


@pytest.mark.parametrize("wrong", [["--fly"], ["fly"], ["compile", "two"]])
def test_a_wrong_command_is_refused(wrong, capsys):
    with pytest.raises(SystemExit) as stop:
        __main__.main(wrong)
    assert stop.value.code == 2
    assert capsys.readouterr().err.splitlines()[-1].startswith("flexman")

"""Command line, and the words while kernels compile."""

import os
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import pytest

import flexman_gym
from flexman_gym import __main__, kernels
from flexman_gym.commands import check
from flexman_gym.kernels import batch, control_period, implicit, inverse, runge_kutta

ROOT = Path(flexman_gym.__file__).parents[1]
WORDS = "flexman_gym compiles kernels"
SMALL = """import numpy as np
from flexman_gym.kernels.control_period import flag_violations, sparse_product
sparse_product(np.ones((1, 1)), np.array([0, 1]), np.array([0]), np.ones(1), np.ones((1, 1)))
flag_violations(np.ones((1, 1)), np.ones(1), np.ones((1, 1)), np.ones(1), np.zeros(1, dtype=np.int64), np.zeros(1,
dtype=bool))
"""
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


@pytest.mark.slow
def test_the_words_come_once_and_not_when_kernels_are_on_disk(tmp_path):
    first, again = run("-c", SMALL, cache=tmp_path), run("-c", SMALL, cache=tmp_path)
    assert first.stderr.count(WORDS) == 1 and len(first.stderr.splitlines()) == 1
    assert str(tmp_path) in first.stderr
    assert again.stderr == ""
    assert first.returncode == again.returncode == 0 and first.stdout == again.stdout == ""


def test_each_kernel_that_takes_long_says_how_long_is_left(capsys, monkeypatch):
    monkeypatch.delenv("FLEXMAN_QUIET", raising=False)
    clock = iter((0.0, 12.0, 12.0, 29.0, 30.0))  # the first kernel takes 2.4 times as long as listed
    monkeypatch.setattr(kernels.time, "perf_counter", lambda: next(clock))
    words = kernels._CompileMessages()

    def compile_one(kernel):
        words.on_start(SimpleNamespace(data={"dispatcher": kernel}))
        words.on_start(SimpleNamespace(data={"dispatcher": implicit.midpoint_step}))  # called by the kernel
        words.on_end(None)
        words.on_end(None)

    for kernel in (inverse.inertial_forces, batch.advance_single, control_period.flag_violations):
        compile_one(kernel)
    first, *rest = capsys.readouterr().err.splitlines()
    assert first.startswith(WORDS)
    assert rest == ["  inertial_forces: about 24 s left", "  advance_single: about 43 s left"]
    rooms = (batch, inverse, implicit, runge_kutta)
    assert all(any(hasattr(room, name) for room in rooms) for name in kernels.COMPILE_SECONDS)


@pytest.mark.slow
def test_a_setting_silences_the_words(tmp_path):
    assert run("-c", SMALL, cache=tmp_path, FLEXMAN_QUIET="1").stderr == ""


@pytest.mark.slow
def test_kernels_of_others_compile_without_words(tmp_path):
    assert run("-c", OTHER, cache=tmp_path).stderr == ""


@pytest.mark.slow
def test_compile_says_what_it_does():
    done = run("-m", "flexman_gym", "compile")
    assert done.returncode == 0, done.stderr
    assert all(words in done.stdout for words in ("a single arm: ", "a batch of arms: ", "ready after"))
    assert done.stderr == ""


@pytest.mark.slow
def test_check_says_versions_kernels_and_steps():
    run("-m", "flexman_gym", "compile", "single")
    done = run("-m", "flexman_gym", "check")
    assert done.returncode == 0, done.stderr
    result = dict(line.split(": ", 1) for line in done.stdout.splitlines())
    assert {
        "python",
        "flexman_gym",
        "numba",
        "numpy",
        "scipy",
        "gymnasium",
        "processor",
        "cache folder",
    } <= result.keys()
    assert result["kernels of a single arm"] == "compiled"
    assert result["vector registers"].endswith(" bits") and " per CPU second" in result["steps of FlexRRR-v0"]


@pytest.mark.slow
def test_check_says_which_kernels_are_not_compiled_yet(tmp_path, monkeypatch, capsys):
    """In a folder without any, in one beside that of another installation, and in one with a kernel of one arm."""
    monkeypatch.setattr(check, "_steps_per_second", lambda: 1.0)
    for kernel in (batch.advance_single, batch.advance_batch):
        monkeypatch.setattr(kernel._cache, "_cache_path", str(tmp_path / "ours"))
    for folder, name, one in (
        ("ours", "other", "not compiled yet"),
        ("others", "advance_single", "not compiled yet"),
        ("ours", "advance_single", "compiled"),
    ):
        (tmp_path / folder).mkdir(exist_ok=True)
        (tmp_path / folder / f"batch.{name}-12.py311.1.nbc").touch()
        assert __main__.main(["check"]) == 0
        said = capsys.readouterr().out.splitlines()
        assert f"kernels of a single arm: {one}" in said and "kernels of a batch of arms: not compiled yet" in said


@pytest.mark.parametrize("wrong", [[], ["fly"], ["compile", "two"]])
def test_a_wrong_command_is_refused(wrong, capsys):
    with pytest.raises(SystemExit) as stop:
        __main__.main(wrong)
    assert stop.value.code == 2
    assert capsys.readouterr().err.splitlines()[-1].startswith("flexman")

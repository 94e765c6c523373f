"""Output of commands: a reader that has gone ends them quietly, and rows of tables come in one piece."""

import ast
import os
import pty
import subprocess
import sys
from contextlib import suppress

import pytest

import flexman_gym as fm
from flexman_gym.__main__ import CLOSED_PIPE, main
from flexman_gym.commands import list as list_command
from flexman_gym.commands.paper import simulate_cases
from flexman_gym.simulation import scene_simulation
from flexman_gym.toolbox.view.paper import PAPER_CASES

from oracles.files import ROOT


@pytest.mark.slow
@pytest.mark.parametrize("words", [["list"], ["list", "methods"], ["--help"], ["--version"], ["evaluate", "--help"]])
@pytest.mark.parametrize("together", [False, True])
def test_command_whose_reader_has_gone_ends_quietly(words, together):
    """As `flexman list | head` after the last line of `head`; with stderr in the same pipe or apart."""
    reader, writer = os.pipe()
    os.close(reader)
    result = subprocess.run(
        [sys.executable, "-m", "flexman_gym", *words], stdout=writer, stderr=writer if together else subprocess.PIPE,
        env=os.environ | {"PYTHONUNBUFFERED": ""},
    )  # fmt: skip
    os.close(writer)
    assert result.returncode == CLOSED_PIPE == 141 and not result.stderr


def test_broken_pipe_of_something_else_is_an_error_of_one_line(monkeypatch, capsys):
    def run(options):
        raise BrokenPipeError(32, "Broken pipe")

    monkeypatch.setattr(list_command, "COMMAND", list_command.COMMAND._replace(run=run))
    assert main(["list"]) == 2 and capsys.readouterr().err == "[Errno 32] Broken pipe\n"


@pytest.mark.slow
def test_full_disk_is_an_error_of_one_line():
    with open("/dev/full", "w") as full:
        result = subprocess.run(
            [sys.executable, "-m", "flexman_gym", "list", "conditions"], stdout=full, stderr=subprocess.PIPE, text=True
        )
    assert result.returncode == 2 and result.stderr == "[Errno 28] No space left on device\n"


@pytest.mark.slow
def test_no_command_prints_a_part_of_a_line():
    """Messages about kernels, which come whenever one compiles, would be in its middle."""
    paths = [*(ROOT / "flexman_gym").rglob("*.py"), *(ROOT / "agents").rglob("*.py")]
    parts = [f"{path.name}:{node.lineno}" for path in paths for node in ast.walk(ast.parse(path.read_text()))
             if isinstance(node, ast.Call) and getattr(node.func, "id", "") == "print"
             for keyword in node.keywords if keyword.arg == "end"]  # fmt: skip
    assert not parts and len(paths) > 200


@pytest.mark.slow
def test_rows_of_simulated_cases_are_whole_between_messages(monkeypatch, capfd):
    """Each simulation writes a message, as the first one does for the kernels that it compiles."""
    trajectory = fm.simulate(fm.catalog.paper_scene("rr"))

    def simulate(*_, **__):
        os.write(sys.__stdout__.fileno(), b"  kernel: about 3 s left\n")
        return trajectory

    monkeypatch.setattr(scene_simulation, "simulate", simulate)
    simulate_cases()
    lines = capfd.readouterr().out.splitlines()[2:]
    assert lines[::2] == ["  kernel: about 3 s left"] * 3
    assert [line[:33].strip() for line in lines[1::2]] == list(PAPER_CASES.values())
    assert all(line.endswith(" J") for line in lines[1::2])


def on_terminal(words, **variables):
    """Return what a command prints on a terminal with environment variables."""
    main_end, other_end = pty.openpty()
    environment = {"TERM": "xterm", **{name: each for name, each in os.environ.items() if name != "NO_COLOR"}}
    done = subprocess.run([sys.executable, "-m", "flexman_gym", *words], stdout=other_end, env=environment | variables)
    os.close(other_end)
    printed = b""
    with suppress(OSError):  # at the end
        while part := os.read(main_end, 4096):
            printed += part
    os.close(main_end)
    assert done.returncode == 0
    return printed.decode().replace("\r\n", "\n")


@pytest.mark.slow
@pytest.mark.parametrize(("words", "heading"), [
    (["list", "methods"], "methods:"), (["--help"], "start:"), (["list", "--help"], "EXAMPLES"),
], ids=" ".join)  # fmt: skip
def test_headings_are_bold_on_a_terminal_only(words, heading):
    command = [sys.executable, "-m", "flexman_gym", *words]
    piped = subprocess.run(
        command, capture_output=True, text=True, check=True, env=os.environ | {"COLUMNS": "80"}
    ).stdout
    assert "\033" not in piped and f"{heading}\n" in piped
    assert f"\033[1m{heading}\033[0m\n" in (seen := on_terminal(words, COLUMNS="80", TERM="xterm"))
    assert seen.replace("\033[1m", "").replace("\033[0m", "") == piped
    for variables in ({"NO_COLOR": "1", "TERM": "xterm"}, {"TERM": "dumb"}):
        assert on_terminal(words, COLUMNS="80", **variables) == piped

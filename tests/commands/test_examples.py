"""Examples in the helps of the commands: each runs as it stands, in an empty folder."""

import importlib
import shlex
import subprocess
from dataclasses import replace

import pytest

from flexman_gym.__main__ import COMMAND_GROUPS, main
from flexman_gym.toolbox.deployment.machine import simulated
from flexman_gym.toolbox.view.live_session import LiveSession

from oracles.commands import LESS, use_less_episodes, with_less_work
from oracles.machines import FakeSimulatedMachine

COMMANDS = [name for names in COMMAND_GROUPS.values() for name in names]
EXTRAS = {"record": "minari", "search": "optuna"}  # command -> package of its examples besides those of training
MAX_LENGTH = 78  # characters, so that an indented example fits a line of 80


def run(line, capsys):
    """Run a line of a help: commands of the shell as they are, `flexman` in this process with less work."""
    first, *pipes = line.split(" | ")
    words = shlex.split(first, comments=True)
    if words[0] != "flexman":
        return subprocess.run(line, shell=True, check=True)
    status = main(with_less_work(words[1:]))
    out = capsys.readouterr().out
    for each in pipes:
        out = subprocess.run(shlex.split(each, comments=True), input=out, capture_output=True, text=True, check=True)
        out = out.stdout
    assert status == 0 and (out or not pipes), line
    return None


@pytest.fixture
def less_work(monkeypatch, tmp_path):
    """Let examples run in an empty folder, with short trainings, few episodes, and no page that waits for Ctrl+C."""
    pytest.importorskip("stable_baselines3")
    pytest.importorskip("matplotlib").use("Agg")
    use_less_episodes(monkeypatch)
    find_recipe = importlib.import_module("flexman_agents.settings").find_recipe
    for module in ("flexman_agents.settings", "flexman_gym.commands.demo"):
        short = {"steps": int(LESS["--steps"]), "envs": 2}
        monkeypatch.setattr(f"{module}.find_recipe", lambda name, short=short: replace(find_recipe(name), **short))
    monkeypatch.setattr(simulated, "SimulatedMachine", FakeSimulatedMachine)
    monkeypatch.setattr(LiveSession, "wait", lambda self: None)
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path))
    monkeypatch.chdir(tmp_path)


@pytest.mark.slow
@pytest.mark.parametrize("command", COMMANDS)
def test_examples_of_a_help_run_in_their_order(command, less_work, capsys):
    if command in EXTRAS:
        pytest.importorskip(EXTRAS[command])
    for line in importlib.import_module(f"flexman_gym.commands.{command}").COMMAND.examples:
        run(line, capsys)


@pytest.mark.slow
@pytest.mark.parametrize("command", COMMANDS)
def test_help_ends_with_examples_of_its_command(command, capsys):
    pytest.importorskip("stable_baselines3")
    examples = importlib.import_module(f"flexman_gym.commands.{command}").COMMAND.examples
    with pytest.raises(SystemExit):
        main([command, "--help"])
    lines = capsys.readouterr().out.splitlines()
    assert lines[-len(examples) - 1] == "EXAMPLES" and lines[-len(examples) :] == [f"  {each}" for each in examples]
    assert lines[0].startswith(f"usage: flexman {command} ") and lines[0].endswith(" [options]")
    assert max(map(len, examples)) <= MAX_LENGTH
    assert any(each.split()[:2] == ["flexman", command] for each in examples)

"""Plug-ins: names that are registered or installed are those of the library, in every place that takes a name."""

import json
import os
import shutil
import subprocess
import sys

import gymnasium as gym
import numpy as np
import pytest

import flexman_gym as fm
from flexman_gym.agent.base_controllers import BASES
from flexman_gym.common import registry
from flexman_gym.common.registry import REGISTERED, TABLES, Registry, load_entry, register_file

from oracles.assertions import refusal
from oracles.files import ROOT

PACKAGE = ROOT / "tests" / "oracles" / "plugin"


@pytest.fixture
def plugin(monkeypatch):
    """Make the module of the plug-in known, and forget the names that a test registers."""
    monkeypatch.syspath_prepend(PACKAGE)
    monkeypatch.setenv(REGISTERED, "{}")
    yield
    for place in TABLES.values():
        table = load_entry(place)
        for name in set(table._loaded) - set(table._own) if isinstance(table, Registry) else ():
            del table._loaded[name]


@pytest.mark.slow
def test_registered_names_are_known_to_environments_agents_and_metrics(plugin):
    for kind, name, entry in (
        ("controller", "damper", "make_damper"),
        ("task", "reach", "Reach"),
        ("sensor", "error-size", "ErrorSize"),
        ("metric", "largest_torque", "LARGEST_TORQUE"),
    ):
        fm.register(kind, name, f"arm_extras:{entry}")
    env = gym.make("FlexOne-v0", task={"kind": "reach", "angle": 0.2}, sensors=["full", "error-size"], base="damper")
    observation, _ = env.reset(seed=0)
    assert observation[-1] > 0.0 and env.unwrapped.sensors.slices["error_size"].stop == len(observation)
    found = fm.evaluate("damper", "FlexOne-v0", 2)
    assert found["largest_torque"] <= 1.0
    expected = fm.rollout({"kind": "damper", "gain": 0.2}, "FlexOne-v0", 2)
    np.testing.assert_array_equal(fm.rollout("damper", "FlexOne-v0", 2).episode(1).torques, expected.episode(1).torques)
    assert fm.evaluate({"kind": "damper", "gain": 0.0}, "FlexOne-v0", 1)["effort"] == 0.0
    assert "gain" in refusal(lambda: fm.evaluate({"kind": "damper", "gian": 0.0}, "FlexOne-v0", 1))


@pytest.mark.parametrize(
    ("arguments", "line"),
    [
        (("robot", "mine", "a:b"), "kind: 'robot' is not allowed; give one of controller"),
        (("controller", "pd", "a:b"), "name: 'pd' is not allowed; give a new name"),
        (("method", "rk4", "a:b"), "name: 'rk4' is not allowed; give a new name"),
        (("controller", "mine/x", "a:b"), "name: 'mine/x' is not allowed"),
        (("controller", "mine", "a.b"), "place: 'a.b' is not allowed; give module:name"),
        (("controller", 3, "a:b"), "name"),
    ],
)
def test_wrong_registrations_are_refused_in_one_line(arguments, line, plugin):
    assert refusal(fm.register, *arguments).startswith(line)
    assert json.loads(os.environ[REGISTERED]) == {}


def test_a_name_is_registered_once(plugin):
    fm.register("controller", "damper", "arm_extras:make_damper")
    assert refusal(fm.register, "controller", "damper", "arm_extras:Damper").startswith("name: 'damper'")


CONTROLLER = """
import numpy as np

class Constant:
    sensors = ()

    def reset(self, arms, episode, count):
        pass

    def act(self, readings, applied, active):
        return np.full_like(applied, {value})

def make(plant):
    return Constant()
"""


@pytest.fixture
def own_file(plugin, tmp_path, monkeypatch):
    """Return a file with a controller, and forget its module and its folder after the test."""
    monkeypatch.setattr(sys, "path", [*sys.path])
    path = tmp_path / "own_constant.py"
    path.write_text(CONTROLLER.format(value=0.5), encoding="utf-8")
    yield path
    sys.modules.pop("own_constant", None)


@pytest.mark.feature
def test_a_file_with_a_controller_is_an_agent_of_commands_and_its_rows_follow_the_file(own_file, tmp_path, capsys):
    from flexman_gym.__main__ import main

    scenario, folder = "FlexOne-v0", tmp_path / "league"
    assert main(["evaluate", str(own_file), "--env", scenario, "--episodes", "1", "--json"]) == 0
    metrics = json.loads(capsys.readouterr().out)["agents"][str(own_file)]
    assert metrics["effort"] == fm.evaluate("own_constant", scenario, 1)["effort"] > 0.0
    options = ["--add", str(own_file), "--scenarios", scenario, "--episodes", "1", "--folder", str(folder)]
    for value, runs in ((0.5, True), (0.5, False), (0.1, True)):
        own_file.write_text(CONTROLLER.format(value=value), encoding="utf-8")
        assert main(["league", *options]) == 0
        printed = capsys.readouterr().out
        assert ("1 of 1: own_constant on FlexOne-v0" in printed) == runs
    assert main(["league", "--details", str(own_file), "--folder", str(folder)]) == 0
    assert capsys.readouterr().out.startswith("own_constant: ")


def test_wrong_files_are_refused_in_one_line(plugin, tmp_path, monkeypatch):
    monkeypatch.setattr(sys, "path", [*sys.path])
    with pytest.raises(FileNotFoundError, match=r"missing\.py: there is no such file"):
        register_file("controller", tmp_path / "missing.py")
    for name, line in (("pd", "name: 'pd' is not allowed; give a new name"), ("my-law", "place: 'my-law:make' is not")):
        (tmp_path / f"{name}.py").write_text("make = print\n", encoding="utf-8")
        assert refusal(register_file, "controller", tmp_path / f"{name}.py").startswith(line)
    (tmp_path / "no_make.py").write_text("", encoding="utf-8")
    assert "cannot be imported" in refusal(
        fm.evaluate, register_file("controller", tmp_path / "no_make.py"), "FlexOne-v0", 1
    )


@pytest.mark.feature
@pytest.mark.parametrize("place", ["arm_extras.missing:make", "arm_extras:missing", "no_such_module:make"])
def test_a_broken_plugin_is_named_and_does_not_disturb_others(place, plugin):
    fm.register("controller", "broken", place)
    assert refusal(lambda: gym.make("FlexOne-v0", base="broken")).startswith(f"controller broken: {place} of a plug-in")
    with pytest.warns(UserWarning, match="controller broken: "):
        assert "broken" not in dict(BASES.items())
    gym.make("FlexOne-v0", base="pd")


def test_files_run_no_code(plugin, tmp_path):
    path = tmp_path / "env.yaml"
    path.write_text("id: FlexOne-v0\nbase: arm_extras:make_damper\n")
    line = refusal(lambda: fm.rollout("zero", str(path), 1))
    assert "base: 'arm_extras:make_damper' is not allowed" in line


@pytest.mark.slow
def test_processes_that_are_started_later_know_registered_names(plugin):
    fm.register("controller", "damper", "arm_extras:make_damper")
    script = "import gymnasium, flexman_gym; print(gymnasium.make('FlexOne-v0', base='damper').unwrapped.episodes.base)"
    environment = os.environ | {"PYTHONPATH": os.pathsep.join([str(PACKAGE), str(ROOT)])}
    done = subprocess.run([sys.executable, "-c", script], env=environment, capture_output=True, text=True)
    assert done.returncode == 0 and "Damper" in done.stdout, done.stderr


def test_entry_points_are_read_when_a_name_is_not_found(monkeypatch, plugin):
    registry.plugins.cache_clear()
    calls = []
    monkeypatch.setattr("importlib.metadata.entry_points", lambda group: calls.append(group) or ())
    assert "pd" in BASES and list(BASES) and calls == []
    assert "nothing" not in BASES and calls == [registry.GROUP]
    registry.plugins.cache_clear()


@pytest.mark.feature
@pytest.mark.slow
def test_an_installed_package_adds_its_names(tmp_path):
    """Built and installed beside the library; the wrong and the broken entry are named and disturb nobody."""
    source = shutil.copytree(PACKAGE, tmp_path / "source")
    command = [sys.executable, "-m", "pip", "install", "-q", "--no-deps", "--no-build-isolation", "--no-index"]
    done = subprocess.run([*command, "--target", tmp_path / "site", source], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    (tmp_path / "env.yaml").write_text("id: FlexOne-v0\nbase: damper\ntask: {kind: reach}\nsensors: [error-size]\n")
    script = """
import sys, warnings
warnings.simplefilter("error", ResourceWarning)
import gymnasium, flexman_gym as fm
gymnasium.make("FlexOne-v0", base="damper", task="reach", sensors=["full", "error-size"]).reset(seed=0)
print(sorted(fm.evaluate("damper", "FlexOne-v0", 2)))
print(fm.rollout("zero", sys.argv[1], 1).episode(0).errors[0] > 0.0)
from flexman_gym.__main__ import main
main(["evaluate", "damper", "--env", "FlexOne-v0", "--episodes", "1"])
main(["league", "--folder", sys.argv[2], "--agents", "damper", "--scenarios", "FlexOne-v0", "--episodes", "1"])
main(["list", "controllers"])
"""
    environment = os.environ | {"PYTHONPATH": os.pathsep.join([str(tmp_path / "site"), str(ROOT)])}
    arguments = [sys.executable, "-c", script, tmp_path / "env.yaml", tmp_path / "league"]
    done = subprocess.run(arguments, env=environment, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert "'largest_torque'" in done.stdout and "True" in done.stdout
    print(done.stdout)
    assert "\ndamper " in done.stdout and "\n  damper " in done.stdout
    assert "plug-in of arm-extras: robot.wrong = arm_extras:make_damper is left out" in done.stderr
    assert "controller broken: arm_extras.missing:make of a plug-in cannot be imported" in done.stderr

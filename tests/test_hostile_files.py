"""Tests of hostile files: devices, pipes and endless contents are rejected at once with a one-line error."""

import os

import pytest

from flexman_gym.agent.normalisation import RunningMeanStd
from flexman_gym.common.time_series import read_time_series
from flexman_gym.envs.config.configuration import Configuration
from flexman_gym.envs.registration import IDS
from flexman_gym.evaluation.agents import find_agent
from flexman_gym.scene.scene import Scene
from flexman_gym.simulation.episode import Episode
from flexman_gym.toolbox.controllers.references.optimised_slews import SlewTable
from flexman_gym.toolbox.league.rows import LeagueRows
from flexman_gym.toolbox.league.scenarios import find_scenario
from flexman_gym.toolbox.view.learning_curves import read_progress

from oracles import hostile

CASES = [pytest.param(*case, id=f"{case[0]}: {case[1]}") for case in hostile.cases()]


@pytest.mark.slow
@pytest.mark.parametrize(("name", "what", "make"), CASES)
def test_a_hostile_file_is_refused_at_once_in_one_line(name, what, make, tmp_path):
    path = tmp_path / name
    make(path)
    line, seconds = hostile.line_of(name, path)
    assert line and "\n" not in line and line.isprintable() and len(line) < 420 and "root" not in line.replace(
        str(tmp_path), ""), line  # fmt: skip
    assert seconds < hostile.SECONDS, f"{seconds:.1f} s"


BY_NAME = [
    find_agent,
    find_scenario,
    Configuration.find,
    Scene.load,
    read_time_series,
    Episode.load,
    SlewTable.load,
    RunningMeanStd.load,
]


@pytest.mark.parametrize("read", BY_NAME, ids=lambda read: read.__qualname__)
@pytest.mark.parametrize("name", ["x" * 300, "x" * 5000, "x/" * 2500 + "x", "a\0b", "a\nb"], ids=range(5))
def test_a_name_that_no_file_has_is_refused_in_one_line(read, name):
    with pytest.raises((FileNotFoundError, ValueError)) as error:
        read(f"{name}.yaml")
    line = str(error.value)
    names = len(", ".join(IDS))  # a message may list the environments
    assert "errno" not in line.lower() and len(line) < 276 + names and line.isprintable(), line


def test_the_folder_of_nothing_is_one_line():
    assert LeagueRows.load(hostile.Path("x" * 5000)).rows == {}
    with pytest.raises(FileNotFoundError, match=r"^x{60,80}\.\.\.x+: no progress\.csv with rows"):
        read_progress("x" * 5000)


def test_no_file_is_open_after_a_refusal(tmp_path):
    """A thousand rejected files must not exhaust the file handles of a process."""
    (tmp_path / "a.npz").write_bytes(b"PK" + bytes(100))
    before = len(os.listdir("/proc/self/fd"))
    for _ in range(10):
        with pytest.raises(ValueError, match="this is not a saved episode"):
            Episode.load(tmp_path / "a.npz")
    assert len(os.listdir("/proc/self/fd")) == before

"""Option --json: standard output is one JSON document, whose numbers are those of the Python API."""

import json
import math
import subprocess
import sys

import pytest

import flexman_gym as fm
from flexman_gym.__main__ import main
from flexman_gym.commands import check
from flexman_gym.envs.config.configuration import Configuration
from flexman_gym.evaluation.metrics import METRICS
from flexman_gym.toolbox.league import arm_trial
from flexman_gym.toolbox.league.rows import LeagueRows
from flexman_gym.toolbox.league.standings import Standings

from oracles.files import ROOT

LEAGUE = ["league", "--agents", "zero", "random", "pd", "--scenarios", "FlexOne-v0", "--episodes", "2"]


def document(words, capsys):
    """Return the JSON document of a command, and the text on standard error."""
    assert main([*words, "--json"]) == 0
    out, err = capsys.readouterr()
    return json.loads(out, parse_constant=lambda name: pytest.fail(f"{name} is no JSON")), err


def finite(numbers):
    """Return a mapping with None for numbers that are not finite."""
    return {name: value if math.isfinite(value) else None for name, value in numbers.items()}


def test_evaluate_has_the_metrics_of_the_python_function(capsys):
    """The agent `zero` does not settle: its settling time is infinite."""
    found, _ = document(["evaluate", "pd", "zero", "--env", "FlexOne-v0", "--episodes", "3", "--seed", "7"], capsys)
    assert found["environment"] == Configuration("FlexOne-v0").to_plain()
    assert (found["seed"], found["episodes"], [*found["agents"]]) == (7, 3, ["pd", "zero"])
    for agent, values in found["agents"].items():
        intervals = values.pop("intervals")
        assert values == finite(fm.evaluate(agent, "FlexOne-v0", range(7, 10)))
        medians = {name for name, metric in METRICS.items() if metric.statistic == "median"}
        assert intervals.keys() == medians and (agent == "zero" or intervals["error"][0] <= values["error"])
    assert found["agents"]["zero"]["settling_time"] is None


def test_paths_of_saved_episodes_are_not_in_the_document(tmp_path, capsys):
    words = ["evaluate", "pd", "--env", "FlexOne-v0", "--episodes", "1", "--save", str(tmp_path)]
    found, err = document(words, capsys)
    assert [*found["agents"]] == ["pd"] and err.startswith(f"1 episodes are in {tmp_path}")


@pytest.mark.slow
def test_evaluate_can_be_piped():
    words = ["-m", "flexman_gym", "evaluate", "pd", "--env", "FlexOne-v0", "--episodes", "1", "--json"]
    done = subprocess.run([sys.executable, *words], capture_output=True, check=True, cwd=ROOT)
    tool = subprocess.run([sys.executable, "-m", "json.tool"], input=done.stdout, capture_output=True, check=True)
    assert json.loads(tool.stdout)["episodes"] == 1


def test_list_has_names_with_whole_descriptions(capsys):
    found, err = document(["list", "methods", "settings"], capsys)
    assert [*found] == ["methods", "settings"] and [*found["methods"]] == [*fm.METHODS] and not err
    assert found["settings"]["horizon"].endswith("(s)")


def test_check_has_the_speed_as_a_number(monkeypatch, capsys):
    monkeypatch.setattr(check, "_steps_per_second", lambda: 12345.678)
    found, _ = document(["check"], capsys)
    assert found["steps per CPU second"] == 12345.678 and found["flexman_gym"] == fm.__version__


@pytest.mark.slow
def test_arm_has_facts_environment_and_trials(monkeypatch, capsys):
    monkeypatch.setattr(arm_trial, "EPISODES", 2)
    monkeypatch.setattr(arm_trial, "TRIAL_AGENTS", {"pd": arm_trial.KNOWN})
    found, err = document(["arm", "planar_2r", "--set", "torque_limit=20", "--try"], capsys)
    expected = fm.describe("planar_2r", torque_limit=20.0)
    assert found["environment"] == expected.configuration.to_plain()
    assert found["facts"]["held"] == [*expected.facts.held]
    assert found["facts"]["durations"] == expected.facts.durations.tolist()
    assert found["warnings"] == [*expected.warnings]
    (trial,) = found["trials"]
    assert trial["agent"] == "pd" and found["recommended"] in ("pd", None) and found["reason"]
    assert str(expected) in err and "recommended: " in err


def test_league_has_scores_and_settling_times_and_its_progress_elsewhere(tmp_path, capsys):
    where = ["--folder", str(tmp_path)]
    found, err = document([*LEAGUE, *where], capsys)
    assert [line.split(",")[0] for line in err.splitlines()][-1] == "3 of 3: pd on FlexOne-v0"
    standings = Standings(LeagueRows.load(tmp_path))
    settled, time = standings.settled("pd", "FlexOne-v0")
    assert [*found["agents"]] == standings.agents
    assert found["agents"]["pd"]["scenarios"]["FlexOne-v0"] == {
        "settled": settled, "settling_time": -time, "score": None,
    }  # fmt: skip
    assert found["agents"]["zero"]["scenarios"]["FlexOne-v0"]["settling_time"] is None
    again, err = document(["league", "--redraw", *where], capsys)
    assert again == found and not err
    with pytest.raises(SystemExit):
        main(["league", "--details", "pd", "--json", *where])
    assert "--json: " in capsys.readouterr().err.splitlines()[-1]


def test_quiet_league_prints_no_progress(tmp_path, capsys):
    where = ["--folder", str(tmp_path), "--quiet"]
    assert main([*LEAGUE, *where]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[0].split() == ["agent", "FlexOne-v0"] and len(lines) == 5
    _, err = document(["league", "--add", "lqr", *where], capsys)
    assert not err


@pytest.mark.slow
def test_precision_has_its_runs(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    words = ["precision", "paper_rr", "--method", "gauss_3", "--step", "0.02", "--own", "--all"]
    found, err = document(words, capsys)
    assert {run["method"] for run in found["runs"]} >= {"gauss_3"} and all(run["cpu"] > 0.0 for run in found["runs"])
    assert found["reference"]["error"] >= 0.0 and found["conclusion"].startswith("The default")
    assert err.splitlines()[-1] == "out/precision.png has the chart"

"""Progress: who waits long sees on stderr how far a computation is; a quick one says nothing."""

import json

import pytest

import flexman_gym as fm
from flexman_gym.common import progress
from flexman_gym.common.progress import Progress
from flexman_gym.envs.config.configuration import Configuration

from oracles.shipped import write_still

SHORT = Configuration("FlexOne-v0", {"horizon": 0.2})


@pytest.fixture
def impatient(monkeypatch):
    """A line for everything that is counted."""
    monkeypatch.setattr(progress, "INTERVAL", 0.0)
    monkeypatch.delenv("FLEXMAN_QUIET", raising=False)


def test_a_line_comes_after_ten_seconds_and_then_every_ten(monkeypatch, capsys):
    """Of 40 things a second each, counted from 0 s on."""
    clock = iter(range(100))
    monkeypatch.setattr(progress, "monotonic", lambda: float(next(clock)))
    counted = Progress("things", 40)
    for _ in range(40):
        counted.count()
    lines = capsys.readouterr().err.splitlines()
    assert lines == [f"{done} of 40 things, about {(40 - done) / 60:.1f} min left" for done in (10, 20, 30)]


def test_without_a_total_the_time_so_far_is_said_and_a_setting_silences_it(monkeypatch, capsys):
    clock = iter(range(100))
    monkeypatch.setattr(progress, "monotonic", lambda: float(next(clock)))
    counted = Progress("evaluations of the fit")
    for _ in range(11):
        counted.count()
    assert capsys.readouterr().err == "10 evaluations of the fit after 10 s\n"
    monkeypatch.setenv("FLEXMAN_QUIET", "1")
    for _ in range(20):
        counted.count()
    assert capsys.readouterr().err == ""


@pytest.mark.feature
def test_a_long_fit_says_how_far_it_is(impatient, capsys):
    fm.fit(fm.catalog.one_joint(), "joint_stiffness", frequencies=[1.3, 11.2], elements=1)
    lines = capsys.readouterr().err.splitlines()
    assert lines and all("evaluations of the fit after" in line for line in lines)


@pytest.mark.feature
@pytest.mark.slow
def test_a_long_choice_says_how_far_it_is(impatient, capsys):
    choice = fm.choose_model(fm.catalog.paper_scene("rr"), tolerance=0.0123)
    lines = capsys.readouterr().err.splitlines()
    assert lines[-1].startswith(f"{choice.runs} runs of the scene after ")


def test_long_episodes_say_how_far_they_are(impatient, capsys):
    fm.rollout("pd", SHORT, 2)
    assert capsys.readouterr().err.splitlines()[0].startswith("1 of 10 control periods of 2 episodes, about ")


@pytest.mark.feature
def test_a_long_league_says_how_far_it_is(impatient, capsys, tmp_path):
    from flexman_gym.toolbox.league.rows import run_league

    run_league(["zero", "pd"], ["FlexOne-v0"], range(9000, 9001), tmp_path, log=lambda line: None)
    lines = capsys.readouterr().err.splitlines()
    assert any(line.startswith("1 of 500 control periods of 1 episodes") for line in lines)
    assert any(line.startswith("1 of 2 cells, about ") for line in lines)


@pytest.mark.feature
def test_a_long_certificate_says_how_far_it_is(impatient, capsys, tmp_path, monkeypatch):
    """Of each scenario, and of the search, which runs many episodes and prints nothing until its end."""
    from flexman_gym.toolbox.league import certificate

    write_still(tmp_path / "still")
    monkeypatch.setattr(certificate, "_certificate_scenarios", lambda name: [name])
    monkeypatch.setattr(certificate, "worst_case", lambda *_: {})
    path = certificate.certify(str(tmp_path / "still"), range(9000, 9002), 6, tmp_path / "rows", log=list)
    lines = capsys.readouterr().err.splitlines()
    assert json.loads(path.read_text())["rows"]
    for count in (2, 6):
        assert any(f"control periods of {count} episodes, about" in line for line in lines)

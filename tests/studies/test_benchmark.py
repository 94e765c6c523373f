"""Tests of the benchmark: the quick grid fills every table on any computer, with the installed packages."""

import math
import sys
from importlib.util import find_spec

import pytest

from studies.__main__ import main
from studies.benchmark import measure
from studies.benchmark import page as page_of
from studies.benchmark.endurance import ALARMS, DIVERGED, MEMORY, STEPS, WARM_MEMORY, endurance_rows, endure
from studies.benchmark.measure import BenchmarkRow
from studies.files import read_rows

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def quick(tmp_path_factory):
    """Return the rows of a quick run."""
    folder = tmp_path_factory.mktemp("benchmark")
    assert main(["benchmark", "--quick", "--folder", str(folder)]) in (0, 1)  # so short a run measures no memory
    assert (folder / "benchmark.md").read_text(encoding="utf-8").count("| ") > 20
    return read_rows(folder / "benchmark.csv", BenchmarkRow)


def test_every_row_has_its_cost_and_a_finite_ratio(quick):
    rows = quick
    tables = {measure.ENVIRONMENTS, measure.PARTS, measure.EVALUATIONS}
    assert {row.table for row in rows} == tables
    for row in rows:
        assert 0.0 < row.cpu < 100.0 and 0.0 < row.wall < 100.0, row.name
        assert row.times_peer is None or 0.0 < row.times_peer < math.inf, row.name
        assert (row.times_peer is None) == (row.peer == ""), row.name
        assert row.share is None or 0.0 <= row.share <= 1.0, row.name


def test_arms_and_threads_are_those_of_the_grid(quick):
    result = [(row.arms, row.threads) for row in quick if row.name == measure.VECTOR]
    assert result == [(arms, 1) for arms in measure.QUICK.arms] + [(arms, 2) for arms in measure.QUICK.arms if arms > 1]
    assert (measure.PPO in {row.name for row in quick}) == bool(find_spec("stable_baselines3"))


def test_a_row_is_its_own_peer_once(quick):
    peers = {row.peer for row in quick} - {""}
    for peer in peers:
        (row,) = [row for row in quick if row.name == peer]
        assert row.peer != row.name or row.times_peer == 1.0


def test_peers_that_are_missing_are_named_and_left_out(monkeypatch, capsys):
    for name in ("mujoco", "pinocchio", "studies.benchmark.mujoco", "flexman_gym.toolbox.precision.peers.pinocchio"):
        monkeypatch.setitem(sys.modules, name, None)
    monkeypatch.setattr(measure, "find_spec", lambda name: None)
    rows = measure.environment_rows(measure.Grid(arms=(1, 2), steps=2, singles=2, physics=(1, 1), rounds=1))
    assert {row.peer for row in rows} == {""} and {row.times_peer for row in rows} == {None}
    timers = measure.timers()
    assert measure.ABA not in timers and measure.PLAIN in timers
    result = [line.split()[0] for line in capsys.readouterr().out.splitlines()]
    assert result == ["Stable-Baselines3", "MuJoCo", "Pinocchio"]
    assert page_of.page(rows, [], {})


def test_every_episode_of_an_endurance_run_is_counted_once():
    count = endure(3000, 8, settled=1000)
    assert count.steps >= 3000 and count.episodes == count.truncated + sum(count.failures.values()) > 0
    assert count.diverged == 0 and min(count.memory) > 0.0
    rows = {row.quantity: row.value for row in endurance_rows(count)}
    assert rows["episodes"] == count.episodes and {STEPS, DIVERGED, ALARMS, MEMORY, WARM_MEMORY} <= rows.keys()

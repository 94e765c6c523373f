"""Hook: a training reports on the way, is saved when it is asked to be, and stops where it is told to."""

from dataclasses import replace

import pytest

pytest.importorskip("stable_baselines3")

from flexman_agents.settings import Settings
from flexman_agents.training import resume, train, train_or_resume
from flexman_gym.common.run_folder import BEST, read_npz

from oracles.runs import RUNS, bits

pytestmark = pytest.mark.slow

SETTINGS = RUNS["ppo"]  # 160 steps, 24 a rollout, evaluated after 72, 144 and at the end


def test_a_hook_is_told_steps_and_figures_where_rollouts_begin_and_at_the_end(tmp_path):
    reports = []
    train(SETTINGS, tmp_path / "a", progress=False, hook=reports.append)
    assert [each.steps for each in reports] == [0, 24, 48, 72, 96, 120, 144, 168]
    assert [bool(each.metrics) for each in reports] == [False] * 3 + [True] * 5
    rewards = [each.metrics.get("reward") for each in reports]
    assert rewards[3] == rewards[5] != rewards[6] != rewards[7]


def test_a_run_that_a_hook_stops_or_that_is_killed_after_it_saved_goes_on_to_the_same_bits(tmp_path):
    train(SETTINGS, tmp_path / "whole", progress=False)
    steps = []

    def stops(report):
        steps.append(report.steps)
        return report.steps >= 48

    train(SETTINGS, tmp_path / "stopped", progress=False, hook=stops)
    assert steps == [0, 24, 48]

    def dies(report):
        if report.steps == 48:
            report.save()
        if report.steps == 72:
            raise MemoryError

    with pytest.raises(MemoryError):
        train(SETTINGS, tmp_path / "killed", progress=False, hook=dies)
    for name in ("stopped", "killed"):
        heard = []
        resume(tmp_path / name, progress=False, hook=heard.append)
        assert heard[0].steps == 48 and heard[-1].steps == 168
        assert bits(tmp_path / name) == bits(tmp_path / "whole")
    assert Settings.load(tmp_path / "stopped") == SETTINGS


def test_a_cell_of_a_grid_goes_on_with_its_hook_after_it_was_killed(tmp_path):
    train(SETTINGS, tmp_path, progress=False, hook=lambda report: report.steps >= 48)
    heard = []
    train_or_resume((SETTINGS, str(tmp_path), {"progress": False, "hook": lambda report: heard.append(report.steps)}))
    assert heard == [48, 72, 96, 120, 144, 168]


def test_the_policy_of_the_end_is_evaluated_but_not_that_of_a_run_that_was_stopped(tmp_path):
    """Even where the run is shorter than the steps between evaluations."""
    settings = replace(SETTINGS, eval_every=10 * SETTINGS.steps)
    train(settings, tmp_path / "whole", progress=False)
    best = read_npz(tmp_path / "whole" / BEST)["policy"]
    assert {name: values.tobytes() for name, values in best.items()} == bits(tmp_path / "whole")
    train(settings, tmp_path / "stopped", progress=False, hook=lambda report: report.steps > 0)
    assert not (tmp_path / "stopped" / BEST).exists()

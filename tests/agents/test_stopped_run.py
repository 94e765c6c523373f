"""Stored files: a training run that was stopped after 128 of 256 steps, its curves, and an exported policy."""

import csv
import shutil
from pathlib import Path

import pytest

import flexman_gym as fm
from flexman_gym.evaluation.agents import find_agent
from flexman_gym.evaluation.rollouts import SELECTION_SEEDS

FILES = Path(__file__).parent / "stopped_run"


def curves(path: Path) -> list[dict[str, str]]:
    """Rows of progress.csv, one per rollout of the training."""
    with open(path, newline="") as file:
        return list(csv.DictReader(file))


@pytest.mark.parametrize("folder", ["run", "policy"])
def test_the_best_policy_has_the_reward_recorded_during_its_training(folder):
    agent = find_agent(str(FILES / folder))
    reward = fm.evaluate(str(FILES / folder), agent.environment, SELECTION_SEEDS)["reward"]
    recorded = [float(row["selection/reward"]) for row in curves(FILES / "finished.csv") if row["selection/reward"]]
    assert reward == pytest.approx(max(recorded), rel=1e-6)  # the training computed actions in single precision


def test_a_stopped_run_resumes_to_the_curves_of_the_run_without_a_stop(tmp_path):
    training = pytest.importorskip("flexman_agents.training")
    folder = tmp_path / "run"
    shutil.copytree(FILES / "run", folder)
    training.resume(folder, progress=False)
    resumed, finished = curves(folder / "progress-128.csv"), curves(FILES / "finished.csv")[2:]
    assert [row["time/total_timesteps"] for row in resumed] == ["192", "256"]
    for row, expected in zip(resumed, finished, strict=True):
        for name in expected:
            if name.startswith(("rollout/", "selection/")):
                number = float(expected[name] or "nan")
                assert float(row[name] or "nan") == pytest.approx(number, rel=1e-4, abs=1e-9, nan_ok=True), name

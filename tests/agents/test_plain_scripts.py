"""The scripts that a reader copies: training and evaluation by Stable-Baselines3's own functions."""

import subprocess
import sys

import pytest

from oracles.files import ROOT


def run(folder, script, *arguments):
    """Return the lines that a script prints."""
    command = [sys.executable, ROOT / "scripts" / f"{script}.py", *map(str, arguments)]
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return done.stdout.splitlines()


@pytest.mark.slow
@pytest.mark.parametrize(("name", "steps"), [("ppo", 6144), ("sac", 4352)])
def test_a_model_is_trained_saved_and_evaluated(tmp_path, name, steps):
    assert run(tmp_path, "train", name, steps) == []
    assert (tmp_path / "runs" / f"{name}.zip").exists()
    lines = [line.split() for line in run(tmp_path, "evaluate", name, 2)]
    assert [line[0] for line in lines] == [name, "pd", "lqr-tracking"]
    assert lines[2][1:3] == ["settled", "100%,"]


@pytest.mark.slow
def test_the_plain_vector_environment_of_stable_baselines_trains_too():
    script = (
        "import flexman_gym; from stable_baselines3 import PPO; from stable_baselines3.common.env_util import "
        "make_vec_env; from train import SETTINGS; "
        "PPO('MlpPolicy', make_vec_env('FlexRRR-v0', 2, env_kwargs=SETTINGS), n_steps=32).learn(64)"
    )
    done = subprocess.run([sys.executable, "-c", script], cwd=ROOT / "scripts", capture_output=True, text=True)
    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize("script", ["train", "evaluate"])
def test_the_scripts_are_short_enough_to_be_read_at_once(script):
    assert len((ROOT / "scripts" / f"{script}.py").read_text(encoding="utf-8").splitlines()) <= 48

"""RLlib: recipes translated, runners that share scales and no episodes, checkpoints that a killed run goes on from."""

import os
import subprocess
import sys
import time
from dataclasses import replace

import numpy as np
import pytest

pytest.importorskip("stable_baselines3")
pytest.importorskip("ray.rllib.algorithms.ppo", reason="RLlib is not installed: requirements-rllib.txt")

from flexman_agents import rllib
from flexman_agents.settings import Settings
from flexman_gym.common.run_folder import NEWEST, read_npz
from flexman_gym.evaluation.agent import find_agent
from flexman_gym.evaluation.rollout import rollout, training_seed

from oracles.assertions import refusal

SETTINGS = Settings(
    "ppo", {"id": "FlexOne-v0", "base": "pd", "action_repeat": 3, "horizon": 0.9}, 768, seed=3, envs=8,
    hyperparameters={"n_steps": 24, "batch_size": 64, "n_epochs": 2, "net_arch": [16, 16], "gamma": 0.95},
    schedules={"learning_rate": {"start": 1e-3, "end": 0.0}, "log_std": {"start": -1.0, "end": -3.0}},
)  # fmt: skip
LAST = 768


@pytest.fixture(scope="module", params=[0, 2])
def run(request, tmp_path_factory):
    """A short training, alone and with two runners."""
    folder = tmp_path_factory.mktemp("run") / "run"
    rllib.train_rllib(SETTINGS, folder, request.param, every=0)
    return folder


def test_a_recipe_is_translated_and_what_cannot_be_is_refused():
    config = rllib._ppo_config(SETTINGS, 2)
    assert config.train_batch_size_per_learner == 8 * 24 and config.minibatch_size == 64 and config.num_epochs == 2
    assert config.gamma == 0.95 and config.lambda_ == 0.99 and config.num_envs_per_env_runner == 4
    assert config.lr == [[0, 1e-3], [768, 1e-12]] and config.env_config["first_seed"] == training_seed(3)
    assert refusal(rllib._ppo_config, SETTINGS, 3).startswith("runners: 3 is not allowed; give a number that divides")
    for change in ({"eval_every": 5}, {"hyperparameters": {"use_sde": True}}):
        assert refusal(rllib._ppo_config, replace(SETTINGS, **change), 0).startswith(next(iter(change)))
    assert refusal(rllib._ppo_config, Settings("sac"), 0).startswith("algo: 'sac' is not allowed")


def test_a_run_is_a_folder_that_evaluate_reads_and_whose_scales_saw_every_observation_once(run):
    data = read_npz(run / NEWEST)
    assert data["statistics"]["count"] == LAST
    assert set(data["policy"]) == {f"{layer}.{part}" for part in ("weight", "bias") for layer in (
        "mlp_extractor.policy_net.0", "mlp_extractor.policy_net.2", "action_net")}  # fmt: skip
    assert [path.name for path in (run / rllib.CHECKPOINT_FOLDER).iterdir()] == [str(LAST)]
    entrant = find_agent(str(run))
    assert np.isfinite(rollout(entrant, entrant.environment, [9000, 9001]).tips[:, -1]).all()


def test_runners_begin_with_episodes_of_their_own():
    """Observations after a reset, of two runners as RLlib makes them, beside those of one."""
    both = rllib._ppo_config(SETTINGS, 2)
    whole = rllib._ppo_config(SETTINGS, 0)
    seen = []
    for config, index in ((both, 1), (both, 2), (whole, 0)):
        runner = config.env_runner_cls(config=config, worker_index=index)
        runner._begin()
        seen.append(runner._observed)
    assert np.array_equal(np.concatenate(seen[:2]), seen[2]) and len(np.unique(seen[2], axis=0)) == 8


def test_a_sample_holds_what_the_environment_said_cut_into_episodes():
    config = rllib._ppo_config(replace(SETTINGS, normalise_reward=False), 0)
    runner = config.env_runner_cls(config=config, worker_index=0)
    episodes = runner.sample(num_timesteps=8 * 24)
    assert sum(map(len, episodes)) == 8 * 24 and sum(each.is_truncated for each in episodes) == 8
    for arm, first in enumerate(each for each in episodes if each.is_truncated):
        assert len(first) == 15, "0.9 s in steps of 0.06 s"
        other = next(each for each in episodes[8:] if np.array_equal(each.get_observations(-1), _last(runner, arm)))
        assert len(other) == 9 and other.id_ != first.id_


def _last(runner, arm):
    """What an arm sees now, scaled by what was known when the rollout began, which was nothing."""
    return np.clip(runner._observed[arm], -10.0, 10.0)


def test_scales_that_runners_share_count_everything_once():
    values = np.random.default_rng(0).normal(2.0, 3.0, (60, 4))
    runners = [rllib._NormalisationConnector(4) for _ in range(3)]
    for parts in (values[:30], values[30:]):
        for runner, part in zip(runners, np.split(parts, 3), strict=True):
            runner.own["observations"].add(part)
        merged = runners[0].merge_states([runner.get_state() for runner in runners])
        for runner in runners:
            runner.set_state(merged)
    for runner in runners:
        scales = runner.merged("observations")
        assert scales.count == 60 and scales.mean == pytest.approx(values.mean(axis=0))
        assert scales.squares / 60 == pytest.approx(values.var(axis=0))


def test_a_run_that_was_killed_goes_on_from_its_checkpoint(tmp_path):
    code = "from test_settings import SETTINGS; from pathlib import Path; from flexman_agents import rllib\n"
    code += "if __name__ == '__main__': rllib.train_rllib(SETTINGS, Path('run'), 0, 192)"
    (tmp_path / "study.py").write_text(code)
    (tmp_path / "test_settings.py").write_text(
        f"from flexman_agents.settings import Settings\nSETTINGS = Settings.from_dict({SETTINGS.plain()!r} | "
        "{'steps': 10**6})\n"
    )
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
    process = subprocess.Popen([sys.executable, "study.py"], cwd=tmp_path, env=environment)
    place = tmp_path / "run" / rllib.CHECKPOINT_FOLDER
    while not [*place.glob("[0-9]*")]:
        assert process.poll() is None
        time.sleep(0.2)
    process.kill()
    process.wait()
    (known,) = sorted(int(path.name) for path in place.glob("[0-9]*"))[-1:]
    before = read_npz(tmp_path / "run" / NEWEST)["statistics"]["count"] if (tmp_path / "run" / NEWEST).exists() else 0
    rllib.train_rllib(replace(SETTINGS, steps=known + 192), tmp_path / "run", 0, 0, resume=True)
    assert [path.name for path in place.iterdir()] == [str(known + 192)]
    count = read_npz(tmp_path / "run" / NEWEST)["statistics"]["count"]
    assert count == known + 192 > before >= 0
    assert refusal(rllib.train_rllib, SETTINGS, tmp_path / "run").startswith("folder: ")

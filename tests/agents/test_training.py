"""Agents: a run can be trained, resumed, loaded and judged; figures of an episode are what they say."""

import json
import subprocess
import sys

import gymnasium as gym
import numpy as np
import pytest

from oracles.files import ROOT

pytest.importorskip("stable_baselines3")

from stable_baselines3.common.vec_env import DummyVecEnv, VecMonitor, VecNormalize

import flexman_gym as fm
from flexman_agents.evaluation import episode_figures, evaluate, load_policy, table
from flexman_agents.residual import Residual, VectorResidual
from flexman_agents.training import MODEL, SETTINGS, STATISTICS, Settings, load_settings, resume, train
from flexman_agents.vector import Arms


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    """Folder of a PPO run of one rollout."""
    folder = tmp_path_factory.mktemp("runs") / "ppo"
    train(Settings(algo="ppo", steps=512, envs=2, seed=3, residual=True), folder, progress=False)
    return folder


def test_a_run_keeps_model_statistics_seed_settings_and_versions(run):
    assert {path.name for path in run.iterdir()} == {MODEL, STATISTICS, SETTINGS}
    record = json.loads((run / SETTINGS).read_text())
    assert record["seed"] == 3
    assert record["hyperparameters"]["batch_size"] == 256  # not more than two arms give in 128 steps
    assert "numba" in record["versions"]
    assert load_settings(run) == Settings(algo="ppo", steps=512, envs=2, seed=3, residual=True)


def test_the_same_seed_trains_the_same_policy(run, tmp_path):
    train(load_settings(run), tmp_path / "again", progress=False)
    observation = np.linspace(-0.5, 0.5, 36).astype(np.float32)
    first, second = (load_policy(str(folder))[1](observation) for folder in (run, tmp_path / "again"))
    np.testing.assert_array_equal(first, second)


def test_a_resumed_run_counts_on_and_changes_the_policy(tmp_path):
    folder = tmp_path / "run"
    train(Settings(steps=512, envs=2), folder, progress=False)
    observation = np.linspace(-0.5, 0.5, 36).astype(np.float32)
    before = load_policy(str(folder))[1](observation)
    model = resume(folder, 512, progress=False)
    assert model.num_timesteps == 1024
    assert np.abs(load_policy(str(folder))[1](observation) - before).max() > 0


def test_checkpoints_are_written_on_the_way(tmp_path, monkeypatch):
    saved = []
    monkeypatch.setattr("flexman_agents.training.save", lambda model, folder: saved.append(model.num_timesteps) or True)
    train(Settings(steps=1024, envs=2), tmp_path / "run", checkpoint_every=512, progress=False)
    assert saved[:-1] == [512, 1024]


def test_sac_trains_and_goes_on_with_its_memory(tmp_path):
    train(Settings(algo="sac", steps=64, envs=2), tmp_path / "sac", progress=False)
    model = resume(tmp_path / "sac", 64, progress=False)
    assert model.replay_buffer.pos == 64  # of two environments each
    assert np.abs(load_policy(str(tmp_path / "sac"))[1](np.zeros(36, dtype=np.float32))).max() <= 1.0


def test_a_folder_is_not_trained_over(run):
    with pytest.raises(ValueError, match=r"folder: .* is not allowed; give a new one, or resume"):
        train(Settings(), run, progress=False)


@pytest.mark.parametrize(
    "keywords, message",
    [
        ({"algo": "dqn"}, "algo: 'dqn' is not allowed; give one of ppo, sac"),
        ({"env": "CartPole-v1"}, "env: 'CartPole-v1' is not allowed; give one of FlexRRR-v0"),
        ({"steps": 0}, "steps: 0 is not allowed; give a whole number from 1"),
        ({"seed": -1}, "seed: -1 is not allowed; give a whole number from 0"),
        ({"envs": 2.5}, "envs: 2.5 is not allowed; give a whole number from 1"),
    ],
)
def test_bad_settings_are_named(keywords, message):
    with pytest.raises(ValueError) as caught:
        Settings(**keywords)
    assert message in str(caught.value)
    assert "\n" not in str(caught.value)


def test_an_episode_that_stands_still_on_its_target_has_settled_at_once():
    figures = episode_figures(500.0, np.ones((501, 3)), np.zeros(501), 0.02, "")
    assert (figures.tip_error, figures.vibration, figures.settling_time) == (0.0, 0.0, 0.0)


def test_vibration_is_the_peak_to_peak_of_the_last_seconds_and_settling_the_last_entry():
    time = 0.02 * np.arange(501)
    tips = np.zeros((501, 3))
    tips[:, 1] = 0.03 * np.cos(2 * np.pi * time)  # whole periods in 3 s
    errors = np.where(time < 3.99, 1.0, 0.01)
    figures = episode_figures(0.0, tips, errors, 0.02, "")
    assert figures.vibration == pytest.approx(0.06, rel=1e-3)
    assert figures.settling_time == pytest.approx(4.0)
    assert figures.tip_error == 0.01


def test_a_failed_episode_never_settles():
    figures = episode_figures(-10.0, np.zeros((3, 3)), np.zeros(3), 0.02, "motor_rates")
    assert np.isinf(figures.settling_time)
    assert np.isnan(figures.vibration)


def test_pd_beats_doing_nothing_and_random_torques_and_policies_share_episodes(run):
    results = {name: evaluate(name, 3, seed=1000) for name in ("pd", "zero", "random")}
    reward = {name: np.mean([episode.total_reward for episode in episodes]) for name, episodes in results.items()}
    assert reward["pd"] > reward["zero"] > reward["random"]
    assert evaluate("zero", 3, seed=1000) == results["zero"]
    assert len(table(results).splitlines()) == 5


def test_missing_and_broken_policies_give_one_line(tmp_path, run):
    with pytest.raises(FileNotFoundError, match="give the folder of a training run, or pd, zero, random"):
        load_policy(str(tmp_path / "nothing"))
    with pytest.raises(FileNotFoundError, match=f"{SETTINGS}: no such file; give a folder"):
        load_policy(str(tmp_path))
    (tmp_path / SETTINGS).write_text("{}")
    with pytest.raises(ValueError, match="give the settings of a training run"):
        load_policy(str(tmp_path))
    (tmp_path / SETTINGS).write_text((run / SETTINGS).read_text())
    with pytest.raises(FileNotFoundError, match=f"{MODEL}: no such file"):
        load_policy(str(tmp_path))


@pytest.mark.parametrize(
    "script, arguments",
    [
        ("evaluate.py", ["no_such_run"]),
        ("train.py", ["--steps", "0"]),
        ("train.py", ["--resume", "--folder", "no_such_run"]),
    ],
)
def test_command_lines_say_what_is_wrong_in_one_line(script, arguments):
    command = [sys.executable, str(ROOT / "scripts" / script), *arguments]
    done = subprocess.run(command, capture_output=True, text=True, cwd=ROOT, timeout=120)
    assert done.returncode == 2
    assert len(done.stderr.strip().splitlines()) == 1
    assert done.stdout == ""


# Many arms for Stable-Baselines3


def arms_and_singles(count, steps=20, wrapper=lambda env: env, single=lambda env: env):
    """The adapter of the vector environment, and Stable-Baselines3's own vector of as many single environments."""
    options = {"max_episode_steps": steps, "limits": fm.Limits(rate=2.0)}
    env = gym.make_vec("FlexRRR-v0", count, "vector_entry_point", autoreset_mode="SameStep", **options)
    singles = DummyVecEnv([lambda: single(gym.make("FlexRRR-v0", **options))] * count)
    return Arms(wrapper(env)), singles


@pytest.mark.parametrize("residual", [False, True])
@pytest.mark.parametrize("normalised", [False, True])
def test_arms_are_single_environments_side_by_side(residual, normalised):
    wrappers = (VectorResidual, Residual) if residual else ()
    both = [VecMonitor(each) for each in arms_and_singles(3, 20, *wrappers)]
    both = [VecNormalize(each) for each in both] if normalised else both
    for each in both:
        each.seed(4)
    assert np.array_equal(*(each.reset() for each in both))
    random, ends = np.random.default_rng(0), set()
    for _ in range(100):
        actions = random.uniform(-1.0, 1.0, (3, 3)).astype(np.float32)
        (seen, rewards, dones, infos), (others, worth, ended, told) = (each.step(actions) for each in both)
        assert np.array_equal(seen, others) and np.array_equal(dones, ended)
        assert rewards == pytest.approx(worth, rel=1e-6)  # the other vector keeps them in single precision
        for info, expected in zip(infos, told, strict=True):
            if "terminal_observation" not in expected:
                assert info == {}
                continue
            assert info.keys() == expected.keys()
            assert np.array_equal(info["terminal_observation"], expected["terminal_observation"])
            assert info["TimeLimit.truncated"] == expected["TimeLimit.truncated"]
            assert (info["episode"]["l"], info["failure"]) == (expected["episode"]["l"], expected["failure"])
            ends.add(info["TimeLimit.truncated"])
    assert ends == {False, True}


def test_arms_tell_what_they_share_and_refuse_what_they_do_not_have():
    arms, _ = arms_and_singles(2)
    assert arms.get_attr("max_episode_steps") == [20, 20] and arms.get_attr("max_episode_steps", [1]) == [20]
    assert arms.env_is_wrapped(gym.Wrapper) == [False, False] and not arms.has_attr("nothing")
    assert arms.seed(3) == [3, 4]
    with pytest.raises(ValueError, match=r"^set_attr: 'task' is not allowed; give arguments to the environment as"):
        arms.set_attr("task", None)
    with pytest.raises(ValueError, match=r"^env_method: 'reset' is not allowed; give a call of a method of `env`"):
        arms.env_method("reset")
    arms.set_options({"start": [0.1, 0.2, 0.3]})
    seen = arms.reset()
    assert seen[:, :3] == pytest.approx(np.array([[0.1, 0.2, 0.3]] * 2))
    assert (arms.reset()[:, :3] != seen[:, :3]).any(), "options hold for one reset"
    arms.set_options([{"start": [0.0] * 3}, {}])
    with pytest.raises(ValueError, match=r"^options: .* give the same options for all environments$"):
        arms.reset()
    with pytest.raises(ValueError, match=r"^autoreset_mode: .* give an environment made with AutoresetMode.SAME_STEP$"):
        Arms(gym.make_vec("FlexRRR-v0", 2))
    arms.close()

"""Training: a run is repeatable, keeps what it is, can go on, shows its curves and keeps its best policy."""

import csv
import json
import shutil
from dataclasses import replace
from types import SimpleNamespace

import gymnasium as gym
import numpy as np
import pytest

from flexman_agents import callbacks
from flexman_agents.callbacks import Evaluation
from flexman_agents.sb3 import make_model
from flexman_agents.settings import Settings
from flexman_agents.training import resume, train
from flexman_gym.common.run_folder import BEST, NEWEST, SETTINGS, read_npz, write_npz
from flexman_gym.evaluation.agent_info import CPU_COLUMN, training_seconds
from flexman_gym.evaluation.agents import find_agent
from flexman_gym.evaluation.metrics import METRICS
from flexman_gym.evaluation.rollouts import SELECTION_SEEDS, rollout, training_seed
from flexman_gym.toolbox.league.rows import run_league

from oracles.assertions import refusal
from oracles.runs import RUNS

pytest.importorskip("stable_baselines3")


PD = {"id": "FlexOne-v0", "base": "pd", "action_repeat": 5, "sensors": ["full", "fine"], "horizon": 1.0}
SHORT = Settings(
    environment=PD, steps=512, envs=2, seed=3, hyperparameters={"net_arch": [16]},
    schedules={"learning_rate": {"start": 1e-3, "end": 0.0}, "log_std": {"start": -1.0, "end": -4.0, "until": 0.8}},
)  # fmt: skip
SIZE = 18 + 14  # numbers that a FlexOne agent sees with both sensors


def acts(folder):
    """What the policy of a run does with some observations."""
    observations = np.linspace(-0.5, 0.5, 3 * SIZE).reshape(3, SIZE).astype(np.float32)
    return find_agent(str(folder)).law(observations)


@pytest.fixture(scope="module")
def trained(tmp_path_factory):
    """A PPO run of two rollouts on the PD controller, evaluated once on three episodes: its folder and its model."""
    folder = tmp_path_factory.mktemp("runs") / "ppo"
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(callbacks, "SELECTION_SEEDS", range(5000, 5003))
        return folder, train(replace(SHORT, eval_every=512), folder, progress=False)


@pytest.mark.slow
def test_a_run_keeps_model_statistics_settings_versions_and_the_whole_arm(trained):
    folder, _ = trained
    assert {NEWEST, SETTINGS, BEST, "progress.csv"} <= {path.name for path in folder.iterdir()}
    record = json.loads((folder / SETTINGS).read_text())
    assert record["seed"] == 3 and {"numba", "torch", "flexman_gym", "python"} <= record["versions"].keys()
    assert record["environment"]["arm"]["links"][0]["length"] == 0.8
    assert Settings.load(folder) == replace(SHORT, eval_every=512)


@pytest.mark.slow
def test_the_same_seed_trains_the_same_policy_and_another_seed_another(trained, tmp_path):
    """Evaluated or not."""
    for seed in (3, 4):
        train(SHORT.with_seed(seed), tmp_path / str(seed), progress=False)
    assert np.array_equal(acts(trained[0]), acts(tmp_path / "3"))
    assert (acts(tmp_path / "4") != acts(tmp_path / "3")).any()


@pytest.mark.slow
def test_schedules_reach_the_optimiser_and_the_exploration(trained):
    """Two rollouts of 256 steps: the second has the deviation of half of the training; the last rate is the end."""
    _, model = trained
    assert model.policy.log_std.tolist() == pytest.approx([-1.0 - 3.0 * 0.5 / 0.8])
    assert not model.policy.log_std.requires_grad
    assert model.policy.optimizer.param_groups[0]["lr"] == 0.0 and model.lr_schedule(0.25) == pytest.approx(2.5e-4)


def test_curves_are_in_a_csv_and_in_events(trained):
    folder, _ = trained
    assert list(folder.glob("events.out.tfevents.*"))
    with (folder / "progress.csv").open() as lines:
        rows = list(csv.DictReader(lines))
    assert [int(row["time/total_timesteps"]) for row in rows] == [256, 512]
    columns = {name for name in rows[0] if name.startswith("selection/")}
    assert columns == {f"selection/{name}" for name in (
        "settled", "settling_time_s", "vibration_m", "error_m", "roughness", "reward", "failed")}  # fmt: skip
    assert all(rows[-1][name] for name in columns)
    assert "rollout/ep_rew_mean" in rows[0]
    assert 0.0 < float(rows[0][CPU_COLUMN]) < float(rows[1][CPU_COLUMN]) == training_seconds(str(folder))


@pytest.mark.slow
def test_a_finished_run_goes_on_as_another_run(trained, tmp_path, capsys):
    """It begins with the policy of the first, counts from zero, and says so; its curves have a file of their own."""
    folder = tmp_path / "run"
    train(replace(SHORT, schedules={}), folder, progress=False)
    before = acts(folder)
    assert resume(folder, 256, progress=False).num_timesteps == 256
    assert "The run of 512 steps was finished; a further run of 256 steps starts from it." in capsys.readouterr().err
    assert 0 < np.abs(acts(folder) - before).max() < 0.5
    assert read_npz(folder / NEWEST)["before"] == 512 and Settings.load(folder).steps == 256
    with (folder / "progress-512.csv").open() as lines:
        assert [int(row["time/total_timesteps"]) for row in csv.DictReader(lines)] == [256]
    with (folder / "progress.csv").open() as lines:
        assert len(list(csv.DictReader(lines))) == 2


@pytest.mark.slow
def test_the_curves_of_every_further_run_begin_after_all_steps_before(tmp_path):
    """Three runs of different lengths in one folder, none of which overwrites what another has drawn."""
    chosen = {"n_steps": 16, "batch_size": 32, "net_arch": [8]}
    train(replace(SHORT, steps=32, hyperparameters=chosen, schedules={}), tmp_path / "run", progress=False)
    for steps in (96, 64):
        resume(tmp_path / "run", steps, progress=False)
    lasts = {}
    for path in (tmp_path / "run").glob("progress*.csv"):
        with path.open() as lines:
            lasts[path.name] = int(list(csv.DictReader(lines))[-1]["time/total_timesteps"])
    assert lasts == {"progress.csv": 32, "progress-32.csv": 96, "progress-128.csv": 64}


@pytest.mark.slow
def test_a_run_that_keeps_its_best_policy_goes_on_only_where_it_is_evaluated(trained, tmp_path, monkeypatch):
    """The best so far is remembered: a worse one later does not take its place."""
    folder = tmp_path / "run"
    shutil.copytree(trained[0], folder)
    line = refusal(resume, folder, 256, 0, False, "cpu", 0)
    assert line == f"eval_every: 0 is not allowed; give the steps between evaluations, > 0: {folder} has a best policy"
    rewards = iter([-1e6, 1e6, 0.0])  # the last at the end
    monkeypatch.setattr(callbacks, "evaluate", lambda *given: dict.fromkeys(METRICS, 1.0) | {"reward": next(rewards)})
    kept = []
    monkeypatch.setattr(
        "flexman_agents.training.write_npz", lambda path, data: kept.append((path.name, data.get("before")))
    )
    resume(folder, 512, progress=False, eval_every=256)
    assert kept == [(BEST, None), (NEWEST, 512)]


@pytest.mark.slow
def test_checkpoints_are_written_where_rollouts_begin(tmp_path, monkeypatch):
    saved = []
    monkeypatch.setattr(
        "flexman_agents.training.write_npz",
        lambda path, data: saved.append(data["training"]["counts"]["num_timesteps"]),
    )
    train(replace(SHORT, steps=1024), tmp_path / "run", checkpoint_every=300, progress=False)
    assert saved == [512, 1024]


@pytest.mark.slow
def test_sac_trains_and_goes_on_with_its_memory(tmp_path):
    settings = Settings("sac", PD, 64, envs=2, hyperparameters={"learning_starts": 16, "batch_size": 8})
    train(settings, tmp_path / "sac", progress=False)
    assert read_npz(tmp_path / "sac" / NEWEST)["training"]["replay"]["pos"] == 32
    assert resume(tmp_path / "sac", 64, progress=False).replay_buffer.pos == 64  # of two arms each
    assert np.abs(acts(tmp_path / "sac")).max() <= 1.0


def test_the_entropy_that_sac_aims_at_follows_its_schedule(tmp_path):
    """Of two arms: 14 of 16 steps are done as the last one begins, and the end is reached after 12 of them."""
    chosen = {"learning_starts": 4, "batch_size": 4, "net_arch": [8]}
    for until, expected in ((1.0, -1.0 - 4.0 * 14 / 16), (0.75, -5.0)):
        aims = {"target_entropy": {"start": -1.0, "end": -5.0, "until": until}}
        settings = Settings("sac", PD, 16, envs=2, hyperparameters=chosen, schedules=aims)
        model = train(settings, tmp_path / str(until), progress=False)
        assert model.target_entropy == pytest.approx(expected)


def test_the_best_policy_is_the_one_that_acts(trained, tmp_path):
    other = tmp_path / "run"
    shutil.copytree(trained[0], other)
    data = read_npz(other / BEST)
    write_npz(other / BEST, {**data, "policy": {name: 2.0 * array for name, array in data["policy"].items()}})
    best = acts(other)
    (other / BEST).unlink()
    assert (acts(other) != best).any() and np.array_equal(acts(other), acts(trained[0]))


def test_hyperparameters_are_those_of_the_settings_before_the_defaults():
    model = make_model(replace(SHORT, hyperparameters={"gamma": 0.9, "activation": "relu", "n_steps": 10}))
    assert model.gamma == 0.9 and model.gae_lambda == 0.99 and model.n_steps == 10
    assert model.batch_size == 20, "not more than two arms give in ten steps"
    assert model.policy_kwargs["activation_fn"].__name__ == "ReLU"
    assert model.policy_kwargs["net_arch"] == [128, 128]


@pytest.mark.parametrize("normalised", [True, False])
def test_rewards_are_normalised_where_they_should_be_and_by_returns_of_the_same_discount(normalised):
    model = make_model(replace(SHORT, normalise_reward=normalised, hyperparameters={"gamma": 0.9, "net_arch": [8]}))
    statistics = model.get_vec_normalize_env()
    assert (statistics.norm_reward, statistics.gamma, model.gamma) == (normalised, 0.9, 0.9)


def test_a_training_begins_with_seeds_of_its_own(trained):
    """Those that no evaluation and no table has, one after the other for the arms."""
    model, env = make_model(SHORT), gym.make(PD["id"], **SHORT.environment.keywords())
    model.get_env().reset()
    for arm, seen in enumerate(model.get_vec_normalize_env().get_original_obs()):
        assert np.array_equal(seen, env.reset(seed=training_seed(SHORT.seed) + arm)[0])


# What is refused


def test_a_folder_is_not_trained_over(trained):
    assert refusal(train, SHORT, trained[0]) == (
        f"folder: {trained[0]} is not allowed; give a new one, or resume the run in it"
    )


def test_a_refused_training_leaves_no_folder(tmp_path):
    settings = replace(SHORT, hyperparameters={"gama": 0.9})
    line = refusal(train, settings, tmp_path / "run")
    assert line.startswith("hyperparameters: 'gama' is not allowed; give one of ") and "gamma" in line
    assert list(tmp_path.iterdir()) == []


def test_missing_and_broken_runs_give_one_line(trained, tmp_path):
    with pytest.raises(
        FileNotFoundError, match="does not exist; give the folder of a training run, or one of pd, pd-torque"
    ):
        find_agent(str(tmp_path / "nothing"))
    with pytest.raises(FileNotFoundError, match=f"{SETTINGS}: no such file; give a folder"):
        find_agent(str(tmp_path))
    (tmp_path / SETTINGS).write_text("{}")
    with pytest.raises(ValueError, match="settings of a training run"):
        find_agent(str(tmp_path))
    (tmp_path / SETTINGS).write_text((trained[0] / SETTINGS).read_text())
    with pytest.raises(FileNotFoundError, match=f"{NEWEST}: no such file"):
        find_agent(str(tmp_path))
    with pytest.raises(FileNotFoundError, match=f"{SETTINGS}: no such file"):
        resume(tmp_path / "nothing", 64)


# Evaluation


def evaluate_with(monkeypatch, outcomes, rollout=50):
    """An evaluation of a policy whose shares of settled episodes and rewards are given, one pair at every 100 steps."""
    kept, logged, results = [], [], iter(outcomes)

    def evaluate(entrant, environment, seeds):
        share, reward = next(results)
        assert entrant.interface.items() >= {"base": "pd", "action_repeat": 5, "sensors": ["full", "fine"]}.items()
        assert seeds == range(5000, 5100)
        assert environment.id == "FlexOne-v0" and not {"base", "action_repeat", "sensors"} & environment.given.keys()
        return dict.fromkeys(METRICS, 0.0) | {"settled": share, "reward": reward}

    monkeypatch.setattr(callbacks, "evaluate", evaluate)
    evaluation = Evaluation(replace(SHORT, eval_every=100), None, lambda: kept.append(evaluation.num_timesteps))
    evaluation.model = SimpleNamespace(logger=SimpleNamespace(record=lambda name, value: logged.append((name, value))))
    for step in range(rollout, 100 * len(outcomes) + 1, rollout):
        evaluation.num_timesteps = step
        evaluation._on_rollout_end()
    return kept, logged


def test_the_evaluation_saves_the_policy_of_the_highest_reward(monkeypatch):
    outcomes = [(0.5, -1.0), (0.4, -2.0), (0.4, 0.5), (0.9, 0.5), (0.8, 2.0), (0.9, 1.0)]
    kept, logged = evaluate_with(monkeypatch, outcomes)
    assert kept == [100, 300, 500]
    assert [value for name, value in logged if name == "selection/settled"] == [share for share, _ in outcomes]
    assert [value for name, value in logged if name == "selection/reward"] == [reward for _, reward in outcomes]


def test_the_evaluation_warns_once_when_a_policy_has_become_much_worse(monkeypatch, capsys):
    evaluate_with(monkeypatch, [(0.9, 1.0), (0.75, 1.0), (0.6, 1.0), (0.5, 1.0), (1.0, 2.0), (0.1, 1.0)])
    said = capsys.readouterr()
    assert said.out == "" and said.err.splitlines() == [
        "after 300 steps the policy is worse than before: 60% settle instead of 90%; the best one is kept",
        "after 600 steps the policy is worse than before: 10% settle instead of 100%; the best one is kept",
    ]


def test_two_evaluations_are_never_nearer_than_asked_for(monkeypatch):
    """Rollouts of 60 steps, each better than the one before; after the first that is too long none makes up for it."""
    kept, _ = evaluate_with(monkeypatch, [(1.0, float(reward)) for reward in range(8)], rollout=60)
    assert kept[0] == 120 and np.diff(kept).min() >= 100 and len(kept) > 3


def test_the_curves_show_the_evaluations_with_their_units(monkeypatch):
    logged = {}
    seen = dict.fromkeys(METRICS, 0.0) | {"settling_time": 2.0, "vibration": 0.2, "error": 0.02}
    monkeypatch.setattr(callbacks, "evaluate", lambda *given: seen)
    evaluation = Evaluation(replace(SHORT, eval_every=1), None, lambda: None)
    evaluation.model = SimpleNamespace(logger=SimpleNamespace(record=logged.__setitem__))
    evaluation.num_timesteps = 1
    evaluation._on_rollout_end()
    names = "settling_time_s", "vibration_m", "error_m"
    assert [logged[f"selection/{name}"] for name in names] == pytest.approx([2.0, 0.2, 0.02])


def test_at_first_the_value_function_learns_alone():
    """Its first rollout changes the value function and not the policy, the second changes both; actions begin at 0."""
    chosen = {"net_arch": [8], "n_steps": 32, "ortho_init": False}
    settings = replace(SHORT, steps=128, hyperparameters=chosen, schedules={}, value_warmup=64)
    model = make_model(settings)
    policy, value = model.policy.mlp_extractor.policy_net[0], model.policy.mlp_extractor.value_net[0]
    assert not model.policy.action_net.weight.any() and not model.policy.action_net.bias.any()
    before = [each.weight.detach().clone() for each in (policy, value)]
    model.learn(64, callback=callbacks.ValueWarmup(64))
    assert (policy.weight == before[0]).all() and (value.weight != before[1]).any()
    model.learn(64, callback=callbacks.ValueWarmup(64), reset_num_timesteps=False)
    assert (model.policy.action_net.weight != 0.0).any()


pytest.importorskip("stable_baselines3")


@pytest.mark.slow
def test_a_run_plays_as_by_itself_and_is_played_anew_when_it_has_learned(tmp_path):
    folder, said = str(tmp_path / "run"), []
    train(RUNS["ppo"], tmp_path / "run", progress=False)
    for _ in range(2):
        book = run_league([folder], ["FlexOne-v0"], range(9000, 9002), tmp_path, log=said.append)
    values = [row.values[: len(METRICS)] for _, row in sorted(book.rows.items())]
    records = rollout(folder, "FlexOne-v0", range(9000, 9002)).records
    assert values == [tuple(metric.function(record) for metric in METRICS.values()) for record in records]
    assert len(said) == 1, "nothing is played twice"
    (tmp_path / "run" / "best.npz").unlink()  # the newest policy acts now
    run_league([folder], ["FlexOne-v0"], range(9000, 9002), tmp_path, log=said.append)
    assert len(said) == 2
    assert "nor selected on the seed 5000" in refusal(run_league, [folder], ["FlexOne-v0"], SELECTION_SEEDS, tmp_path)

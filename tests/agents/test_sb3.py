"""Stable-Baselines3: a model is an agent, in memory and as a trusted zip; the files of rl_zoo3 equal the recipes."""

from dataclasses import replace

import gymnasium as gym
import numpy as np
import pytest
import yaml

pytest.importorskip("stable_baselines3")

from stable_baselines3 import PPO, SAC
from torch import nn

from flexman_agents import callbacks
from flexman_agents.sb3 import (
    ACTIVATION_LAYERS,
    DEFAULT_LOG_STD,
    DEFAULT_NET_ARCH,
    EXPLORATION_CALLBACK,
    ZOO_FOLDER,
    load_sb3,
    make_model,
    write_zoo_files,
    zoo_hyperparameters,
)
from flexman_agents.settings import DEFAULT_HYPERPARAMETERS, RECIPES, find_recipe
from flexman_gym.__main__ import main
from flexman_gym.envs.config.configuration import Configuration
from flexman_gym.evaluation import AgentSpec, find_agent, rollout
from flexman_gym.evaluation.agent import split_interface

from oracles.assertions import refusal
from oracles.runs import RUNS


@pytest.fixture(scope="module", params=RUNS)
def model(request):
    """A model whose statistics are not those of nothing."""
    result = make_model(RUNS[request.param])
    random, statistics = np.random.default_rng(0), result.get_vec_normalize_env().obs_rms
    statistics.mean[:] = random.normal(0.0, 0.1, statistics.mean.shape)
    statistics.var[:] = random.uniform(0.5, 2.0, statistics.var.shape)
    return result


def torques(entrant, environment):
    """What it asks of the motors in two episodes."""
    return rollout(entrant, environment, [0, 1]).actions


def test_a_model_brings_environment_interface_and_statistics(model, tmp_path, capsys):
    settings = RUNS["ppo"]
    environment, interface = split_interface(settings.environment)
    entrant = find_agent(model)
    both = entrant.environment, environment
    assert both[0].disturbances == both[1].disturbances and both[0].horizon == 0.6 and both[0].action_repeat == 1
    normalised = model.get_vec_normalize_env().normalize_obs
    own = AgentSpec("own", lambda seen: model.predict(normalised(seen), deterministic=True)[0], interface)
    expected = torques(own, environment)
    assert np.array_equal(torques(model, environment), expected) and np.abs(expected).max() > 0.01

    path = tmp_path / "own.zip"
    model.save(path)
    model.get_vec_normalize_env().save(str(path.with_suffix(".pkl")))
    assert "--trust" in refusal(find_agent, str(path))
    loaded = load_sb3(path, settings.environment)
    assert loaded.name == "own" and np.array_equal(torques(loaded, environment), expected)
    here = Configuration(environment.id, {**environment.settings, **interface})
    assert np.array_equal(torques(load_sb3(path), here), expected), "it sees and holds as it is told there"
    path.with_suffix(".pkl").write_bytes(b"noise")
    assert "this is not a policy of Stable-Baselines3" in refusal(load_sb3, path)
    path.write_bytes(b"noise")
    assert "this is not a policy of Stable-Baselines3" in refusal(load_sb3, path)
    assert main(["evaluate", str(path), "--trust"]) == 2 and "own.zip" in capsys.readouterr().err


def test_the_files_are_those_of_the_recipes(tmp_path):
    write_zoo_files(tmp_path)
    assert {*RECIPES} - {path.stem for path in tmp_path.iterdir()} == {"lab_student"}, "an imitation"
    assert sorted(path.name for path in ZOO_FOLDER.iterdir()) == sorted(path.name for path in tmp_path.iterdir())
    for path in tmp_path.iterdir():
        assert path.read_text() == (ZOO_FOLDER / path.name).read_text(), "write_zoo_files() writes them anew"


@pytest.mark.parametrize("name", sorted(path.stem for path in ZOO_FOLDER.glob("*.yml")))
def test_an_entry_makes_the_same_environment_and_the_same_algorithm(name):
    """As rl_zoo3 reads it: env_kwargs go to `gym.make`, policy_kwargs are an expression, the rest goes to the class."""
    settings = find_recipe(name)
    ((id, entry),) = yaml.safe_load((ZOO_FOLDER / f"{name}.yml").read_text()).items()
    env = gym.make(id, **entry.pop("env_kwargs"))
    ours = gym.make(settings.environment.id, **settings.environment.keywords())
    result, expected = (each.unwrapped.episodes for each in (env, ours))
    assert result.agent.action_repeat == expected.agent.action_repeat and result.task == expected.task
    assert type(result.base) is type(expected.base)
    assert env.observation_space == ours.observation_space
    assert (entry.pop("n_envs"), entry.pop("n_timesteps")) == (settings.envs, settings.steps)
    assert entry.pop("normalize") == {"norm_obs": True, "norm_reward": settings.normalise_reward}
    policy = eval(entry.pop("policy_kwargs"), {"nn": nn})
    chosen = DEFAULT_HYPERPARAMETERS[settings.algo] | dict(settings.hyperparameters)
    names = ("net_arch", "log_std_init", "ortho_init", "activation")
    own = {"net_arch": DEFAULT_NET_ARCH, "log_std_init": DEFAULT_LOG_STD[settings.algo]}
    own |= {each: chosen.pop(each) for each in names if each in chosen}
    if "activation" in own:
        own["activation_fn"] = ACTIVATION_LAYERS[own.pop("activation")]
    assert policy == own
    fixed = chosen.pop("learning_rate", None)
    exploration, rate = entry.pop("callback", None), settings.schedule("learning_rate") or (lambda _: fixed)
    if exploration is not None:
        made = callbacks.Exploration(**exploration[EXPLORATION_CALLBACK])
        assert made._schedule in map(settings.schedule, settings.schedules) and made._steps == settings.steps
    assert (exploration is None) == (settings.schedules.keys() == {"learning_rate"})
    said = entry.pop("learning_rate")
    start = float(said.removeprefix("lin_")) if isinstance(said, str) else said
    for remaining in (1.0, 0.3, 0.0):
        falling = start * (remaining if isinstance(said, str) else 1.0)
        assert falling == pytest.approx(rate(remaining))
    assert entry == {"policy": "MlpPolicy", **chosen}
    made = entry | {"learning_rate": start} | ({"buffer_size": 10} if settings.algo == "sac" else {})
    {"ppo": PPO, "sac": SAC}[settings.algo](env=env, **made)


def test_a_schedule_that_rl_zoo3_cannot_say_is_refused():
    settings = replace(find_recipe("ppo_alone"), schedules={"learning_rate": {"start": 1e-3, "end": 1e-4}})
    assert refusal(zoo_hyperparameters, settings).startswith(
        "schedules.learning_rate: Schedule(start=0.001, end=0.0001, until=1.0) is"
    )
    early = replace(settings, schedules={"learning_rate": {"start": 1e-3, "end": 0.0, "until": 0.5}})
    assert "decreases to zero at the end, for rl_zoo3" in refusal(zoo_hyperparameters, early), (
        "it falls to zero half way"
    )


def test_a_rate_that_stays_is_written_as_a_number():
    settings = replace(find_recipe("ppo_alone"), schedules={"learning_rate": {"start": 1e-3, "end": 1e-3}})
    (entry,) = zoo_hyperparameters(settings).values()
    assert entry["learning_rate"] == 1e-3

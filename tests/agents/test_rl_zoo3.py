"""Zoo: the files for rl_zoo3 say what the recipes say."""

from dataclasses import replace

import gymnasium as gym
import pytest
import yaml

pytest.importorskip("stable_baselines3")

from stable_baselines3 import PPO, SAC
from torch import nn

from flexman_agents import callbacks
from flexman_agents.rl_zoo3 import CALLBACK, KNOWN, ZOO, write_zoo_files, zoo_hyperparameters
from flexman_agents.sb3 import algorithm_arguments
from flexman_agents.settings import RECIPES, find_recipe

from oracles.assertions import refusal


def test_the_files_are_those_of_the_recipes(tmp_path):
    assert {*RECIPES} - {*KNOWN} == {"lab_student"}, "an imitation, which rl_zoo3 does not have"
    write_zoo_files(tmp_path)
    assert sorted(path.name for path in ZOO.iterdir()) == sorted(path.name for path in tmp_path.iterdir())
    for path in tmp_path.iterdir():
        assert path.read_text() == (ZOO / path.name).read_text(), "write_zoo() writes them anew"


@pytest.mark.parametrize("name", KNOWN)
def test_an_entry_makes_the_same_environment_and_the_same_algorithm(name):
    """As rl_zoo3 reads it: env_kwargs go to `gym.make`, policy_kwargs are an expression, the rest goes to the class."""
    settings = find_recipe(name)
    ((id, entry),) = yaml.safe_load((ZOO / f"{name}.yml").read_text()).items()
    env = gym.make(id, **entry.pop("env_kwargs"))
    ours = gym.make(settings.environment.id, **settings.environment.keywords())
    result, expected = (each.unwrapped.episodes for each in (env, ours))
    assert (
        result.agent.action_repeat == expected.agent.action_repeat
        and type(result.base) is type(expected.base)
        and result.task == expected.task
    )
    assert env.observation_space == ours.observation_space
    assert (entry.pop("n_envs"), entry.pop("n_timesteps")) == (settings.envs, settings.steps)
    assert entry.pop("normalize") == {"norm_obs": True, "norm_reward": settings.normalise_reward}
    policy = eval(entry.pop("policy_kwargs"), {"nn": nn})
    chosen = algorithm_arguments(settings)
    assert policy == chosen.pop("policy_kwargs")
    exploration, rate = entry.pop("callback", None), chosen.pop("learning_rate")
    if exploration is not None:
        made = callbacks.Exploration(**exploration[CALLBACK])
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
    assert "falls to zero at the end, for rl_zoo3" in refusal(zoo_hyperparameters, early), "it falls to zero half way"


def test_a_rate_that_stays_is_written_as_a_number():
    settings = replace(find_recipe("ppo_alone"), schedules={"learning_rate": {"start": 1e-3, "end": 1e-3}})
    (entry,) = zoo_hyperparameters(settings).values()
    assert entry["learning_rate"] == 1e-3

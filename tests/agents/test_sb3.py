"""Stable-Baselines3: a model is an agent, in memory and as a trusted zip."""

import sys
from dataclasses import replace

import numpy as np
import pytest
import torch

pytest.importorskip("stable_baselines3")


from flexman_agents.sb3 import (
    load_sb3,
    make_model,
)
from flexman_gym.__main__ import main
from flexman_gym.envs.config.configuration import Configuration
from flexman_gym.evaluation.agent_spec import AgentSpec, split_interface
from flexman_gym.evaluation.agents import find_agent
from flexman_gym.evaluation.rollouts import rollout

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
    here = Configuration(environment.id, {**environment.given, **interface})
    assert np.array_equal(torques(load_sb3(path), here), expected), "it sees and holds as it is told there"
    path.with_suffix(".pkl").write_bytes(b"noise")
    assert "this is not a policy of Stable-Baselines3" in refusal(load_sb3, path)
    path.write_bytes(b"noise")
    assert "this is not a policy of Stable-Baselines3" in refusal(load_sb3, path)
    assert main(["evaluate", str(path), "--trust"]) == 2 and "own.zip" in capsys.readouterr().err


@pytest.mark.parametrize("algo", ["sac", "tqc"])
def test_layer_normalisation_is_in_the_critics_alone(algo):
    chosen = {"net_arch": {"pi": [8, 8], "qf": [12, 10]}, "critic_norm": True}
    model = make_model(replace(RUNS[algo], hyperparameters=chosen))
    for critic in (model.critic, model.critic_target):
        for network in critic.q_networks:
            kinds = [type(layer) for layer in network]
            assert kinds == 2 * [torch.nn.Linear, torch.nn.LayerNorm, torch.nn.ReLU] + [torch.nn.Linear]
            assert [layer.normalized_shape for layer in network[1::3]] == [(12,), (10,)]
    assert not any(isinstance(each, torch.nn.LayerNorm) for each in model.actor.modules())
    optimised = {id(each) for group in model.critic.optimizer.param_groups for each in group["params"]}
    assert {id(each) for each in model.critic.parameters()} == optimised
    target, trained = model.critic_target.state_dict(), model.critic.state_dict()
    assert all(torch.equal(target[name], each) for name, each in trained.items())


@pytest.mark.parametrize("algo", ["ppo", "crossq"])
def test_layer_normalisation_is_refused_where_no_critic_has_it(algo):
    line = refusal(make_model, replace(RUNS[algo], hyperparameters={"critic_norm": True}))
    assert line.startswith("hyperparameters: 'critic_norm' is not allowed; give one of ")


@pytest.mark.parametrize("algo", ["tqc", "crossq"])
def test_without_sb3_contrib_its_algorithms_are_refused_and_others_train(algo, tmp_path, monkeypatch, capsys):
    monkeypatch.setitem(sys.modules, "sb3_contrib", None)
    line = f"algo: {algo} needs sb3_contrib: pip install 'flexman_gym[train]'"
    with pytest.raises(ImportError) as error:
        make_model(RUNS[algo])
    assert str(error.value) == line
    folder = tmp_path / "run"
    assert main(["train", "--algo", algo, "--env", "FlexOne-v0", "--steps", "1", "--folder", str(folder)]) == 2
    assert capsys.readouterr().err.splitlines() == [line] and not folder.exists()
    assert make_model(RUNS["ppo"]).num_timesteps == make_model(RUNS["sac"]).num_timesteps == 0

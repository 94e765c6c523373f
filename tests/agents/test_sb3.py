"""Stable-Baselines3: a model is an agent, in memory and as a trusted zip."""

import numpy as np
import pytest

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

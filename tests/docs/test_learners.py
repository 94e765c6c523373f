"""Tests of the examples with TorchRL and behaviour cloning."""

import importlib.util

import numpy as np
import pytest

from flexman_gym.envs.config.configuration import Configuration
from flexman_gym.evaluation.agents import find_agent
from flexman_gym.evaluation.rollouts import rollout

from oracles.files import ROOT

pytestmark = pytest.mark.slow


def example(name):
    """Return an example as a module."""
    spec = importlib.util.spec_from_file_location(name, ROOT / "docs" / "examples" / f"{name}.py")
    result = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(result)
    return result


def test_torchrl_collects_what_the_vector_environment_says(monkeypatch):
    """Compare observations and rewards under equal actions bit by bit, across the ends of episodes."""
    pytest.importorskip("torchrl", reason="TorchRL is not installed")
    from torchrl.collectors import Collector

    collect = example("collect")
    monkeypatch.setattr(collect, "ARMS", 3)
    env, native = collect.make(), collect.make()._env
    env.set_seed(0)
    collector = Collector(env, collect.actor(env), frames_per_batch=3 * 130, total_frames=3 * 130)
    (batch,) = collector
    native.reset(seed=0)
    seen, ends = native.reset()[0], 0
    for step in range(130):
        assert np.array_equal(batch["observation"][:, step].numpy(), seen)
        seen, rewards, terminated, truncated, _ = native.step(batch["action"][:, step].numpy())
        assert np.array_equal(batch["next", "observation"][:, step].numpy(), seen)
        assert batch["next", "reward"][:, step, 0].numpy() == pytest.approx(rewards, rel=1e-6)
        over = terminated | truncated
        assert np.array_equal(batch["next", "done"][:, step, 0].numpy(), over)
        if over.any():
            ends += over.sum()
            seen, _ = native.reset(options={"reset_mask": over})
    assert ends == 3


def test_a_clone_acts_nearly_as_whom_it_was_cloned_from_and_is_an_entrant(tmp_path, monkeypatch):
    pytest.importorskip("stable_baselines3")
    pytest.importorskip("minari", reason="Minari is not installed")
    from flexman_gym.toolbox.interchange.dataset import record_dataset

    monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path / "data"))
    environment = Configuration("FlexOne-v0", {"horizon": 2.0})
    record_dataset("pd", environment, range(20), "one/pd-v0")
    error = example("clone").clone("one/pd-v0", tmp_path / "clone", 300)
    played = rollout("pd", environment, [100, 101])
    assert error < 0.1 * np.var(played.actions)
    clone = find_agent(str(tmp_path / "clone"))
    assert np.abs(rollout(clone, environment, [100, 101]).tips - played.tips).max() < 0.1

"""Datasets: those of any agent are read back as they were recorded, and replay to the bit."""

import sys
from types import ModuleType

import numpy as np
import pytest

from flexman_gym.__main__ import main
from flexman_gym.envs.config.configuration import Configuration
from flexman_gym.evaluation.rollouts import rollout
from flexman_gym.toolbox.interchange import dataset
from flexman_gym.toolbox.interchange.dataset import record_dataset

pytestmark = pytest.mark.slow

AGENTS = ("pd", "random", "ppo-flexrrr", "zero")
SEEDS = range(40, 43)
NOISY = Configuration("FlexRRR-v0", {
    "sensors": ["full", {"kind": "tip", "noise": 0.01}], "history": 2, "horizon": 0.6, "base": "pd", "action_repeat": 5,
    "randomisation": {"sensor_noise": [0.01, 0.01], "delay": [0, 2], "payload_mass": [0.0, 10.0]},
    "limits": {"rate": 3.0},
})  # fmt: skip


@pytest.fixture
def datasets(tmp_path, monkeypatch):
    """A place for datasets."""
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path))
    return pytest.importorskip("minari", reason="Minari is not installed")


@pytest.fixture
def recorded(monkeypatch, tmp_path):
    """Function that returns the episodes and the environment of a dataset, without Minari."""
    minari, collector = ModuleType("minari"), ModuleType("minari.data_collector")
    minari.create_dataset_from_buffers = lambda name, buffers, env, **_: (buffers, env)
    collector.EpisodeBuffer = lambda **data: data
    storage = ModuleType("minari.storage")
    storage.get_dataset_path = lambda name: tmp_path / name

    def record(agent, environment):
        with monkeypatch.context() as patch:
            patch.setitem(sys.modules, "minari", minari)
            patch.setitem(sys.modules, "minari.data_collector", collector)
            patch.setitem(sys.modules, "minari.storage", storage)
            return record_dataset(agent, environment, list(SEEDS), "made-up-v0")

    return record


def replayed(env, seed, actions):
    """Observations and rewards of a single environment under actions."""
    seen, rewards = [env.reset(seed=seed)[0]], []
    for action in actions:
        observation, reward, terminated, truncated, _ = env.step(action)
        seen.append(observation)
        rewards.append(reward)
    return np.array(seen), np.array(rewards), terminated, truncated


@pytest.mark.parametrize("agent", AGENTS)
def test_episodes_replay_to_the_bit_in_the_single_environment_although_everything_is_noisy(agent, recorded):
    episodes, env = recorded(agent, NOISY)
    assert not {"base", "action_repeat"} & set(env.spec.kwargs)
    for seed, episode in zip(SEEDS, episodes, strict=True):
        seen, rewards, terminated, truncated = replayed(env, seed, episode["actions"])
        assert seen.tobytes() == episode["observations"].tobytes() and rewards.tolist() == episode["rewards"]
        assert [terminated, truncated] == [episode["terminations"][-1], episode["truncations"][-1]] != [False, False]
        assert not any(episode["terminations"][:-1]) and not any(episode["truncations"][:-1])


def test_actions_are_those_of_the_rollout_as_float32(recorded):
    environment = Configuration("FlexRRR-v0", {"horizon": 0.5})
    result = rollout("lqr", environment, list(SEEDS))
    for number, episode in enumerate(recorded("lqr", environment)[0]):
        assert np.array_equal(episode["actions"], result.actions[number].astype(np.float32))
        assert episode["rewards"] == pytest.approx(result.rewards[number].tolist(), abs=1e-6)


@pytest.mark.parametrize("form", ["hdf5", "arrow"])
def test_a_dataset_is_read_back_to_the_bit_and_gives_its_environment(datasets, recorded, form):
    pytest.importorskip("h5py" if form == "hdf5" else "pyarrow")
    record_dataset("random", NOISY, SEEDS, "flexman/random-v0", form)
    data = datasets.load_dataset("flexman/random-v0")
    known, _ = recorded("random", NOISY)
    env = data.recover_environment()
    assert data.total_episodes == 3 and data.total_steps == sum(len(each["rewards"]) for each in known)
    assert env.spec.id == "FlexRRR-v0" and env.unwrapped.configuration.history == 2
    for read, episode, seed in zip(data.iterate_episodes(), known, SEEDS, strict=True):
        for name in ("observations", "actions", "rewards", "terminations", "truncations"):
            result, expected = getattr(read, name), np.array(episode[name])
            assert result.dtype == expected.dtype and result.tobytes() == expected.tobytes(), name
        assert replayed(env, seed, read.actions)[0].tobytes() == read.observations.tobytes()


def test_the_name_of_an_existing_dataset_is_refused_before_any_episode(datasets, monkeypatch):
    datasets.storage.get_dataset_path("one/pd-v0").mkdir(parents=True)
    monkeypatch.setattr(dataset, "parallel_map", lambda *_, **__: pytest.fail("it began"))
    with pytest.raises(ValueError, match="name: 'one/pd-v0' is not allowed; give a new name"):
        record_dataset("pd", "FlexOne-v0", [0], "one/pd-v0")


def test_the_command_writes_a_dataset_for_each_agent(datasets, capsys):
    given = ["--env", "FlexOne-v0", "--set", "horizon=0.4", "--episodes", "2", "--name", "one"]
    assert main(["record", "zero", "pd", *given]) == 0
    assert capsys.readouterr().out.splitlines()[0].startswith("one/zero-v0: 2 episodes, 40 steps, ")
    assert set(datasets.list_local_datasets()) == {"one/zero-v0", "one/pd-v0"}
    assert main(["record", "zero", *given]) == 2 and "already exists" in capsys.readouterr().err

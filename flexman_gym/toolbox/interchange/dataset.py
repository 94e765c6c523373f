"""Datasets for offline reinforcement learning: episodes of an agent in the format of Minari."""

import warnings
from collections.abc import Iterator, Sequence
from typing import Any

import gymnasium as gym
import numpy as np

from flexman_gym.common.computer import optional_module
from flexman_gym.common.errors import value_error
from flexman_gym.common.parallel import Workers, parallel_map
from flexman_gym.envs.config.configuration import Configuration
from flexman_gym.envs.vector_env import compile_kernels
from flexman_gym.evaluation.rollouts import rollout

BLOCK = 50  # number of episodes simulated together
OBSERVATION_SETTINGS = ("sensors", "history")  # settings of the environment that determine the observations


def record_dataset(
    agent: str, environment: str | Configuration, seeds: Sequence[int], name: str, form: str = "hdf5",
    workers: Workers | int = 1,
) -> Any:  # fmt: skip
    """Record episodes of an agent as a new dataset in the folder of Minari; return the MinariDataset.

    The environment of the dataset has neither base controller nor action repeat: its actions are the commanded torques
    of each control period, as float32, for any agent. The method `recover_environment` of the dataset returns an
    environment in which these actions reproduce observations and rewards bit for bit.

    Args:
        agent: see `rollout`.
        environment: see `rollout`; its sensors and history determine the observations.
        seeds: seed of each episode.
        name: name of the dataset, such as "flexrrr/pd-v0".
        form: file format, "hdf5" or "arrow".
        workers: processes or cluster for the simulations, see `Workers`, or a number of processes.

    Raises:
        ImportError: without Minari.
        ValueError, FileNotFoundError: for an unknown agent or environment.
        ValueError: for arguments that are not allowed, such as the name of an existing dataset.
    """
    minari = optional_module("minari", "the export of datasets", "scale")
    EpisodeBuffer = optional_module("minari.data_collector", "the export of datasets", "scale").EpisodeBuffer
    if optional_module("minari.storage", "the export of datasets", "scale").get_dataset_path(name).exists():
        raise value_error("name", name, "a new name: a dataset of this name already exists")
    simulated = _without_agent(Configuration.find(environment))
    single = gym.make(simulated.id, **simulated.given)
    tasks = [(agent, simulated, tuple(seeds[i : i + BLOCK])) for i in range(0, len(seeds), BLOCK)]
    blocks = parallel_map(_record_block, tasks, workers, prepare=compile_kernels)
    buffers = [
        EpisodeBuffer(id=number, **each) for number, each in enumerate(each for block in blocks for each in block)
    ]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # Minari warns of a missing author and a missing web page
        return minari.create_dataset_from_buffers(
            name, buffers, env=single, eval_env=single, algorithm_name=agent, data_format=form,
            description=f"{agent} on {simulated.id}, seeds {seeds[0]} to {seeds[-1]}", requirements=["flexman_gym"],
        )  # fmt: skip


def _without_agent(environment: Configuration) -> Configuration:
    """Return an environment without base controller, action repeat and action mode, of JSON-compatible settings."""
    plain = environment.to_plain()
    names = (name for name in environment.given if name not in ("base", "gains", "action_repeat", "actions"))
    return Configuration(environment.id, {name: plain[name] for name in names})


def _record_block(task: tuple[str, Configuration, tuple[int, ...]]) -> list[dict[str, Any]]:
    """Simulate a block of episodes with an agent, and again with the recorded actions in float32.

    The argument is (agent, environment, seeds). Returns the data for Minari of each episode of the second simulation.
    """
    agent, simulated, seeds = task
    names = [name for name in simulated.given if name not in OBSERVATION_SETTINGS]
    of_agent = Configuration(simulated.id, {name: simulated.given[name] for name in names})
    actions = np.nan_to_num(rollout(agent, of_agent, seeds).actions).astype(np.float32)
    venv = gym.make_vec(simulated.id, len(seeds), "vector_entry_point", autoreset_mode="Disabled", infos="at end",
                        **simulated.keywords())  # fmt: skip
    observations, _ = venv.reset(seed=list(seeds))  # type: ignore[arg-type]
    over, observed, results = np.zeros(len(seeds), dtype=bool), [observations], []
    for action in actions.swapaxes(0, 1):
        if over.any():
            venv.reset(options={"reset_mask": over})  # later data of these arms are discarded below
        observations, *rest, _ = venv.step(action)
        over = rest[1] | rest[2]
        observed.append(observations)
        results.append(rest)
    venv.close()
    return [
        *_split_episodes(seeds, np.array(observed), actions, [np.array(each) for each in zip(*results, strict=True)])
    ]


def _split_episodes(
    seeds: Sequence[int], observed: Any, actions: Any, results: Sequence[Any]
) -> Iterator[dict[str, Any]]:
    """Yield the data of each episode, from arrays (T, b, ...) of b arms, up to its end."""
    rewards, terminations, truncations = results
    for arm, seed in enumerate(seeds):
        ends = np.flatnonzero((terminations | truncations)[:, arm])
        end = int(ends[0]) + 1 if len(ends) else len(rewards)
        truncations[end - 1, arm] |= not len(ends)  # rounded to float32, actions may postpone or avoid a failure
        yield {"seed": seed, "observations": observed[: end + 1, arm], "actions": actions[arm, :end],
               "rewards": rewards[:end, arm].tolist(), "terminations": terminations[:end, arm].tolist(),
               "truncations": truncations[:end, arm].tolist()}  # fmt: skip

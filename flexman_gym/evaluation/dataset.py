"""Datasets for offline learning: episodes of an agent in Minari's format, reproducible to the bit."""

import warnings
from collections.abc import Iterator, Sequence
from typing import Any

import gymnasium as gym
import numpy as np

from flexman_gym.common.parallel import Workers, parallel_map
from flexman_gym.envs.config.configuration import Configuration
from flexman_gym.evaluation.rollout import compile_kernels, find_environment, rollout

BLOCK = 50  # episodes side by side
OBSERVATION_SETTINGS = ("sensors", "history")  # settings of an agent that the environment of a dataset keeps


def record_dataset(
    entrant: str, environment: str | Configuration, seeds: Sequence[int], name: str, form: str = "hdf5",
    workers: Workers | int = 1,
) -> Any:  # fmt: skip
    """Writes episodes of an entrant into a new dataset where Minari keeps its own; returns the MinariDataset.

    The environment of the dataset has nothing beside its agent and holds no actions: an action is all that the motors
    were asked for in a control period, by whoever acted, as float32. The single environment, which
    `recover_environment` gives, goes through the same observations and rewards under these actions, bit for bit.

    Args:
        entrant: as of `rollout`.
        environment: as of `rollout`; its sensors and history say what is observed.
        seeds: one for each episode.
        name: of the dataset, such as "flexrrr/pd-v0".
        form: "hdf5" or "arrow".
        workers: who plays, see `Workers`, or so many processes.

    Raises:
        ImportError: without Minari.
        FileNotFoundError, ValueError: one line; also where there is a dataset of that name.
    """
    try:
        import minari
        from minari.data_collector import EpisodeBuffer
    except ImportError:
        raise ImportError("datasets need Minari: pip install 'flexman_gym[scale]'") from None
    bare = dataset_environment(find_environment(environment))
    single = gym.make(bare.id, **bare.settings)
    cells = [(entrant, bare, tuple(seeds[i : i + BLOCK])) for i in range(0, len(seeds), BLOCK)]
    episodes = [
        each for block in parallel_map(record_episodes, cells, workers, prepare=compile_kernels) for each in block
    ]
    buffers = [EpisodeBuffer(id=number, **episode) for number, episode in enumerate(episodes)]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # of an author and a page, whom the user may add
        return minari.create_dataset_from_buffers(
            name, buffers, env=single, eval_env=single, algorithm_name=entrant, data_format=form,
            description=f"{entrant} on {bare.id}, seeds {seeds[0]} to {seeds[-1]}", requirements=["flexman_gym"],
        )  # fmt: skip


def dataset_environment(described: Configuration) -> Configuration:
    """Gives an environment without base, held actions and other meanings of these, as plain data without files."""
    whole = described.to_plain()
    names = (name for name in described.settings if name not in ("base", "gains", "action_repeat", "actions"))
    return Configuration(described.id, {name: whole[name] for name in names})


def record_episodes(cell: tuple[str, Configuration, tuple[int, ...]]) -> list[dict[str, Any]]:
    """Plays episodes side by side, then their actions alone; gives what Minari keeps of each."""
    entrant, bare, seeds = cell
    moved = Configuration(
        bare.id, {name: value for name, value in bare.settings.items() if name not in OBSERVATION_SETTINGS}
    )
    actions = np.nan_to_num(rollout(entrant, moved, seeds).actions).astype(np.float32)
    venv = gym.make_vec(bare.id, len(seeds), "vector_entry_point", autoreset_mode="Disabled", infos="at end",
                        **bare.keywords())  # fmt: skip
    observations, _ = venv.reset(seed=list(seeds))  # type: ignore[arg-type]
    over, seen, told = np.zeros(len(seeds), dtype=bool), [observations], []
    for action in actions.swapaxes(0, 1):
        if over.any():
            venv.reset(options={"reset_mask": over})  # which is not kept
        observations, *rest, _ = venv.step(action)
        over = rest[1] | rest[2]
        seen.append(observations)
        told.append(rest)
    venv.close()
    return [*_split_episodes(seeds, np.array(seen), actions, [np.array(each) for each in zip(*told, strict=True)])]


def _split_episodes(seeds: Sequence[int], seen: Any, actions: Any, told: Sequence[Any]) -> Iterator[dict[str, Any]]:
    """Each episode to its end."""
    rewards, terminations, truncations = told
    for arm, seed in enumerate(seeds):
        ends = np.flatnonzero((terminations | truncations)[:, arm])
        end = int(ends[0]) + 1 if len(ends) else len(rewards)
        truncations[end - 1, arm] |= not len(ends)  # a failure that float32 has put off
        yield {"seed": seed, "observations": seen[: end + 1, arm], "actions": actions[arm, :end],
               "rewards": rewards[:end, arm].tolist(), "terminations": terminations[:end, arm].tolist(),
               "truncations": truncations[:end, arm].tolist()}  # fmt: skip

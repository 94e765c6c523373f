"""Trained agents: shipped and exported policies, and training runs, read without executing code of their files."""

import os
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np

from flexman_gym.agent.network import Network
from flexman_gym.common.errors import unknown_name, value_error
from flexman_gym.common.files import naming, reading
from flexman_gym.common.run_folder import (
    NEWEST,
    NO_SETTINGS,
    SETTINGS,
    check_keys,
    has_base_as_result,
    policy_file,
    read_npz,
    read_settings,
)
from flexman_gym.envs.config.configuration import Configuration
from flexman_gym.evaluation.agent_spec import BASELINES, AgentSpec, split_interface
from flexman_gym.evaluation.policy_files import METADATA, POLICIES, policy_folder, read_policy

AGENTS = (*BASELINES, *POLICIES)  # names of all agents: baselines and shipped policies
CHANGEABLE_SETTINGS = ("steps", "eval_every")  # settings of a run that may change when it is resumed


def load_agent(name: str) -> AgentSpec:
    """Return the specification of a trained agent.

    Args:
        name: name of a shipped policy, or folder of an exported policy or of a training run.

    Raises:
        ValueError: for an unknown name, or a folder with wrong files.
        FileNotFoundError: if a file of the folder is missing.
    """
    folder = policy_folder(name)
    return _load_policy(folder) if folder else _load_run(training_folder(name))


def training_folder(name: str) -> Path:
    """Return the folder of a training run; raise an error with the names of agents if it does not exist."""
    if not os.path.isdir(name):  # unlike Path.is_dir it accepts any string
        raise unknown_name("agent", name, AGENTS, "the folder of a training run")
    return Path(name)


def _load_policy(folder: Path) -> AgentSpec:
    """Load an exported policy without executing code; check that its sensors still have the readings of the export."""
    metadata, network = read_policy(folder)
    with naming(folder / METADATA):
        environment = Configuration.from_plain(metadata["environment"])
        if observation_layout(environment) != metadata["observation"]:
            raise value_error("observation", metadata["observation"], "the names, units and sizes of its sensors here")
        base_in_use = metadata["recipe"]["settings"].get("base_in_use")
        return AgentSpec.from_network(folder.name, network, environment, base_in_use)


def observation_layout(environment: Configuration) -> list[dict[str, Any]]:
    """Return name, unit and size of each entry of the observation of an environment, in order and without history."""
    venv = gym.make_vec(environment.id, 1, "vector_entry_point", **environment.keywords())
    episodes: Any = venv.unwrapped.episodes  # type: ignore[attr-defined]
    venv.close()
    parts = [(name, episodes.sensors.units[name], part.stop - part.start)
             for name, part in episodes.sensors.slices.items()]  # fmt: skip
    parts += [(name, "1", size) for name, size in getattr(episodes.agent.mode, "observation_sizes", {}).items()]
    return [{"name": name, "unit": unit, "size": size} for name, unit, size in parts]


def _load_run(folder: Path) -> AgentSpec:
    """Load the best policy of a run, or the newest if no best policy exists, without executing code of its files."""
    settings = read_settings(folder)
    with reading(folder / SETTINGS, NO_SETTINGS):
        environment = Configuration.from_plain(settings["environment"])
        algo, activation = settings["algo"], settings["hyperparameters"].get("activation")
        base_in_use = settings.get("base_in_use")
    if has_base_as_result(folder):
        bare, interface = split_interface(environment)
        kept: dict[str, Any] = {name: interface[name] for name in ("base", "gains") if name in interface}
        kept |= {"base": base_in_use} if base_in_use else {}
        return AgentSpec(f"{folder.name}: its base", None, kept, bare)
    path = policy_file(folder)
    data = read_npz(path)
    check_settings(path, data, settings)
    done = _steps_of(data)
    if path.name == NEWEST and done < settings.get("steps", 0):
        print(
            f"{folder}: {done} of {settings['steps']} steps; flexman train --resume --folder {folder}", file=sys.stderr
        )
    with naming(path):
        network = Network(algo, activation, data.get("policy"), data.get("statistics"))
    return AgentSpec.from_network(folder.name, network, environment, base_in_use)


def _steps_of(data: Any) -> float:
    """Return the environment steps of a stored state of a training; infinite for data without them."""
    for name in ("training", "counts", "num_timesteps"):
        data = data.get(name) if isinstance(data, dict) else None
    return data if isinstance(data, int) else np.inf


def check_settings(path: Path, data: Any, settings: Mapping[str, Any]) -> None:
    """Raise ValueError if the settings of a run differ from the settings stored together with its network.

    Args:
        path: path of the file with the arrays of the network.
        data: content of this file.
        settings: current settings of the run.
    """
    stored = data.get("settings") if isinstance(data, dict) else None
    if not isinstance(stored, dict):
        raise ValueError(f"{path}: this is no file of a training run (it has no settings)")
    with naming(path):
        check_keys(stored)
    names = stored.keys() - set(CHANGEABLE_SETTINGS)
    changed = [name for name in names if not _is_equal(settings.get(name), stored.get(name))]
    if changed:
        allowed = f"the settings with which {path.name} was written: different now are {', '.join(sorted(changed))}"
        raise ValueError(f"{path.parent / SETTINGS}: this was changed; give {allowed}")


def _is_equal(setting: object, stored: object) -> bool:
    """Return True if a setting equals the stored value; False for stored data without a truth value, such as arrays."""
    try:
        return bool(setting == stored)
    except ValueError:
        return False

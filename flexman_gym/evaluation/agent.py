"""Agents to be evaluated: baselines by name, shipped policies, runs from disk, controllers and predictors."""

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from inspect import signature
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
from numpy.typing import NDArray

from flexman_gym.common.arrays import Array, BoolArray, IntArray
from flexman_gym.common.checks import short_path, value_error
from flexman_gym.common.files import existing_file
from flexman_gym.common.renamed import RUN_SETTINGS, rename_keys
from flexman_gym.common.run_folder import BEST, NEWEST, SETTINGS, read_npz, read_settings
from flexman_gym.control.agent import Law
from flexman_gym.control.base_controllers import BASES, parse_base
from flexman_gym.control.controller import Controller, EpisodeInfo, Readings
from flexman_gym.control.network import Network
from flexman_gym.envs.config.configuration import Configuration, current_name
from flexman_gym.envs.config.fidelity import resolve_fidelity
from flexman_gym.envs.config.specification import make_base_and_mode
from flexman_gym.evaluation.policy_files import ABOUT, POLICIES, policy_folder, read_policy

INTERFACE = ("base", "action_repeat", "sensors", "history", "actions")  # settings of what acts, not of what is moved
LAWLESS_AGENTS = {
    "zero": "no torque at all",
    "random": "random torques",
}  # agents without a controller: name -> description
BASELINES = (*BASES, *LAWLESS_AGENTS)
"""Agents that need no training, by name."""
AGENTS = (*BASELINES, *POLICIES)  # all that have a name


@dataclass(frozen=True)
class AgentSpec:
    """Specification of an agent: name, law, and the settings with which an environment makes its `control.Agent`.

    Attributes:
        name: as in a table.
        law: commands (b, k) for observations (b, size); None for zeros, so that the base controller acts alone.
        interface: base, its gains, action_repeat, sensors, history and actions; None for those of the environment in
            which it acts.
        environment: the environment that it was trained on; None for a baseline, which suits any.
    """

    name: str
    law: Law | None = None
    interface: dict[str, Any] | None = field(default_factory=dict)
    environment: Configuration | None = None


def find_agent(entrant: object) -> AgentSpec:
    """Gives the entrant that a name, a mapping as `base` takes it, a folder, a Controller or a predictor means.

    A name is one of BASELINES and POLICIES. A folder holds a training run or an exported policy. A predictor is an
    object with `predict`, as Stable-Baselines3 has them, see `predictor_agent`.

    Raises:
        FileNotFoundError, ValueError: one line with what is wrong and what is allowed.
    """
    if isinstance(entrant, AgentSpec):
        return entrant
    if isinstance(entrant, Controller) and not isinstance(entrant, type):
        return AgentSpec(type(entrant).__name__, None, {"base": entrant})
    if isinstance(entrant, dict):
        return AgentSpec(parse_base(entrant)[0], None, {"base": entrant})
    if hasattr(entrant, "predict") and not isinstance(entrant, type):
        return predictor_agent(entrant)
    name = str(entrant)
    if folder := policy_folder(name):
        return load_policy(folder)
    if name in BASES:
        return AgentSpec(name, None, {"base": name})
    if name == "zero":
        return AgentSpec(name)
    if name == "random":
        return AgentSpec(name, None, {"base": _RandomTorques()})
    if name.endswith(".zip"):
        raise _untrusted_file_error(name)
    if not os.path.isdir(name):  # whatever the name is
        allowed = f"the folder of a training run, or one of {', '.join(AGENTS)}"
        raise FileNotFoundError(f"entrant: {short_path(name)} is not allowed; give {allowed}")
    return load_run(Path(name))


def load_policy(folder: Path) -> AgentSpec:
    """Loads a policy that was exported; nothing in its files is run.

    Raises:
        FileNotFoundError, ValueError: one line, see `read_policy`, also where its sensors read something else now.
    """
    about, network = read_policy(folder)
    try:
        described = Configuration.from_plain(about["environment"])
        if observation_layout(described) != about["observation"]:
            raise value_error(
                "observation", about["observation"], "the names, units and sizes that its sensors read here"
            )
        return network_agent(folder.name, network, described, about["recipe"]["settings"].get("base_in_use"))
    except ValueError as error:
        raise ValueError(f"{short_path(folder / ABOUT)}: {error}") from None


def observation_layout(described: Configuration) -> list[dict[str, Any]]:
    """Gives what the agent of an environment observes, in order: name, unit and how many numbers, without history."""
    venv = gym.make_vec(described.id, 1, "vector_entry_point", **described.keywords())
    episodes: Any = venv.unwrapped.episodes  # type: ignore[attr-defined]
    venv.close()
    seen = [(name, episodes.sensors.units[name], part.stop - part.start)
            for name, part in episodes.sensors.slices.items()]  # fmt: skip
    seen += [(name, "1", size) for name, size in getattr(episodes.agent.mode, "observation_sizes", {}).items()]
    return [{"name": name, "unit": unit, "size": size} for name, unit, size in seen]


def predictor_agent(model: Any, described: Configuration | None = None) -> AgentSpec:
    """Gives the entrant of an object with `predict`, which gives actions (b, n) for observations (b, size).

    A model of Stable-Baselines3 brings the environment that it learned in, and the statistics of a `VecNormalize`
    there. Anything else sees what the environment shows in which it is to act.

    Args:
        model: the object; `predict` may also give a pair with the actions first.
        described: the environment that it learned in, where the model does not bring it.
    """
    beside = getattr(model, "get_vec_normalize_env", lambda: None)()
    arms = getattr(model, "get_env", lambda: None)()
    if described is None and arms is not None:
        described = arms.get_attr("configuration")[0]
    environment, interface = (None, None) if described is None else split_interface(described)

    told = {"deterministic": True}
    try:
        signature(model.predict).bind(None, **told)
    except TypeError:
        told = {}  # which an object of one's own need not know

    def law(observations: NDArray[np.float32]) -> NDArray[np.floating]:
        seen = observations if beside is None else beside.normalize_obs(observations)
        said = model.predict(seen, **told)
        actions = np.asarray(said[0] if isinstance(said, tuple) else said, dtype=np.float32)
        return np.clip(actions, -1, 1).reshape(len(observations), -1)

    return AgentSpec(type(model).__name__, law, interface, environment)


def load_run(folder: Path) -> AgentSpec:
    """Loads the policy of a run: its best one where there is one, else its newest; nothing in its files is run.

    Raises:
        FileNotFoundError, ValueError: one clear line.
    """
    if is_sb3_folder(folder):
        raise _untrusted_file_error(folder)
    settings = read_settings(folder)
    try:
        described = Configuration.from_plain(settings["environment"])
        algo, activation = settings["algo"], settings["hyperparameters"].get("activation")
        in_use = settings.get("base_in_use")
    except (KeyError, TypeError, AttributeError, ValueError, RecursionError) as error:
        said = str(error).splitlines()[0] if str(error) else type(error).__name__
        raise ValueError(f"{short_path(folder / SETTINGS)}: {said}; give the settings of a training run") from None
    path = folder / BEST if (folder / BEST).is_file() else existing_file(folder / NEWEST)
    data = read_npz(path)
    check_settings(path, data, settings)
    try:
        network = Network(algo, activation, data.get("policy"), data.get("statistics"))
    except ValueError as error:
        raise ValueError(f"{short_path(path)}: {error}") from None
    return network_agent(folder.name, network, described, in_use)


def _untrusted_file_error(place: object) -> ValueError:
    allowed = "--trust, if you trust whoever made them: they are pickles, which run any code when they are read"
    return ValueError(f"entrant: the files of Stable-Baselines3 in {place} are not read; give {allowed}")


def network_agent(name: str, network: Law, described: Configuration, in_use: object = None) -> AgentSpec:
    """Return the specification of a network with the environment of its training.

    Its base controller and action mode are those of that environment wherever it acts; a base in use is made for the
    environment in which it acts.
    """
    environment, interface = split_interface(described)
    agent = AgentSpec(name, network, interface, environment)
    if in_use is None:
        return design_for(agent, described)
    parse_base(in_use)
    interface.pop("gains", None)
    return replace(agent, interface={**interface, "base": in_use})


def split_interface(described: Configuration) -> tuple[Configuration, dict[str, Any]]:
    """Parts a description into what is moved and the settings of what acts on it.

    The gains of a PD are in both: those with which a policy learned are its own, and the environment has a PD too.
    """
    interface = {name: value for name, value in described.settings.items() if name in INTERFACE}
    if described.base == "pd":
        interface["gains"] = described.to_plain(strict=False)["gains"]
    return described.without(INTERFACE), interface


def design_for(agent: AgentSpec, environment: Configuration) -> AgentSpec:
    """Return an agent whose base controller and action mode are made for an environment, whatever the one it acts in.

    Without this, a controller that is given by its name is made for the environment in which it acts, with the delay,
    noise, friction and ranges there. A controller or mode that is made already stays as it is.
    """
    if agent.interface is None:
        return agent
    whole = environment.replace(**agent.interface)
    base, mode = make_base_and_mode(whole, resolve_fidelity(whole).model)
    others = {name: value for name, value in agent.interface.items() if name != "gains"}
    return replace(agent, interface={**others, "base": base, "actions": mode})


def common_environment(entrants: Sequence[AgentSpec], named: Configuration | None) -> Configuration:
    """Gives the environment on which all entrants are evaluated: the named one, or that of the trained ones.

    Its PD, which is a baseline, has the gains of the first of them that has any.

    Raises:
        ValueError: for policies that were trained on different ones, when none is named.
    """
    if named is not None:
        return split_interface(named)[0]
    trained = [(each.name, each.environment, each.environment.to_plain()) for each in entrants if each.environment]
    for name, _, whole in trained:
        if {**whole, "gains": None} != {**trained[0][2], "gains": None}:
            allowed = f"policies of one environment, or name one with --env: {trained[0][0]} knows another"
            raise value_error("entrant", name, allowed)
    with_gains = [environment for _, environment, whole in trained if whole.get("gains")]
    return next(iter([*with_gains, *(environment for _, environment, _ in trained)]), Configuration())


def change_environment(environment: Configuration, changes: Sequence[str]) -> Configuration:
    """Gives an environment with settings of "name=value" changed.

    Raises:
        ValueError: for those that belong to what acts, and what `Configuration.changed` refuses.
    """
    for change in changes:
        if current_name(change.split("=")[0].split(".")[0], warn=False) in INTERFACE:
            allowed = f"a setting of what is moved: {', '.join(INTERFACE)} are those that a policy was trained with"
            raise value_error("--set", change, allowed)
    return split_interface(environment.changed(changes))[0]


class _RandomTorques:
    """Controller with independent uniform torques."""

    sensors = ()

    def __init__(self) -> None:
        self._random = np.random.default_rng(0)

    def reset(self, arms: IntArray, episode: EpisodeInfo, count: int) -> None:
        """Start new episodes."""

    def act(self, readings: Readings, applied: Array, active: BoolArray) -> Array:
        """Return torques (b, n), parts of the limits."""
        return self._random.uniform(-1.0, 1.0, applied.shape).astype(np.float32).astype(np.float64)


SB3_MODEL = "model.zip"  # of Stable-Baselines3
CHANGEABLE_SETTINGS = ("steps", "eval_every")  # settings that a resumed run may change


def is_sb3_folder(folder: Path) -> bool:
    """Return whether a folder holds a policy in files of Stable-Baselines3 and no run of this library."""
    return (folder / SB3_MODEL).is_file() and not any((folder / name).is_file() for name in (BEST, NEWEST))


def check_settings(path: Path, data: Any, settings: Mapping[str, Any]) -> None:
    """Raise ValueError when the settings of a run were changed after its file of arrays was written.

    Args:
        path: of the file of arrays.
        data: content of that file.
        settings: of the run now.
    """
    kept = data.get("settings") if isinstance(data, dict) else None
    if not isinstance(kept, dict):
        raise ValueError(f"{path}: this is not what a training run has written (it has no settings)")
    kept = rename_keys(kept, RUN_SETTINGS, warn=False)
    names = kept.keys() - set(CHANGEABLE_SETTINGS)
    changed = [name for name in names if not _is_equal(settings.get(name), kept.get(name))]
    if changed:
        allowed = f"the settings with which {path.name} was written: {', '.join(sorted(changed))} is another now"
        raise ValueError(f"{path.parent / SETTINGS}: this was changed; give {allowed}")


def _is_equal(setting: object, kept: object) -> bool:
    """Return whether a setting equals the kept one, which is an array in a forged file."""
    try:
        return bool(setting == kept)
    except ValueError:
        return False

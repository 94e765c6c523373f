"""Agents of an evaluation: baselines by name, shipped policies, runs from disk, controllers and predictors."""

import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from inspect import signature
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
from numpy.typing import NDArray

from flexman_gym.common.checks import short_path, value_error
from flexman_gym.common.run_folder import (
    BEST,
    NEWEST,
    SETTINGS,
    check_settings,
    existing_file,
    is_sb3_folder,
    read_data,
    read_settings,
)
from flexman_gym.control.actions import make_action_mode
from flexman_gym.control.base_controllers import BASES, checked_base
from flexman_gym.control.controller import Controller
from flexman_gym.control.network import Network
from flexman_gym.control.policy import Policy, PolicyFactory
from flexman_gym.envs.config.description import Description
from flexman_gym.envs.config.description import described as described_setup
from flexman_gym.envs.config.setup import build, setup_of
from flexman_gym.envs.config.specification import make_plant
from flexman_gym.evaluation.policy_files import ABOUT, POLICIES, policy_folder, read_policy

ActionFunction = Callable[[NDArray[np.float32], tuple[int, ...]], NDArray[np.floating]]
INTERFACE = ("base", "hold", "sensors", "history", "actions")  # settings of what acts, not of what is moved
IDLE = {"zero": "no torque at all", "random": "random torques"}  # agents without a controller: name -> description
BASELINES = (*BASES, *IDLE)
"""Agents that need no training, by name."""
AGENTS = (*BASELINES, *POLICIES)  # all that have a name


@dataclass(frozen=True)
class Agent:
    """A name, how it acts, and the settings that it wants of an environment.

    Attributes:
        name: as in a table.
        act: actions for observations (b, size) and the shape (b, n) that they have.
        interface: base, its gains, hold, sensors and history; None for those of the environment in which it acts.
        environment: the environment that it was trained on; None for a baseline, which suits any.
    """

    name: str
    act: ActionFunction
    interface: dict[str, Any] | None = field(default_factory=dict)
    environment: Description | None = None


def find_agent(entrant: object) -> Agent:
    """Gives the entrant that a name, a mapping as `base` takes it, a folder, a Controller or a predictor means.

    A name is one of BASELINES and POLICIES. A folder holds a training run or an exported policy. A predictor is an
    object with `predict`, as Stable-Baselines3 has them, see `predictor_agent`.

    Raises:
        FileNotFoundError, ValueError: one line with what is wrong and what is allowed.
    """
    if isinstance(entrant, Agent):
        return entrant
    if isinstance(entrant, Controller) and not isinstance(entrant, type):
        return Agent(type(entrant).__name__, zero_action, {"base": entrant})
    if isinstance(entrant, dict):
        return Agent(checked_base(entrant)[0], zero_action, {"base": entrant})
    if hasattr(entrant, "predict") and not isinstance(entrant, type):
        return predictor_agent(entrant)
    name = str(entrant)
    if folder := policy_folder(name):
        return load_policy(folder)
    if name in BASES:
        return Agent(name, zero_action, {"base": name})
    if name == "zero":
        return Agent(name, zero_action)
    if name == "random":
        random = np.random.default_rng(0)
        return Agent(name, lambda observations, shape: random.uniform(-1.0, 1.0, shape))
    if name.endswith(".zip"):
        raise _untrusted(name)
    if not os.path.isdir(name):  # whatever the name is
        allowed = f"the folder of a training run, or one of {', '.join(AGENTS)}"
        raise FileNotFoundError(f"entrant: {short_path(name)} is not allowed; give {allowed}")
    return load_run(Path(name))


def load_policy(folder: Path) -> Agent:
    """Loads a policy that was exported; nothing in its files is run.

    Raises:
        FileNotFoundError, ValueError: one line, see `read_policy`, also where its sensors read something else now.
    """
    about, network = read_policy(folder)
    try:
        described = Description.from_dict(about["environment"])
        if observation_layout(described) != about["observation"]:
            raise value_error(
                "observation", about["observation"], "the names, units and sizes that its sensors read here"
            )
        policy = make_policy(network, described, about["recipe"]["settings"].get("base_in_use"))
    except ValueError as error:
        raise ValueError(f"{short_path(folder / ABOUT)}: {error}") from None
    return Agent(folder.name, zero_action, {"base": policy}, split_interface(described)[0])


def observation_layout(described: Description) -> list[dict[str, Any]]:
    """Gives what the agent of an environment observes, in order: name, unit and how many numbers, without history."""
    venv = gym.make_vec(described.id, 1, "vector_entry_point", **described.keywords())
    episodes: Any = venv.unwrapped.episodes  # type: ignore[attr-defined]
    venv.close()
    seen = [(name, episodes.sensors.units[name], part.stop - part.start)
            for name, part in episodes.sensors.slices.items()]  # fmt: skip
    seen += [(name, "1", size) for name, size in getattr(episodes.acting.mode, "shown", {}).items()]
    return [{"name": name, "unit": unit, "size": size} for name, unit, size in seen]


def predictor_agent(model: Any, described: Description | None = None) -> Agent:
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
        described = Description.from_dict(described_setup(arms.get_attr("setup")[0]))
    environment, interface = (None, None) if described is None else split_interface(described)

    told = {"deterministic": True}
    try:
        signature(model.predict).bind(None, **told)
    except TypeError:
        told = {}  # which an object of one's own need not know

    def act(observations: NDArray[np.float32], shape: tuple[int, ...]) -> NDArray[np.floating]:
        seen = observations if beside is None else beside.normalize_obs(observations)
        said = model.predict(seen, **told)
        return np.clip(np.asarray(said[0] if isinstance(said, tuple) else said, dtype=np.float32), -1, 1).reshape(shape)

    return Agent(type(model).__name__, act, interface, environment)


def load_run(folder: Path) -> Agent:
    """Loads the policy of a run: its best one where there is one, else its newest; nothing in its files is run.

    Raises:
        FileNotFoundError, ValueError: one clear line.
    """
    if is_sb3_folder(folder):
        raise _untrusted(folder)
    settings = read_settings(folder)
    try:
        described = Description.from_dict(settings["environment"])
        algo, activation = settings["algo"], settings["hyperparameters"].get("activation")
        in_use = settings.get("base_in_use")
    except (KeyError, TypeError, AttributeError, ValueError, RecursionError) as error:
        said = str(error).splitlines()[0] if str(error) else type(error).__name__
        raise ValueError(f"{short_path(folder / SETTINGS)}: {said}; give the settings of a training run") from None
    path = folder / BEST if (folder / BEST).is_file() else existing_file(folder / NEWEST)
    data = read_data(path)
    check_settings(path, data, settings)
    try:
        network = Network(algo, activation, data.get("policy"), data.get("statistics"))
    except ValueError as error:
        raise ValueError(f"{short_path(path)}: {error}") from None
    return Agent(
        folder.name, zero_action, {"base": make_policy(network, described, in_use)}, split_interface(described)[0]
    )


def _untrusted(place: object) -> ValueError:
    allowed = "--trust, if you trust whoever made them: they are pickles, which run any code when they are read"
    return ValueError(f"entrant: the files of Stable-Baselines3 in {place} are not read; give {allowed}")


def make_policy(network: Network, described: Description, in_use: object = None) -> Policy | PolicyFactory:
    """Gives what a network is with all that it learned with, or with a base in use made where it acts."""
    setup = described.setup()
    own = network, (*setup.sensors, *setup.task.sensors), setup.history, setup.hold
    if in_use is not None:
        checked_base(in_use)
        return PolicyFactory(*own, base=in_use, actions=setup.actions)
    model = build(setup).model
    base = setup.controller(setup.base, model) if isinstance(setup.base, str | dict) else setup.base
    return Policy(*own, base, make_action_mode(setup.actions, make_plant(setup, model), base))  # type: ignore[arg-type]


def split_interface(described: Description) -> tuple[Description, dict[str, Any]]:
    """Parts a description into what is moved and the settings of what acts on it.

    The gains of a PD are in both: those with which a policy learned are its own, and the environment has a PD too.
    """
    moved = described.whole_settings()
    interface = {name: moved.pop(name) for name in INTERFACE if name in moved}
    if interface.get("base") == "pd":
        interface["gains"] = described.whole()["gains"]
    return Description(described.id, moved, described.folder), interface


def design_for(entrant: Agent, environment: Description) -> Agent:
    """Return an entrant whose controller is built for an environment, whatever the one in which it acts.

    Without this, a controller that is given by its name is built for the environment in which it acts: it is told its
    delay, noise, friction and ranges. An entrant without a controller stays as it is.
    """
    if entrant.interface is None or "base" not in entrant.interface:
        return entrant
    setup = setup_of({"name": environment.id, **environment.keywords(), **entrant.interface})
    base = setup.base_controller(build(setup).model)
    return replace(entrant, interface={**entrant.interface, "base": base})


def common_environment(entrants: Sequence[Agent], named: Description | None) -> Description:
    """Gives the environment on which all entrants are evaluated: the named one, or that of the trained ones.

    Its PD, which is a baseline, has the gains of the first of them that has any.

    Raises:
        ValueError: for policies that were trained on different ones, when none is named.
    """
    if named is not None:
        return split_interface(named)[0]
    trained = [(each.name, each.environment, each.environment.whole()) for each in entrants if each.environment]
    for name, _, whole in trained:
        if {**whole, "gains": None} != {**trained[0][2], "gains": None}:
            allowed = f"policies of one environment, or name one with --env: {trained[0][0]} knows another"
            raise value_error("entrant", name, allowed)
    with_gains = [environment for _, environment, whole in trained if whole.get("gains")]
    return next(iter([*with_gains, *(environment for _, environment, _ in trained)]), Description())


def change_environment(environment: Description, changes: Sequence[str]) -> Description:
    """Gives an environment with settings of "name=value" changed.

    Raises:
        ValueError: for those that belong to what acts, and what `Description.changed` refuses.
    """
    for change in changes:
        if change.split("=")[0].split(".")[0] in INTERFACE:
            allowed = f"a setting of what is moved: {', '.join(INTERFACE)} are those that a policy was trained with"
            raise value_error("--set", change, allowed)
    return split_interface(environment.changed(changes))[0]


def zero_action(observations: NDArray[np.float32], shape: tuple[int, ...]) -> NDArray[np.floating]:
    """Gives no torque beside a base."""
    return np.zeros(shape)

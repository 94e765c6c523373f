"""Entrants: who acts in an evaluation, by name, as the folder of a training run, or as a controller."""

import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from flexman_gym.checks import refusal
from flexman_gym.control.bases import BASES, checked_base
from flexman_gym.control.controller import Controller
from flexman_gym.control.network import Network
from flexman_gym.control.policy import Policy
from flexman_gym.envs.description import Description
from flexman_gym.envs.setup import build
from flexman_gym.evaluation.folder import BEST, NEWEST, SETTINGS, check_settings, existing, is_foreign, read_data

Act = Callable[[NDArray[np.float32], tuple[int, ...]], NDArray[np.floating]]
INTERFACE = ("base", "hold", "sensors", "history")  # settings of what acts, not of what is moved
BASELINES = (*BASES, "zero", "random")


@dataclass(frozen=True)
class Entrant:
    """A name, how it acts, and the settings that it wants of an environment.

    Attributes:
        name: as in a table.
        act: actions for observations (b, size) and the shape (b, n) that they have.
        interface: base, its gains, hold, sensors and history.
        environment: the environment that it was trained on; None for a baseline, which suits any.
    """

    name: str
    act: Act
    interface: dict[str, Any] = field(default_factory=dict)
    environment: Description | None = None


def find_entrant(entrant: object) -> Entrant:
    """Gives the entrant that a name, a mapping as `base` takes it, the folder of a training run, or a Controller means.

    Raises:
        FileNotFoundError, ValueError: one line with what is wrong and what is allowed.
    """
    if isinstance(entrant, Entrant):
        return entrant
    if isinstance(entrant, Controller) and not isinstance(entrant, type):
        return Entrant(type(entrant).__name__, still, {"base": entrant})
    if isinstance(entrant, dict):
        return Entrant(checked_base(entrant)[0], still, {"base": entrant})
    name = str(entrant)
    if name in BASES:
        return Entrant(name, still, {"base": name})
    if name == "zero":
        return Entrant(name, still)
    if name == "random":
        random = np.random.default_rng(0)
        return Entrant(name, lambda observations, shape: random.uniform(-1.0, 1.0, shape))
    folder = Path(name)
    if not folder.is_dir():
        allowed = f"the folder of a training run, or one of {', '.join(BASELINES)}"
        raise FileNotFoundError(f"entrant: {name} is not allowed; give {allowed}")
    return load_run(folder)


def load_run(folder: Path) -> Entrant:
    """Loads the policy of a run: its best one where there is one, else its newest; nothing in its files is run.

    Raises:
        FileNotFoundError, ValueError: one clear line.
    """
    if is_foreign(folder):
        allowed = "--trust, if you trust whoever made them: they are pickles, which run any code when they are read"
        raise ValueError(f"entrant: the files of Stable-Baselines3 in {folder} are not read; give {allowed}")
    text = existing(folder / SETTINGS).read_bytes().decode("utf-8", errors="replace")
    try:
        settings = json.loads(text)
        described = Description.from_dict(settings["environment"])
        algo, activation = settings["algo"], settings["hyperparameters"].get("activation")
    except (KeyError, TypeError, AttributeError, ValueError, RecursionError) as error:
        said = str(error).splitlines()[0] if str(error) else type(error).__name__
        raise ValueError(f"{folder / SETTINGS}: {said}; give the settings of a training run") from None
    path = folder / BEST if (folder / BEST).is_file() else existing(folder / NEWEST)
    data = read_data(path)
    check_settings(path, data, settings)
    try:
        network = Network(algo, activation, data.get("policy"), data.get("statistics"))
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from None
    return Entrant(folder.name, still, {"base": _policy(network, described)}, parted(described)[0])


def _policy(network: Network, described: Description) -> Policy:
    """The policy that a network is with all that it learned with."""
    setup = described.setup()
    base = setup.controller(setup.base, build(setup).model) if isinstance(setup.base, str | dict) else setup.base
    sensors = (*setup.sensors, *setup.task.sensors)
    return Policy(network, sensors, setup.history, setup.hold, base)  # type: ignore[arg-type]


def parted(described: Description) -> tuple[Description, dict[str, Any]]:
    """Parts a description into what is moved and the settings of what acts on it.

    The gains of a PD are in both: those with which a policy learned are its own, and the environment has a PD too.
    """
    moved = described.whole_settings()
    interface = {name: moved.pop(name) for name in INTERFACE if name in moved}
    if interface.get("base") == "pd":
        interface["gains"] = described.whole()["gains"]
    return Description(described.id, moved, described.folder), interface


def common_environment(entrants: Sequence[Entrant], named: Description | None) -> Description:
    """Gives the environment on which all entrants are evaluated: the named one, or that of the trained ones.

    Its PD, which is a baseline, has the gains of the first of them that has any.

    Raises:
        ValueError: for policies that were trained on different ones, when none is named.
    """
    if named is not None:
        return parted(named)[0]
    trained = [(each.name, each.environment, each.environment.whole()) for each in entrants if each.environment]
    for name, _, whole in trained:
        if {**whole, "gains": None} != {**trained[0][2], "gains": None}:
            allowed = f"policies of one environment, or name one with --env: {trained[0][0]} knows another"
            raise refusal("entrant", name, allowed)
    with_gains = [environment for _, environment, whole in trained if whole.get("gains")]
    return next(iter([*with_gains, *(environment for _, environment, _ in trained)]), Description())


def changed_environment(environment: Description, changes: Sequence[str]) -> Description:
    """Gives an environment with settings of "name=value" changed.

    Raises:
        ValueError: for those that belong to what acts, and what `Description.changed` refuses.
    """
    for change in changes:
        if change.split("=")[0].split(".")[0] in INTERFACE:
            allowed = f"a setting of what is moved: {', '.join(INTERFACE)} are those that a policy was trained with"
            raise refusal("--set", change, allowed)
    return parted(environment.changed(changes))[0]


def still(observations: NDArray[np.float32], shape: tuple[int, ...]) -> NDArray[np.floating]:
    """Gives no torque beside a base."""
    return np.zeros(shape)

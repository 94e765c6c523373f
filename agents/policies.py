"""Policies: what acts in an evaluation, a trained run or a baseline, each with the environment that it belongs to."""

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from flexman_gym.envs.description import Description
from flexman_gym.envs.setup import BASES

Act = Callable[[NDArray[np.float32], tuple[int, ...]], NDArray[np.floating]]
INTERFACE = ("base", "hold", "sensors", "history")  # settings of what acts, not of what is moved
BASELINES = (*BASES, "zero", "random")


@dataclass(frozen=True)
class Policy:
    """A name, how it acts, and the settings that it wants of an environment.

    Attributes:
        name: as in a table.
        act: actions for observations (b, size) and the shape (b, n) that they have.
        interface: base, hold, sensors and history.
        environment: the environment that it was trained on; None for a baseline, which suits any.
    """

    name: str
    act: Act
    interface: dict[str, Any] = field(default_factory=dict)
    environment: Description | None = None


def parted(described: Description) -> tuple[Description, dict[str, Any]]:
    """Parts a description into what is moved and the settings of what acts on it.

    The gains of a PD are in both: those with which a policy learned are its own, and the environment has a PD too.
    """
    moved = dict(described.settings or {})
    interface = {name: moved.pop(name) for name in INTERFACE if name in moved}
    if interface.get("base") == "pd":
        interface["gains"] = described.whole()["gains"]
    return Description(described.id, moved, described.folder), interface


def find_policy(name: str, trust: bool = False) -> Policy:
    """Finds the policy of a name: a baseline, or the folder of a training run.

    Args:
        name: of a baseline or a folder.
        trust: read files of Stable-Baselines3 too, which can run any code; see `foreign`.

    Raises:
        FileNotFoundError, ValueError: one line with what is wrong and what is allowed.
    """
    if name in BASES:
        return Policy(name, _still, {"base": name})
    if name == "zero":
        return Policy(name, _still)
    if name == "random":
        random = np.random.default_rng(0)
        return Policy(name, lambda observations, shape: random.uniform(-1.0, 1.0, shape))
    folder = Path(name)
    if not folder.is_dir():
        allowed = f"the folder of a training run, or one of {', '.join(BASELINES)}"
        raise FileNotFoundError(f"policy: {name} is not allowed; give {allowed}")
    settings, act = _trained(folder, trust)
    environment, interface = parted(settings.description)
    return Policy(folder.name, act, interface, environment)


def _trained(folder: Path, trust: bool) -> tuple[Any, Act]:
    """Settings and policy of a run. Both rooms below need Stable-Baselines3, which baselines do without."""
    from flexman_agents.folder import BEST, NEWEST
    from flexman_agents.foreign import MODEL, load_foreign
    from flexman_agents.training import load_policy

    if any((folder / name).is_file() for name in (BEST, NEWEST)) or not (folder / MODEL).is_file():
        return load_policy(folder)
    if not trust:
        allowed = "--trust, if you trust whoever made them: they are pickles, which run any code when they are read"
        raise ValueError(f"policy: the files of Stable-Baselines3 in {folder} are not read; give {allowed}")
    return load_foreign(folder)


def _still(observations: NDArray[np.float32], shape: tuple[int, ...]) -> NDArray[np.floating]:
    return np.zeros(shape)

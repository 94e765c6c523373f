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
INTERFACE = ("base", "hold", "sensors")  # settings of what acts, not of what is moved
BASELINES = (*BASES, "zero", "random")


@dataclass(frozen=True)
class Policy:
    """A name, how it acts, and the settings that it wants of an environment.

    Attributes:
        name: as in a table.
        act: actions for observations (b, size) and the shape (b, n) that they have.
        interface: base, hold and sensors.
        environment: the environment that it was trained on; None for a baseline, which suits any.
    """

    name: str
    act: Act
    interface: dict[str, Any] = field(default_factory=dict)
    environment: Description | None = None


def parted(described: Description) -> tuple[Description, dict[str, Any]]:
    """Parts a description into what is moved and the settings of what acts on it."""
    moved = dict(described.settings or {})
    interface = {name: moved.pop(name) for name in INTERFACE if name in moved}
    return Description(described.id, moved, described.folder), interface


def find_policy(name: str) -> Policy:
    """Finds the policy of a name: a baseline, or the folder of a training run.

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
    from flexman_agents.training import load_policy  # which needs Stable-Baselines3

    settings, act = load_policy(folder)
    environment, interface = parted(settings.description)
    return Policy(folder.name, act, interface, environment)


def _still(observations: NDArray[np.float32], shape: tuple[int, ...]) -> NDArray[np.floating]:
    return np.zeros(shape)

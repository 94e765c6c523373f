"""Shipping: the policy of a training run as a folder that NumPy alone runs, with what it must do and reaches."""

import re
import subprocess
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from flexman_gym.arrays import Array
from flexman_gym.checks import refusal
from flexman_gym.control.network import Network, layers_of
from flexman_gym.envs.description import Description
from flexman_gym.evaluation.entrants import Entrant, acting, load_shipped, observed, parted, still
from flexman_gym.evaluation.figures import evaluate
from flexman_gym.evaluation.folder import BEST, NEWEST, check_settings, existing, read_data, read_settings
from flexman_gym.evaluation.rollout import rollout
from flexman_gym.evaluation.seeds import SELECTION, TEST
from flexman_gym.evaluation.shipped import COUNT, FOLDER, write_shipped
from flexman_gym.evaluation.submission import training_seconds

LICENCE = "MIT"
SEEN_IN = SELECTION[:16]  # episodes from which the observations are that are kept


def ship(run: Path, folder: Path, words: str, recipe: str, venue: str = "", licence: str = LICENCE) -> dict[str, float]:
    """Exports the best policy of a run; gives the figures that it reaches in the test episodes.

    Args:
        run: the folder of the run.
        folder: a new one.
        words: one sentence that says what it is.
        recipe: name or file of the settings with which it was trained.
        venue: an id, an id and a condition, or a file of the environment for which it is, "" for that of the training;
            what acts, such as sensors and base, stays that of the training.
        licence: of the policy.

    Raises:
        FileNotFoundError, ValueError: one line with what is wrong and what is allowed.
    """
    if folder.exists():
        raise refusal("folder", str(folder), "a new one")
    settings = read_settings(run)
    path = run / BEST if (run / BEST).is_file() else existing(run / NEWEST)
    data = read_data(path)
    check_settings(path, data, settings)
    described = _for(Description.from_dict(settings["environment"]), venue)
    layers = layers_of(settings["algo"], data["policy"])
    arrays = layers | {f"statistics.{name}": np.asarray(data["statistics"][name]) for name in ("mean", "var")}
    network = Network(settings["algo"], settings["hyperparameters"].get("activation"), layers, data["statistics"])
    seen = _seen(network, described, settings.get("base_in_use"))
    about = {
        "words": words,
        "licence": licence,
        "commit": _commit(),
        "versions": settings["versions"],
        "recipe": {"name": recipe, "settings": {name: each for name, each in settings.items() if name != "versions"}},
        "training_seconds": training_seconds(str(run)) or 0.0,
        "environment": described.whole(),
        "observation": observed(described),
        "league": {},
    }
    arrays |= {"check.observations": seen, "check.actions": network(seen)}
    write_shipped(folder, about, arrays)
    policy = load_shipped(folder)
    assert policy.environment is not None
    figures = evaluate(policy, policy.environment, TEST)
    row = {name: value if np.isfinite(value) else None for name, value in figures.items()}
    about["league"] = {"environment": venue or described.id, "seeds": [TEST.start, TEST.stop], **row}
    write_shipped(folder, about, arrays)
    return figures


def bundled(name: str) -> Path:
    """Gives the folder in the package for a policy of that name.

    Raises:
        ValueError: for a name that is no part of a path.
    """
    if not re.fullmatch(r"[A-Za-z0-9-]{0,59}[A-Za-z0-9]", name):
        raise refusal("name", name, "1 to 60 letters a to z, digits and hyphens, with no hyphen at the end")
    return FOLDER / name


def _for(trained: Description, venue: str) -> Description:
    """The environment for which a policy is, with what acts as it was trained."""
    if not venue:
        return trained
    return Description.from_dict({**parted(Description.find(venue))[0].whole(), **parted(trained)[1]})


class _Watching:
    """A network, and every observation for which it was asked."""

    def __init__(self, network: Network) -> None:
        self.network, self.size, self.joints = network, network.size, network.joints
        self.seen: list[NDArray[np.float32]] = []

    def __deepcopy__(self, memo: object) -> "_Watching":
        return self  # which a rollout makes of what may act elsewhere

    def __call__(self, observations: NDArray[np.float32]) -> Array:
        self.seen.append(observations.copy())
        return self.network(observations)


def _seen(network: Network, described: Description, in_use: object) -> NDArray[np.float32]:
    """Observations (COUNT, size) of episodes that the policy plays, evenly from their first to their last."""
    watching = _Watching(network)
    policy = acting(watching, described, in_use)  # type: ignore[arg-type]
    environment = parted(described)[0]
    rollout(Entrant("", still, {"base": policy}), environment, SEEN_IN)
    rows = np.concatenate(watching.seen)
    result: NDArray[np.float32] = rows[np.linspace(0, len(rows) - 1, COUNT).astype(int)]
    return result


def _commit() -> str:
    """The commit of the checkout that this is a part of, "" where it is none."""
    done = subprocess.run(["git", "rev-parse", "HEAD"], cwd=Path(__file__).parent, capture_output=True, text=True)
    return done.stdout.strip() if done.returncode == 0 else ""

"""Learning, curves: how the reward of the recipes goes up while they train, of each environment a picture."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from flexman_agents.recipes import find_recipe
from flexman_gym.draw.learning import learning_curves, read_progress
from studies.learning.cases import SEEDS

COLUMN = "rollout/ep_rew_mean"  # what every run has, judged on the way or not
POINTS = 50  # of the curve of a run, evenly over its steps


@dataclass(frozen=True)
class Point:
    """Mean reward of the newest training episodes of a run after so many steps."""

    name: str
    seed: float
    steps: float
    reward: float


def points(name: str, seed: int, folder: Path) -> Iterator[Point]:
    """The curve of a run in a folder, thinned."""
    steps, rewards, _ = read_progress(folder, COLUMN)
    for each in np.linspace(steps[0], steps[-1], POINTS):
        yield Point(name, seed, float(each), float(np.interp(each, steps, rewards)))


def environment(name: str) -> str:
    """The id of the environment in which a recipe learns."""
    return str(find_recipe(name).environment["id"])


def adds_to_pd(name: str) -> bool:
    """Whether a recipe adds to a PD."""
    return bool(find_recipe(name).environment.get("base") == "pd")


def pictures(curves: Sequence[Point], folder: Path) -> list[Path]:
    """Draws learning_ID.png for each environment with recipes that add to a PD, whose rewards are of one kind."""
    names = [name for name in SEEDS if any(point.name == name for point in curves) and adds_to_pd(name)]
    result = []
    for id in dict.fromkeys(environment(name) for name in names):
        runs = {name: _seeds(curves, name) for name in names if environment(name) == id}
        result.append(learning_curves(runs, folder / f"learning_{id}.png", "reward of a training episode"))
    return result


def _seeds(curves: Sequence[Point], name: str) -> list[tuple[np.ndarray, np.ndarray]]:
    own = [point for point in curves if point.name == name]
    found = sorted({point.seed for point in own})
    each = [[(point.steps, point.reward) for point in own if point.seed == seed] for seed in found]
    return [(np.array(run)[:, 0], np.array(run)[:, 1]) for run in each]

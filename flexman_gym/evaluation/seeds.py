"""Seeds: disjoint ranges for training, for choices on the way, and for figures that are published."""

from collections.abc import Sequence
from numbers import Integral
from typing import Any

from flexman_gym.checks import refusal, whole_number

SELECTION = range(5000, 5100)  # episodes on which the best policy of a run is chosen
TEST = range(9000, 9100)  # episodes on which nothing is chosen: those of `flexman evaluate`
TRAINING = 1_000_000  # arm i of a run with seed s begins with the seed TRAINING (s + 1) + i


def training_seed(seed: int) -> int:
    """Gives the seed of the first arm of a training run."""
    return TRAINING * (seed + 1)


def episode_seeds(seeds: Sequence[int] | int) -> list[int]:
    """Return the seeds of episodes: those given, or the first of TEST where their number is given.

    Raises:
        ValueError: for anything else.
    """
    given: Any = seeds
    if isinstance(given, Integral):
        return list(TEST[: whole_number("seeds", given, 1, len(TEST))])
    if isinstance(given, str) or not hasattr(given, "__len__") or len(given) == 0:
        raise refusal("seeds", given, f"a list of whole numbers, or how many of the {len(TEST)} test seeds")
    return list(given)

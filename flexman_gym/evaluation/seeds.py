"""Seeds: disjoint ranges for training, for choices on the way, and for figures that are published."""

SELECTION = range(5000, 5100)  # episodes on which the best policy of a run is chosen
TEST = range(9000, 9100)  # episodes on which nothing is chosen: those of `flexman evaluate`
TRAINING = 1_000_000  # arm i of a run with seed s begins with the seed TRAINING (s + 1) + i


def training_seed(seed: int) -> int:
    """Gives the seed of the first arm of a training run."""
    return TRAINING * (seed + 1)

"""Candidates: models of a scene that leave parts of it out."""

from typing import NamedTuple

from flexman_gym.model.model import Model, build_model
from flexman_gym.scene.scene import Scene


class Candidate(NamedTuple):
    """The parts that a model keeps.

    Attributes:
        modes: numbers of the loaded modes of each link.
        springs: whether joints have their springs.
        stiffening: whether links have foreshortening.
    """

    modes: tuple[tuple[int, ...], ...]
    springs: bool
    stiffening: bool

    def build(self, scene: Scene) -> Model:
        """Builds its model for a scene."""
        modes = tuple(given_modes(kept) for kept in self.modes)
        switches = vars(scene.model) | {"flexible_joints": self.springs, "stiffening": self.stiffening, "modes": modes}
        return build_model(scene.arm, **switches)


def whole(scene: Scene) -> Candidate:
    """Gives the candidate that keeps everything of a scene."""
    everything = build_model(scene.arm, **(vars(scene.model) | {"modes": None}))
    modes = tuple(tuple(range(basis.shape[1])) for basis in everything.bases)
    return Candidate(modes, everything.n_motors > 0, any(modes))


def given_modes(numbers: tuple[int, ...]) -> int | tuple[int, ...]:
    """Gives the modes of a link as `build_model` takes them: the lowest ones as their number, others as a tuple."""
    return len(numbers) if numbers == tuple(range(len(numbers))) else numbers

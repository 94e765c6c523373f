"""Initial vibration: an effect that releases arms from bent links."""

from typing import ClassVar

import numpy as np

from flexman_gym.arrays import Array, IntArray
from flexman_gym.checks import non_negative, refusal
from flexman_gym.envs.effects.effect import Range, Stage
from flexman_gym.model.model import Model


class InitialVibration:
    """Deflection, m, of the tip of each flexible link at the start, from where the arm is released.

    A force of random direction across the beam bends the link. It is as large as deflects the tip by so much in the
    direction in which the link bends most. A tip is therefore deflected less in a stiffer direction, and not at all in
    one into which the model of the link cannot bend.
    """

    kind: ClassVar[type] = float

    def __init__(self, stage: Stage, span: Range) -> None:
        model = self._model = stage.batch.model
        self._flexible, self._span, self.shape = np.diff(model.constants.elastic_start) > 0, span, (model.n_joints, 2)
        field = "Randomisation.initial_vibration"
        if not self._flexible.any():
            raise refusal(field, span, "None: every link of this arm is rigid")
        most = stage.limits.deflection * model.constants.length[self._flexible].min()
        if span[1] > most:
            raise refusal(field, span, f"at most {most:.4g} (m), the limit of the deflection of a link")
        self._shapes = [bent_shape(model, link) for link in range(model.n_joints)]
        self._ways = np.array([deflection_of_force(model, link) for link in range(model.n_joints)])
        self._drawn = np.zeros((0, *self.shape))

    @staticmethod
    def checked(field: str, value: object) -> float:
        """A length >= 0."""
        return non_negative(field, value)

    def draw(self, arm: int, stream: np.random.Generator) -> Array:
        """(n, 2) m, deflections along y and z of each link's beam frame."""
        n = len(self._flexible)
        size, angle = stream.uniform(*self._span, n), stream.uniform(0.0, 2.0 * np.pi, n)
        forces = (self._flexible * size * np.array([np.cos(angle), np.sin(angle)])).T
        return np.einsum("nij,nj->ni", self._ways, forces)

    def begin(self, arms: IntArray, drawn: Array) -> None:
        """Keeps what was drawn."""
        self._drawn = drawn

    def change_start(self, arms: IntArray, states: Array) -> None:
        """Deflects the links."""
        for link, shape in enumerate(self._shapes):
            for row, tip in enumerate(self._drawn[arms, link]):
                states[row, self._model.elastic_columns(link)] = shape @ tip


def deflection_of_force(model: Model, link: int) -> Array:
    """(2, 2) deflection of a link's tip along y and z by forces along them, as a part of the largest."""
    across, yielding = _yielding(model, link)
    compliance = across.T @ yielding
    largest = np.linalg.norm(compliance, 2)
    return compliance / largest if largest > 0.0 else compliance


def bent_shape(model: Model, link: int) -> Array:
    """(k_i, 2) coordinates of a link per metre that a force on its tip deflects it along y and z."""
    across, yielding = _yielding(model, link)
    return yielding @ np.linalg.pinv(across.T @ yielding)


def _yielding(model: Model, link: int) -> tuple[Array, Array]:
    """Both (k_i, 2): how coordinates move the tip along y and z, and how forces on it move them."""
    constants = model.constants
    start, stop = constants.elastic_start[link : link + 2]
    first, last = constants.square_start[link : link + 2]
    stiffness = constants.stiffness[first:last].reshape(stop - start, stop - start)
    across = constants.tip_translation[start:stop, 1:]
    return across, np.asarray(np.linalg.solve(stiffness, across), dtype=np.float64)

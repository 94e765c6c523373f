"""Slopes: how the state after a control period follows from the state and the forces before it, by the simulator."""

from dataclasses import replace

import numpy as np

from flexman_gym.arrays import Array, Flags
from flexman_gym.control.plant import Plant
from flexman_gym.control.twins import Twins
from flexman_gym.kernels.layout import OK
from flexman_gym.model.slopes import coordinate_sizes

TOGETHER = 16  # arms whose neighbours are moved at once, for the memory that they take
STATE, FORCE = 1e-5, 1e-3  # by which coordinates (of their size) and forces (of their scale) are changed


class Slopes:
    """Differences of arms that move beside one another, each from a state or under a force that differs in one number.

    At rest they are the exact zero-order hold of `control.discrete`, to the error of the integration method. Motors
    slide, see `model.linear`: Coulomb friction has no slope, and these arms have none.

    Args:
        plant: the arm, and how it is simulated.

    Attributes:
        scales: (n + 3,) of the forces: torque limits (N m), and the force on the tip along each axis that the strongest
            motor bears at the whole reach (N).
    """

    def __init__(self, plant: Plant) -> None:
        model, limits = plant.model, np.array(plant.torque_limit)
        self.scales = np.append(limits, np.full(3, limits.max() / model.constants.length.sum()))
        self._changes = np.concatenate([np.tile(STATE * coordinate_sizes(model), 2), FORCE * self.scales])
        self._size = 2 * model.n_dof
        self._around = np.vstack([np.zeros(len(self._changes)), np.diag(self._changes)])  # the arm, its neighbours
        none = np.zeros(model.n_joints)
        smooth = model.constants._replace(coulomb_friction=none, rubbing=none.astype(np.int64))
        self._twins = Twins(plant._replace(model=replace(model, constants=smooth)))

    def __call__(self, states: Array, torques: Array) -> tuple[Array, Flags]:
        """Gives the slopes (r, 2 d, 2 d + n + 3) by states, torques and forces on the tip; where they are good (r,).

        Args:
            states: (r, 2 d) before the period.
            torques: (r, n) N m in it.
        """
        result, good = np.zeros((len(states), self._size, len(self._changes))), np.zeros(len(states), dtype=bool)
        for first in range(0, len(states), TOGETHER):
            some = slice(first, first + TOGETHER)
            result[some], good[some] = self._differences(states[some], torques[some])
        return result, good

    def _differences(self, states: Array, torques: Array) -> tuple[Array, Flags]:
        batch = self._twins("slopes", TOGETHER * len(self._around))
        shape, n = (len(states), len(self._around)), len(self.scales)
        used = np.arange(shape[0] * shape[1])
        place = np.concatenate([states, torques, np.zeros((len(states), 3))], axis=1)
        near = (place[:, None] + self._around).reshape(len(used), -1)
        drive, moving = np.zeros((len(batch.rows), n + 3)), np.zeros(len(batch.rows), dtype=bool)
        drive[used, :n], moving[used] = near[:, self._size :], True
        batch.place(used, near[:, : self._size])
        batch.step(drive, moving)
        ends = batch.state[used].reshape(*shape, -1)
        good: Flags = (batch.status[used] == OK).reshape(shape).all(axis=1)
        return ((ends[:, 1:] - ends[:, :1]) / self._changes[:, None]).mT, good

"""Integrator of an arm together with the derivatives of its motion."""

import numpy as np

from flexman_gym.common.arrays import Array, IntArray
from flexman_gym.kernels import batch as kernels
from flexman_gym.kernels.arguments import ALL, PER_ARM, tangent_constants
from flexman_gym.kernels.lanes import TANGENTS
from flexman_gym.kernels.layout import ARMS_PER_GROUP, Constants
from flexman_gym.simulation.batch_integrators import LaneIntegrator
from flexman_gym.simulation.methods import FixedStepMethod, Implicit

DIRECTIONS = ARMS_PER_GROUP - 1  # derivatives that one integration computes


class TangentIntegrator(LaneIntegrator):
    """Integrator whose groups are an arm and its derivatives with respect to DIRECTIONS parameters each.

    Drive tables, rows and outputs of `run` are those of ARMS_PER_GROUP * groups arms: those of the arm, followed by
    their derivatives, for each group. A method that iterates until it converges keeps accelerations between steps, of
    one group only.

    Args:
        constants: constants of the arm.
        method: method of fixed steps.
        period: output interval, s, and number of steps in it.
        groups: number of groups.
        whole: True for derivatives of all constants, False for those of the constants PER_ARM.
    """

    _element = TANGENTS

    def __init__(
        self,
        constants: Constants,
        method: FixedStepMethod,
        period: tuple[float, int],
        groups: int,
        whole: bool = False,
    ) -> None:
        self._own = ALL if whole else PER_ARM
        self._kernel = kernels.run_all_tangents if whole else kernels.run_tangents
        self._starts = isinstance(method, Implicit) and method.radius is not None
        super().__init__(constants, method, period, ARMS_PER_GROUP * groups, threads=1)

    def _group_constants(self, constants: Constants) -> Constants:
        """Return the constants of a group with derivatives of zero."""
        return tangent_constants(constants, self._own)

    def set_derivative(self, direction: int, constants: dict[str, Array]) -> None:
        """Set the derivatives of constants with respect to the parameter of a direction, by name."""
        group, lane = divmod(direction, DIRECTIONS)
        for name, values in constants.items():
            getattr(self._constants[group], name)[..., 1 + lane] = values

    def run(self, drives: Array, rows: Array, outputs: Array, counts: IntArray, grid: tuple[float, float, int]) -> None:
        """Integrate under drives as `LaneIntegrator.run`; generalised-alpha begins with a step of length zero.

        That step sets the accelerations to those under the drives, see `kernels.implicit.run_implicit`.
        """
        if self._starts:
            start = np.repeat(rows[:, :1], 2, axis=1)
            super().run(drives, start, np.zeros_like(outputs[:, :2]), counts, (grid[0], 0.0, 1))
        super().run(drives, rows, outputs, counts, grid)

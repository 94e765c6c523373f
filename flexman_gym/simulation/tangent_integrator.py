"""Integrator of an arm together with the derivatives of its motion."""

from flexman_gym.common.arrays import Array
from flexman_gym.kernels import batch as kernels
from flexman_gym.kernels.arguments import tangent_constants
from flexman_gym.kernels.lanes import TANGENTS
from flexman_gym.kernels.layout import ARMS_PER_GROUP, Constants
from flexman_gym.simulation.batch_integrators import LaneIntegrator
from flexman_gym.simulation.methods import IteratedGauss, LinearlyImplicit

DIRECTIONS = ARMS_PER_GROUP - 1  # derivatives that one integration computes


class TangentIntegrator(LaneIntegrator):
    """Integrator whose groups are an arm and its derivatives with respect to DIRECTIONS parameters each.

    Drive tables, rows and outputs of `run` are those of ARMS_PER_GROUP * groups arms: those of the arm, followed by
    their derivatives, for each group.

    Args:
        constants: constants of the arm.
        method: method of fixed steps.
        period: output interval, s, and number of steps in it.
        groups: number of groups.
    """

    _element, _kernel = TANGENTS, staticmethod(kernels.run_tangents)
    _group_constants = staticmethod(tangent_constants)

    def __init__(
        self, constants: Constants, method: LinearlyImplicit | IteratedGauss, period: tuple[float, int], groups: int
    ) -> None:
        super().__init__(constants, method, period, ARMS_PER_GROUP * groups, threads=1)

    def set_derivative(self, direction: int, constants: dict[str, Array]) -> None:
        """Set the derivatives of constants PER_ARM with respect to the parameter of a direction, by name."""
        group, lane = divmod(direction, DIRECTIONS)
        for name, values in constants.items():
            getattr(self._constants[group], name)[..., 1 + lane] = values

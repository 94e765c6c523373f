"""Integrator of an arm together with the derivatives of its motion, and the map of a control period."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from flexman_gym.common.arrays import Array, IntArray
from flexman_gym.common.errors import value_error
from flexman_gym.kernels import batch as kernels
from flexman_gym.kernels import layout
from flexman_gym.kernels.arguments import ALL, PER_ARM, tangent_constants
from flexman_gym.kernels.lanes import TANGENTS
from flexman_gym.kernels.layout import ARMS_PER_GROUP, Constants
from flexman_gym.model.model import Model
from flexman_gym.scene.signals import signal_table
from flexman_gym.simulation.batch_integrators import LaneIntegrator
from flexman_gym.simulation.methods import FixedStepMethod, Implicit, Method, ScipyMethod

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

    @staticmethod
    def derivative_rows(count: int) -> IntArray:
        """Return the rows (count,) of derivatives among the arms of as many groups as they need."""
        groups = -(-count // DIRECTIONS)
        return np.arange(groups * ARMS_PER_GROUP).reshape(-1, ARMS_PER_GROUP)[:, 1:].ravel()[:count]

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


class _PeriodEnd(NamedTuple):
    """End of a control period, with p derivatives.

    Attributes:
        row: (2 d + 2,) state and energy ledger of the arm.
        outputs: (OUTPUTS,) columns of `kernels.layout`.
        rows: (p, 2 d + 2) derivatives of the row.
        derivatives: (p, OUTPUTS) derivatives of the outputs.
        diverged: True if the integration diverged; the other attributes are then undefined.
    """

    row: Array
    outputs: Array
    rows: Array
    derivatives: Array
    diverged: bool


class PeriodMap:
    """Map from state and inputs at the start of a control period to the state at its end, with p derivatives.

    The integration method is differentiated exactly, see `kernels.tangents`; the values have the bits of `Batch.step`.

    Args:
        model: model of the arm.
        method: method of fixed steps.
        period: control period, s, and number of steps in it.
        parameters: derivatives of the constants `kernels.arguments.PER_ARM`, by name, with respect to the parameter of
            each of the p directions; an empty dict for directions of states and inputs.
        constants: constants of the arm; None takes those of the model.

    Attributes:
        count: number of derivatives p.
    """

    def __init__(
        self, model: Model, method: Method, period: tuple[float, int], parameters: Sequence[dict[str, Array]],
        constants: Constants | None = None,
    ) -> None:  # fmt: skip
        if isinstance(method, ScipyMethod) or not method.in_lanes:
            raise value_error("method", method.name, "one of fixed steps that `simulate_all` integrates in groups")
        groups = max(1, -(-len(parameters) // DIRECTIONS))
        self.model, self.count, self._grid = model, len(parameters), (0.0, period[0] / period[1], period[1])
        self._integrator = TangentIntegrator(constants or model.constants, method, period, groups)
        for direction, derivatives in enumerate(parameters):
            self._integrator.set_derivative(direction, derivatives)
        count, n = groups * ARMS_PER_GROUP, model.n_joints
        self._lanes = TangentIntegrator.derivative_rows(len(parameters))
        self._drives = np.zeros((count, 7, n + 6))
        self._drives[::ARMS_PER_GROUP] = signal_table([None] * (n + 6))
        self._rows, self._outputs = np.zeros((count, 2, 2 * model.n_dof + 2)), np.zeros((count, 2, layout.OUTPUTS))
        self._counts = np.zeros((count, 2), dtype=np.int64)

    def advance(self, row: Array, drive: Array, rows: Array, drives: Array) -> _PeriodEnd:
        """Integrate the arm and its derivatives over a control period.

        Args:
            row: (2 d + 2,) state and energy ledger at the start.
            drive: (n + 6,) inputs: motor torques (N m), tip force (3, N) and base acceleration (3, m/s^2).
            rows: (p, 2 d + 2) derivatives of the row at the start.
            drives: (p, n + 6) derivatives of the inputs.

        Returns:
            The end of the period.
        """
        self._rows[::ARMS_PER_GROUP, 0], self._rows[self._lanes, 0] = row, rows
        self._drives[::ARMS_PER_GROUP, layout.OFFSET], self._drives[self._lanes, layout.OFFSET] = drive, drives
        self._integrator.run(self._drives, self._rows, self._outputs, self._counts, self._grid)
        end, outputs = self._rows[:, 1], self._outputs[:, 1]
        return _PeriodEnd(
            end[0].copy(), outputs[0].copy(), end[self._lanes], outputs[self._lanes], bool(self._counts[0, 0] < 1)
        )

    def outputs(self, row: Array, rows: Array) -> Array:
        """Return the derivatives (p, OUTPUTS) of the outputs at a row (2 d + 2,) with derivatives (p, 2 d + 2)."""
        inputs = np.zeros((len(rows) + 1, self.model.n_joints + 6))
        self.advance(row, inputs[0], rows, inputs[1:])
        return self._outputs[self._lanes, 0]


def period_jacobian(model: Model, method: Method, period: tuple[float, int], state: Array, drive: Array) -> Array:
    """Return the Jacobian (2 d, 2 d + n + 6) of the state after a control period with respect to state and inputs.

    Args:
        model: model of the arm.
        method: method of fixed steps.
        period: control period, s, and number of steps in it.
        state: (2 d,) at the start.
        drive: (n + 6,) inputs as in `PeriodMap.advance`.

    Raises:
        ValueError: if the integration diverges.
    """
    size, inputs = 2 * model.n_dof, model.n_joints + 6
    directions = np.eye(size + inputs)
    rows = np.hstack([directions[:, :size], np.zeros((size + inputs, 2))])
    mapped = PeriodMap(model, method, period, [{}] * (size + inputs))
    end = mapped.advance(np.append(state, (0.0, 0.0)), drive, rows, directions[:, size:])
    if end.diverged:
        raise value_error("state", "a state from which the integration diverges", "a shorter step or another state")
    return end.rows[:, :size].T

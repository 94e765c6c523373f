"""Integrator of an arm together with the derivatives of its motion, and the map of a control period."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from flexman_gym.common.arrays import Array, IntArray
from flexman_gym.common.errors import value_error
from flexman_gym.kernels import layout
from flexman_gym.kernels.arguments import ELEMENTS, AllTangentTables, TangentTables, tangent_constants
from flexman_gym.kernels.layout import ARMS_PER_GROUP, Constants, StepGrid
from flexman_gym.model.model import Model
from flexman_gym.scene.signals import signal_table
from flexman_gym.simulation.batch_integrators import LaneIntegrator
from flexman_gym.simulation.methods import FixedStepMethod, Method, ScipyMethod

DIRECTIONS = ARMS_PER_GROUP - 1  # derivatives that one integration computes


class TangentIntegrator(LaneIntegrator):
    """Integrator whose groups are an arm and its derivatives with respect to DIRECTIONS parameters each.

    Arrays of `run` are those of ARMS_PER_GROUP * groups arms: those of the arm, followed by their derivatives, for each
    group. A method that iterates until it converges keeps accelerations between steps, of one group only.

    Args:
        constants: constants of the arm.
        method: method of fixed steps.
        period: output interval, s, and number of steps in it.
        groups: number of groups.
        whole: True for derivatives of all constants, False for those of the constants PER_ARM.
    """

    def __init__(
        self,
        constants: Constants,
        method: FixedStepMethod,
        period: tuple[float, int],
        groups: int,
        whole: bool = False,
    ) -> None:
        self._lane_kind = AllTangentTables if whole else TangentTables
        super().__init__(constants, method, period, ARMS_PER_GROUP * groups, threads=1)

    @staticmethod
    def derivative_rows(count: int) -> IntArray:
        """Return the rows (count,) of derivatives among the arms of as many groups as they need."""
        groups = -(-count // DIRECTIONS)
        return np.arange(groups * ARMS_PER_GROUP).reshape(-1, ARMS_PER_GROUP)[:, 1:].ravel()[:count]

    def _group_constants(self, constants: Constants) -> Constants:
        """Return the constants of a group with derivatives of zero."""
        return tangent_constants(constants, ELEMENTS[self._lane_kind][1])

    def set_derivative(self, direction: int, constants: dict[str, Array]) -> None:
        """Set the derivatives of constants with respect to the parameter of a direction, by name."""
        group, lane = divmod(direction, DIRECTIONS)
        for name, values in constants.items():
            getattr(self._constants[group], name)[..., 1 + lane] = values


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
        self.model, self.count, self._grid = model, len(parameters), StepGrid(0.0, period[0] / period[1], period[1])
        self._integrator = TangentIntegrator(constants or model.constants, method, period, groups)
        for direction, derivatives in enumerate(parameters):
            self._integrator.set_derivative(direction, derivatives)
        count, n = groups * ARMS_PER_GROUP, model.n_joints
        self._lanes = TangentIntegrator.derivative_rows(len(parameters))
        self._drives = np.zeros((count, 7, n + 6))
        self._drives[::ARMS_PER_GROUP] = signal_table([None] * (n + 6))
        size = 2 * model.n_dof + 2
        self._moved = np.zeros((count, size)), np.zeros((count, 1, size)), np.zeros((count, 1, layout.OUTPUTS))
        self._status = np.zeros(count, dtype=np.int64)

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
        self._drives[::ARMS_PER_GROUP, layout.OFFSET], self._drives[self._lanes, layout.OFFSET] = drive, drives
        end, outputs = self._run(self._grid, row, rows)
        failed = bool(self._status[0] != layout.OK)
        return _PeriodEnd(end[0].copy(), outputs[0].copy(), end[self._lanes], outputs[self._lanes], failed)

    def _run(self, grid: StepGrid, row: Array, rows: Array) -> tuple[Array, Array]:
        """Return rows and outputs of the arm and its derivatives at the end of an interval of a time grid."""
        states, ends, outputs = self._moved
        states[::ARMS_PER_GROUP], states[self._lanes], self._status[:] = row, rows, layout.OK
        self._integrator.run(self._drives, grid, 1, self._moved, self._status)
        return ends[:, 0], outputs[:, 0]

    def outputs(self, row: Array, rows: Array) -> Array:
        """Return the derivatives (p, OUTPUTS) of the outputs at a row (2 d + 2,) with derivatives (p, 2 d + 2)."""
        return self._run(StepGrid(0.0, 0.0, 0), row, rows)[1][self._lanes]


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

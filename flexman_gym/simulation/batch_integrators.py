"""Integrators of the arms of a batch: protocol, integration one arm after the other, and integration in SIMD lanes.

b is the number of arms, n of joints and d of coordinates, see `kernels.layout`. Rows of the inputs `drives` are n motor
torques (N m), the tip force (3, N) and the base acceleration (3, m/s^2). An energy ledger is work and dissipation since
the reset, J.
"""

import os
from collections.abc import Callable, Iterator
from functools import partial
from itertools import pairwise
from typing import Any, ClassVar, Protocol

import numpy as np

from flexman_gym.common.arrays import Array
from flexman_gym.common.errors import value_error
from flexman_gym.kernels import batch as kernels
from flexman_gym.kernels import layout
from flexman_gym.kernels.arguments import (
    ELEMENTS,
    PER_ARM,
    ArmTables,
    SingleTables,
    address_table,
    aligned_zeros,
    make_tables,
)
from flexman_gym.kernels.lanes import NUMBER
from flexman_gym.kernels.layout import ARMS_PER_GROUP, Constants, IntArray, Period, StepGrid, make_work
from flexman_gym.kernels.outputs import tip_accelerations
from flexman_gym.scene.signals import signal_table
from flexman_gym.simulation.foundation import foundation_motion
from flexman_gym.simulation.integrator import LANE_COST_RATIO, Integrator, evaluations_per_call, step_ranges
from flexman_gym.simulation.methods import FixedStepMethod
from flexman_gym.simulation.worker_thread import WorkerThread

PeriodRecord = tuple[Array, Array]  # rows (b, T, 2 d + 2) and outputs (b, T, OUTPUTS) after each of T periods


class BatchIntegrator(Protocol):
    """Integrator of the b arms of a batch.

    In all methods, rows (b, 2 d + 2) hold the state (2 d) of each arm, then work and dissipation in J (its energy
    ledger), outputs (b, OUTPUTS) the quantities of `kernels.layout` at this state, and status (b,) OK, DIVERGED or
    NOT_CONVERGED. Arguments named rows, outputs, status and result are overwritten.

    Attributes:
        state_fields: names of the attributes that a snapshot of the batch stores.
    """

    state_fields: ClassVar[tuple[str, ...]]

    def set_constants(self, arms: IntArray, constants: dict[str, Array]) -> None:
        """Set constants (r, ...), by their name in `kernels.arguments.PER_ARM`, of the arms with the indices (r,)."""

    def constants(self, arm: int) -> dict[str, Any]:
        """Return copies of the constants PER_ARM of an arm, by name."""

    def compute_outputs(self, arms: IntArray, rows: Array, outputs: Array, foundation: Array | None = None) -> None:
        """Compute the outputs of the arms with the indices (r,) from the states in `rows`, and call `forget`.

        `foundation` are the foundation rows of all arms; None or (b, 0) for bases that do not rotate.
        """

    def forget(self, arms: IntArray) -> None:
        """Clear the data that the method keeps between steps, for the arms with the indices (r,)."""

    def integrate(self, drives: Array, periods: Array, rows: Array, outputs: Array, status: IntArray) -> None:
        """Integrate the arms whose status is OK over one control period under inputs `drives` (b, n + 6).

        `periods` (b,) are the numbers of control periods since the resets. If an arm fails, only its status changes.
        """

    def integrate_periods(
        self, drives: Array, periods: Array, rows: Array, outputs: Array, status: IntArray, record: PeriodRecord
    ) -> None:
        """Integrate the arms whose status is OK over T control periods under drives (b, T, n + 6); fill the record."""
        for period in range(drives.shape[1]):
            self.integrate(drives[:, period], periods + period, rows, outputs, status)
            ok = status == layout.OK
            record[0][ok, period], record[1][ok, period] = rows[ok], outputs[ok]

    def compute_tip_accelerations(self, drives: Array, rows: Array, result: Array) -> None:
        """Compute the tip accelerations (b, TIP_ACCELERATIONS) of all arms under drives (b, n + 6), m/s^2."""


class SequentialIntegrator(BatchIntegrator):
    """Batch integrator with an `Integrator` for each arm, which integrates one arm after the other.

    `period` = (interval, substeps): the control period, s, and the number of steps in it.
    """

    state_fields = ("own",)

    def __init__(self, integrators: list[Integrator], period: tuple[float, int]) -> None:
        self._integrators = integrators
        for each in integrators:
            each.constants = each.constants._replace(**_own_constants(each.constants))
        self._step, self._substeps = period[0] / period[1], period[1]
        self._period = period[0]
        self._drive = signal_table([None] * (len(integrators[0].constants.mass) + 6))

    def set_constants(self, arms: IntArray, constants: dict[str, Array]) -> None:
        """Set constants of some arms."""
        for i, arm in enumerate(arms):
            own = {name: values[i] for name, values in constants.items()}
            self._integrators[arm].constants = self._integrators[arm].constants._replace(**own)

    def constants(self, arm: int) -> dict[str, Any]:
        """Return copies of the constants of one arm."""
        return _own_constants(self._integrators[arm].constants)

    @property
    def own(self) -> list[dict[str, Array]]:
        """Constants PER_ARM of each arm, with the step size and the stages that its method keeps between steps."""
        return [
            {name: getattr(each.constants, name) for name in sorted(PER_ARM)}
            | {"pace": each.work.next_step, "stages": each.work.stages}
            for each in self._integrators
        ]

    def compute_outputs(self, arms: IntArray, rows: Array, outputs: Array, foundation: Array | None = None) -> None:
        """Compute the outputs of some arms, and clear the data that their method keeps."""
        for arm in arms:
            drive = None
            if foundation is not None and foundation.shape[1]:
                drive = self._table(np.append(np.zeros(self._drive.shape[1]), foundation[arm]), 0.0)
            self._integrators[arm].start(rows[arm], rows[arm].copy(), outputs[arm], drive)

    def forget(self, arms: IntArray) -> None:
        """Clear the data that the method of some arms keeps between steps."""
        for arm in arms:
            self._integrators[arm].forget()

    def integrate(self, drives: Array, periods: Array, rows: Array, outputs: Array, status: IntArray) -> None:
        """Integrate the arms whose status is OK over one control period."""
        row, result = np.zeros((1, rows.shape[1])), np.zeros((1, layout.OUTPUTS))
        for arm in np.flatnonzero(status == layout.OK):
            start = periods[arm] * self._period
            table, grid, state = self._table(drives[arm], start), (start, self._step, self._substeps), rows[arm].copy()
            status[arm] = self._integrators[arm](table, grid, state, row, result)[0]
            if status[arm] == layout.OK:
                rows[arm], outputs[arm] = state, result[0]

    def _table(self, inputs: Array, start: float) -> Array:
        """Return the drive table of inputs that are constant from a time on (s), with their foundation row, if any."""
        count = self._drive.shape[1]
        self._drive[layout.OFFSET] = inputs[:count]
        if len(inputs) == count:
            return self._drive
        row = inputs[count:].copy()
        row[0] += start
        return np.hstack([self._drive, row.reshape(len(self._drive), -1)])

    def compute_tip_accelerations(self, drives: Array, rows: Array, result: Array) -> None:
        """Compute the tip accelerations of all arms."""
        d, count = rows.shape[1] // 2 - 1, self._drive.shape[1]
        for each, inputs, row, out in zip(self._integrators, drives, rows, result, strict=True):
            drive = inputs[:count]
            if len(inputs) > count:
                drive = np.append(drive, foundation_motion(inputs[count:], inputs[count + 1]))
            tip_accelerations(each.constants, each.work, row[:d], row[d : 2 * d], drive, out)


def _own_constants(constants: Constants) -> dict[str, Any]:
    """Return copies of the constants PER_ARM, which may differ between the arms of a batch."""
    return {name: getattr(constants, name).copy() for name in PER_ARM}


Feedback = tuple[Array, IntArray, Array]  # PD control of the motors, see `kernels.batch._add_feedback`
NO_FEEDBACK: Feedback = (np.zeros((0, 4, 1)), np.zeros((0, 2), dtype=np.int64), np.zeros((0, 2)))
NO_PERIOD = np.zeros((0, 3), dtype=np.int64)  # addresses of no environment
GROUPS_PER_THREAD = 4  # least number of groups of arms per thread; passing a task costs as much as one or two groups


class LaneIntegrator(BatchIntegrator):
    """Batch integrator by fixed steps; the ARMS_PER_GROUP arms of a group are SIMD lanes.

    A single arm is integrated by faster kernels of one arm, with equal results to the bit.
    `period` = (interval, substeps): the control period or output interval, s, and the number of steps in it.
    """

    state_fields = ("own",)
    _lane_kind: type[SingleTables] = ArmTables

    def __init__(
        self, constants: Constants, method: FixedStepMethod, period: tuple[float, int], arms: int, threads: int
    ) -> None:
        self._method, self._arguments = method, method.kernel_arguments
        self._step, self._substeps = period[0] / period[1], period[1]
        self._single = arms == 1
        self._kind, self._size = (SingleTables, 1) if self._single else (self._lane_kind, ARMS_PER_GROUP)
        groups = -(-arms // self._size)
        if self._single:
            self._constants = [constants._replace(**_own_constants(constants))]
            self._works = [make_work(constants)]
        else:
            self._constants = [self._group_constants(constants) for _ in range(groups)]
            self._works = [
                make_work(constants, aligned_zeros) for _ in range(min(threads, -(-groups // GROUPS_PER_THREAD)))
            ]
        step_cost = LANE_COST_RATIO * method.evaluations
        self._max_steps = max(1, evaluations_per_call(constants) // step_cost)  # steps of a group in a kernel call
        if constants.rotating[0] and self._substeps > self._max_steps:
            raise value_error("step", self._step, f"at most {self._max_steps} steps in a control period")
        element, own = ELEMENTS[self._kind]
        self._tables = np.array([address_table(each, element, own) for each in self._constants])
        self._work_tables = [address_table(each, element) for each in self._works]
        bounds = np.linspace(0, groups, len(self._works) + 1).round().astype(int)
        self._thread_groups = [slice(int(first), int(end)) for first, end in pairwise(bounds)]
        self._reset_status = np.zeros(arms, dtype=np.int64)
        self._no_record: PeriodRecord = np.zeros((arms, 0, 1)), np.zeros((arms, 0, 1))
        self._workers: list[WorkerThread] = []
        self._process = 0  # id of the process of the worker threads

    def _group_constants(self, constants: Constants) -> Constants:
        """Return the constants of a group of ARMS_PER_GROUP equal arms."""
        own: dict[str, Any] = {name: aligned_zeros(getattr(constants, name).shape) for name in PER_ARM}
        for name, values in own.items():
            values[:] = getattr(constants, name)[..., None]
        return constants._replace(**own)

    @property
    def own(self) -> list[dict[str, Array]]:
        """Constants PER_ARM of each group of arms."""
        return [{name: getattr(each, name) for name in sorted(PER_ARM)} for each in self._constants]

    def constants(self, arm: int) -> dict[str, Any]:
        """Return copies of the constants of one arm."""
        own = self.own[arm // ARMS_PER_GROUP]
        lane = () if self._single else (..., arm % ARMS_PER_GROUP)
        return {name: values[lane].copy() for name, values in own.items()}

    def set_constants(self, arms: IntArray, constants: dict[str, Array]) -> None:
        """Set constants of some arms."""
        groups, lanes = np.divmod(arms, ARMS_PER_GROUP)
        for group in np.unique(groups).tolist():
            some = groups == group
            for name, values in constants.items():
                target = getattr(self._constants[group], name)
                if self._single:
                    target[...] = values[-1]
                else:
                    target[..., lanes[some]] = np.moveaxis(values[some], 0, -1)

    def compute_outputs(self, arms: IntArray, rows: Array, outputs: Array, foundation: Array | None = None) -> None:
        """Compute the outputs of some arms, by zero steps."""
        self._reset_status[:] = layout.NOT_CONVERGED
        self._reset_status[arms] = layout.OK
        drives = np.zeros((len(rows), len(self._constants[0].mass) + 6))
        if foundation is not None and foundation.shape[1]:
            drives = np.hstack([drives, foundation])
        self._integrate_period(drives, 0, rows, outputs, self._reset_status)

    def forget(self, arms: IntArray) -> None:
        """Do nothing: methods whose arms share vector registers keep no data between steps."""

    def integrate(self, drives: Array, periods: Array, rows: Array, outputs: Array, status: IntArray) -> None:
        """Integrate the arms whose status is OK over one control period."""
        drives = np.ascontiguousarray(drives)  # for another layout the kernel would be compiled again
        self._integrate_period(drives, self._substeps, rows, outputs, status)

    def single_arguments(
        self, drives: Array, rows: Array, outputs: Array, status: IntArray, period: Period
    ) -> tuple[Any, ...] | None:
        """Return the arguments of `kernels.batch.advance_single` for a control period of an environment.

        None for several arms, and for a control period of more steps than a call of a kernel may have.
        """
        if not self._single or self._substeps > self._max_steps:
            return None
        tables = self._tables, self._work_tables[0], address_table(period, NUMBER)
        span = self._step, self._substeps
        return tables, self._arguments, drives[:, None], span, rows, outputs, status, self._no_record

    def integrate_feedback(
        self, drives: Array, rows: Array, outputs: Array, status: IntArray, record: PeriodRecord, feedback: Feedback
    ) -> None:
        """Integrate several arms over the T periods of `integrate_periods` under PD control of their motors.

        Raises:
            ValueError: for a single arm, and for more steps than a kernel call may have.
        """
        if self._single or self._substeps * drives.shape[1] > self._max_steps:
            raise value_error("drives", drives.shape, f"several arms, and at most {self._max_steps} steps")
        self._integrate_groups(drives, [self._substeps], (rows, outputs, status), len(self._tables), record, feedback)

    def integrate_periods(
        self, drives: Array, periods: Array, rows: Array, outputs: Array, status: IntArray, record: PeriodRecord
    ) -> None:
        """Integrate the arms whose status is OK over several control periods, in kernel calls of bounded length."""
        if self._substeps > self._max_steps:
            super().integrate_periods(drives, periods, rows, outputs, status, record)
            return
        for first, count in _chunks(drives.shape[1], self._max_steps // self._substeps):
            some = slice(first, first + count)
            part: PeriodRecord = tuple(np.ascontiguousarray(each[:, some]) for each in record)  # type: ignore[assignment]
            given = np.ascontiguousarray(drives[:, some])
            self._integrate_groups(
                given, [self._substeps], (rows, outputs, status), max(1, self._max_steps // count), part
            )
            record[0][:, some], record[1][:, some] = part

    def compute_tip_accelerations(self, drives: Array, rows: Array, result: Array) -> None:
        """Compute the tip accelerations of all arms."""
        if self._single:
            kernels.tip_accelerations((self._tables, self._work_tables[0]), drives, rows, result)
            return

        def run_groups(groups: slice, work: IntArray) -> Iterator[None]:
            for tables, arms in self._parts(groups, len(self._tables), work):
                kernels.tip_accelerations(tables, drives[arms], rows[arms], result[arms])
                yield

        self._run_in_threads(run_groups)

    def run(
        self, drives: Array, grid: StepGrid, count: int, moved: tuple[Array, Array, Array], status: IntArray
    ) -> IntArray:
        """Integrate the arms whose status is OK under drives that change within an output interval.

        Args:
            drives: (b, 7, n + 6) drive tables of `kernels.layout`.
            grid: time grid of the rows.
            count: number of rows to fill.
            moved: states and energy ledgers (b, 2 d + 2), set to those at the end; rows (b, r, 2 d + 2) and outputs
                (b, r, OUTPUTS), of which `count` are overwritten.
            status: (b,) overwritten for arms that fail.

        Returns:
            Numbers (b, 2) of successful steps and of evaluations of the accelerations.
        """
        counts = np.zeros((len(status), 2), dtype=np.int64)
        steps = count * grid.substeps

        def run_groups(groups: slice, work: IntArray) -> Iterator[None]:
            for tables, arms in self._parts(groups, max(1, self._max_steps // max(1, steps)), work):
                given, part = (tables, self._arguments, drives[arms], grid), tuple(each[arms] for each in moved)
                for some in step_ranges(self._method, steps, self._max_steps):
                    kernels.run_steps(*given, some, part, status[arms], counts[arms])
                    yield

        self._run_in_threads(run_groups)
        return counts

    def _integrate_period(self, drives: Array, substeps: int, rows: Array, outputs: Array, status: IntArray) -> None:
        """Integrate the arms whose status is OK over a control period.

        If the period takes several kernel calls, an interruption by Ctrl-C leaves rows, outputs and status unchanged.
        """
        groups_per_call = max(1, self._max_steps // max(1, substeps))  # groups in a kernel call
        if groups_per_call >= len(self._tables) and substeps <= self._max_steps:
            self._integrate_groups(drives[:, None], [substeps], (rows, outputs, status), groups_per_call)
            return
        new, read, after = rows.copy(), outputs.copy(), status.copy()
        parts = [steps for _, steps in _chunks(substeps, self._max_steps)]
        self._integrate_groups(drives[:, None], parts or [0], (new, read, after), groups_per_call)
        moved = (after == layout.OK)[:, None]
        np.copyto(rows, new, where=moved)
        np.copyto(outputs, read, where=moved)
        status[:] = after

    def _integrate_groups(
        self,
        drives: Array,
        parts: list[int],
        moved: tuple[Array, Array, IntArray],
        groups_per_call: int,
        record: PeriodRecord | None = None,
        feedback: Feedback = NO_FEEDBACK,
    ) -> None:
        """Integrate the arms over T periods of constant inputs and overwrite their rows, outputs and status.

        Args:
            drives: (b, T, n + 6) inputs in each period.
            parts: numbers of steps of successive kernel calls.
            moved: rows, outputs and status of the arms.
            groups_per_call: number of groups in a kernel call.
            record: rows and outputs after each period, overwritten; None records none.
            feedback: PD control of the motors of several arms.
        """
        rows, outputs, status = moved
        recorded = record or self._no_record
        if self._single:
            tables = self._tables, self._work_tables[0], NO_PERIOD
            for part in parts:
                if status[0] == layout.OK:
                    kernels.advance_single(tables, self._arguments, drives, (self._step, part), *moved, recorded)
            return

        def run_groups(groups: slice, work: IntArray) -> Iterator[None]:
            for tables, arms in self._parts(groups, groups_per_call, work):
                for part in parts:
                    inputs = (drives[arms], feedback[0][arms], feedback[1][arms], feedback[2][arms])
                    kernels.advance_batch(
                        tables, self._arguments, inputs, (self._step, part),
                        rows[arms], outputs[arms], status[arms], (recorded[0][arms], recorded[1][arms]),
                    )  # fmt: skip
                    yield

        self._run_in_threads(run_groups)

    def _parts(self, groups: slice, count: int, work: IntArray) -> Iterator[tuple[tuple[IntArray, IntArray], slice]]:
        """Yield the address tables and the indices of the arms of `count` groups at a time."""
        for first in range(groups.start, groups.stop, count):
            end = min(first + count, groups.stop)
            yield make_tables(self._kind, self._tables[first:end], work), slice(first * self._size, end * self._size)

    def _run_in_threads(self, task: Callable[[slice, IntArray], Iterator[None]]) -> None:
        """Run a task in each thread with the groups and scratch arrays of the thread; Ctrl-C stops it between calls."""
        ended: list[bool] = []

        def part(thread: int) -> None:
            for _ in task(self._thread_groups[thread], self._work_tables[thread]):
                if ended:
                    return

        workers = self._threads()
        for thread, worker in enumerate(workers, 1):
            worker.begin(partial(part, thread))
        try:
            part(0)
            for worker in workers:
                worker.finish()
        except BaseException:  # Ctrl-C reaches the calling thread only: the workers must stop before it continues
            ended.append(True)
            for worker in workers:
                worker.finish()
            raise

    def _threads(self) -> list[WorkerThread]:
        """Return the worker threads; a forked process starts its own."""
        if self._process != os.getpid():
            self._workers, self._process = [WorkerThread() for _ in self._thread_groups[1:]], os.getpid()
        return self._workers


def _chunks(count: int, most: int) -> Iterator[tuple[int, int]]:
    """Yield the first index and the length of consecutive chunks of `count` items, at most `most` in a chunk."""
    for first in range(0, count, most):
        yield first, min(most, count - first)

"""Integrators of the arms of a batch: the protocol and two implementations.

`SequentialIntegrator` integrates one arm after the other by any method, `LaneIntegrator` several arms at once by
linearly implicit methods.
"""

import os
import weakref
from _thread import allocate_lock
from collections.abc import Callable, Iterator
from functools import partial
from itertools import pairwise
from threading import Thread
from typing import Any, ClassVar, Protocol

import numpy as np

from flexman_gym.common.arrays import Array
from flexman_gym.kernels import batch as kernels
from flexman_gym.kernels import layout
from flexman_gym.kernels.arguments import PER_ARM, address_table, aligned_zeros
from flexman_gym.kernels.lanes import ARMS, NUMBER
from flexman_gym.kernels.layout import ARMS_PER_GROUP, Constants, IntArray, Period, Tableau, TimeGrid, make_work
from flexman_gym.kernels.outputs import tip_accelerations
from flexman_gym.kernels.thread_sync import spin_wait
from flexman_gym.scene.signals import signal_table
from flexman_gym.simulation.integrator import LANE_COST_RATIO, Integrator, evaluations_per_call
from flexman_gym.simulation.methods import IteratedGauss, LinearlyImplicit

SPIN_CHECKS = (
    600_000  # of who waits before he falls asleep: 0.2 ms, in which a short control period comes after the last
)
GIVEN, DONE = 0, 1


class WorkerThread:
    """Worker thread, which ends with its owner.

    Two locks pass a task to the thread and back. Waking a sleeping thread takes as long as the integration of a few
    dozen arms, so both sides spin for a while before they sleep.
    """

    def __init__(self) -> None:
        self._slot, self._busy = _TaskSlot(), False
        Thread(target=_serve, args=(self._slot,), daemon=True).start()
        weakref.finalize(self, self._slot.give, None)

    def begin(self, task: Callable[[], object]) -> None:
        """Start a task in the thread and return at once."""
        self.finish()  # an earlier task remains if an interrupt ended the wait for it
        self._busy = True
        self._slot.give(task)

    def finish(self) -> None:
        """Wait until the task is done and raise its exception, if any; return at once without a task."""
        if not self._busy:
            return
        given = self._slot.counts[GIVEN]
        spin_wait(self._slot.counts, GIVEN, given, given, SPIN_CHECKS)
        self._slot.done.acquire()
        error, self._slot.error, self._busy = self._slot.error, None, False
        if error is not None:
            raise error


class _TaskSlot:
    """State shared by the thread and its owner, so that the thread holds no reference to its owner."""

    def __init__(self) -> None:
        self.task: Callable[[], object] | None = None
        self.error: BaseException | None = None
        self.counts = np.zeros(2, dtype=np.int64)  # tasks given and done
        self.given, self.done = allocate_lock(), allocate_lock()
        self.given.acquire()
        self.done.acquire()

    def give(self, task: Callable[[], object] | None) -> None:
        """Hand over a task; None ends the thread."""
        self.task = task
        self.counts[GIVEN] += 1
        self.given.release()


def _serve(slot: _TaskSlot) -> None:
    """Run the tasks of a slot until it holds None."""
    done = 0
    while True:
        spin_wait(slot.counts, DONE, done, done + 1, SPIN_CHECKS)
        slot.given.acquire()
        if slot.task is None:
            return
        try:
            slot.task()
        except BaseException as error:  # raised by the owner
            slot.error = error
        slot.task, done = None, done + 1
        slot.done.release()


PeriodRecord = tuple[Array, Array]  # rows (b, T, 2 d + 2) and outputs (b, T, OUTPUTS) after each of T periods


class BatchIntegrator(Protocol):
    """Integrator of the b arms of a batch.

    Rows (b, 2 d + 2) hold state and ledger of each arm, outputs (b, OUTPUTS) the quantities of `kernels.layout` at that
    state, and status (b,) OK, DIVERGED or NOT_CONVERGED. Arguments named rows, outputs, status and result are
    overwritten.

    Attributes:
        state_fields: names of the attributes that a snapshot of the batch stores.
    """

    state_fields: ClassVar[tuple[str, ...]]

    def vary(self, arms: IntArray, constants: dict[str, Array]) -> None:
        """Set constants (r, ...), by their name in PER_ARM, of the arms (r,)."""

    def constants(self, arm: int) -> dict[str, Any]:
        """Return copies of the constants of one arm that may differ from arm to arm."""

    def compute_outputs(self, arms: IntArray, rows: Array, outputs: Array) -> None:
        """Compute the outputs of some arms from their rows, and clear the memory of their method."""

    def forget(self, arms: IntArray) -> None:
        """Clear the memory of the method of some arms between steps."""

    def integrate(self, drives: Array, periods: Array, rows: Array, outputs: Array, status: IntArray) -> None:
        """Integrate the arms whose status is OK over one control period under drives (b, n + 6).

        Periods (b,) is the number of control periods since the reset of each arm. An arm that fails gets its status;
        its rows and outputs stay.
        """

    def integrate_periods(
        self, drives: Array, periods: Array, rows: Array, outputs: Array, status: IntArray, record: PeriodRecord
    ) -> None:
        """Integrate the arms whose status is OK over T control periods of drives (b, T, n + 6), and fill the record."""
        for period in range(drives.shape[1]):
            self.integrate(drives[:, period], periods + period, rows, outputs, status)
            ok = status == layout.OK
            record[0][ok, period], record[1][ok, period] = rows[ok], outputs[ok]

    def compute_tip_accelerations(self, drives: Array, rows: Array, result: Array) -> None:
        """Compute the tip accelerations (b, TIP_ACCELERATIONS) of all arms, m/s^2."""


class SequentialIntegrator(BatchIntegrator):
    """Batch integrator with one `Integrator` for each arm, which integrates one arm after the other."""

    state_fields = ("own",)

    def __init__(self, runs: list[Integrator], period: tuple[float, int]) -> None:
        self._runs = runs
        for run in runs:
            run.constants = run.constants._replace(**_own_constants(run.constants))
        self._step, self._substeps = period[0] / period[1], period[1]
        self._period = period[0]
        self._drive = signal_table([None] * (len(runs[0].constants.mass) + 6))

    def vary(self, arms: IntArray, constants: dict[str, Array]) -> None:
        """Set constants of some arms."""
        for i, arm in enumerate(arms):
            own = {name: values[i] for name, values in constants.items()}
            self._runs[arm].constants = self._runs[arm].constants._replace(**own)

    def constants(self, arm: int) -> dict[str, Any]:
        """Return copies of the constants of one arm."""
        return _own_constants(self._runs[arm].constants)

    @property
    def own(self) -> list[dict[str, Array]]:
        """Constants of each arm, with the step size and the stages kept by its method between steps."""
        return [
            {name: getattr(run.constants, name) for name in sorted(PER_ARM)}
            | {"pace": run.work.next_step, "stages": run.work.stages}
            for run in self._runs
        ]

    def compute_outputs(self, arms: IntArray, rows: Array, outputs: Array) -> None:
        """Compute the outputs of some arms, and clear the memory of their method."""
        for arm in arms:
            self._runs[arm].start(rows[arm], rows[arm].copy(), outputs[arm])

    def forget(self, arms: IntArray) -> None:
        """Clear the memory of the method of some arms."""
        for arm in arms:
            self._runs[arm].forget()

    def integrate(self, drives: Array, periods: Array, rows: Array, outputs: Array, status: IntArray) -> None:
        """Integrate the arms whose status is OK over one control period."""
        row, result = np.zeros((1, rows.shape[1])), np.zeros((1, layout.OUTPUTS))
        for arm in np.flatnonzero(status == layout.OK):
            self._drive[layout.OFFSET] = drives[arm]
            moment, state = (periods[arm] * self._period, self._step, self._substeps), rows[arm].copy()
            status[arm] = self._runs[arm](self._drive, moment, state, row, result)[0]
            if status[arm] == layout.OK:
                rows[arm], outputs[arm] = state, result[0]

    def compute_tip_accelerations(self, drives: Array, rows: Array, result: Array) -> None:
        """Compute the tip accelerations of all arms."""
        d = rows.shape[1] // 2 - 1
        for run, drive, row, out in zip(self._runs, drives, rows, result, strict=True):
            tip_accelerations(run.constants, run.work, row[:d], row[d : 2 * d], drive, out)


def _own_constants(constants: Constants) -> dict[str, Any]:
    """Return copies of the constants that may differ from arm to arm."""
    return {name: getattr(constants, name).copy() for name in PER_ARM}


NO_PERIOD = np.zeros((0, 3), dtype=np.int64)  # addresses of no environment
GROUPS_PER_THREAD = 4  # least number of groups of a thread; passing a task costs as much as one or two groups


class LaneIntegrator(BatchIntegrator):
    """Batch integrator by fixed steps of a linearly implicit method, ARMS_PER_GROUP arms in one pass of the kernels.

    A single arm without foreshortening is integrated by the kernels of one arm, which are faster and give the same
    bits.
    """

    state_fields = ("own",)

    def __init__(
        self,
        constants: Constants,
        method: LinearlyImplicit | IteratedGauss,
        period: tuple[float, int],
        arms: int,
        threads: int,
    ) -> None:
        self._method: tuple[Tableau | None, tuple[int, float | None]]  # tableau, or None and the Newton iterations
        self._method = (None, method.counts) if isinstance(method, IteratedGauss) else (method.tableau, (0, None))
        self._step, self._substeps = period[0] / period[1], period[1]
        self._single = arms == 1 and len(constants.station_mass) == 0
        groups = -(-arms // ARMS_PER_GROUP)
        if self._single:
            self._constants = [constants._replace(**_own_constants(constants))]
            self._works = [make_work(constants)]
        else:
            self._constants = [_lane_constants(constants) for _ in range(groups)]
            self._works = [
                make_work(constants, aligned_zeros) for _ in range(min(threads, -(-groups // GROUPS_PER_THREAD)))
            ]
        stages = method.evaluations
        self._most = max(1, evaluations_per_call(constants) // (LANE_COST_RATIO * stages))  # steps of a group in a call
        kind = NUMBER if self._single else ARMS
        self._tables = np.array([address_table(each, kind) for each in self._constants])
        self._work_tables = [address_table(each, kind) for each in self._works]
        bounds = np.linspace(0, groups, len(self._works) + 1).round().astype(int)
        self._shares = [slice(int(first), int(end)) for first, end in pairwise(bounds)]
        self._observed = np.zeros(arms, dtype=np.int64)
        self._no_record: PeriodRecord = np.zeros((arms, 0, 1)), np.zeros((arms, 0, 1))
        self._workers: list[WorkerThread] = []
        self._process = 0

    @property
    def own(self) -> list[dict[str, Array]]:
        """Constants of each group of arms that may differ from arm to arm."""
        return [{name: getattr(each, name) for name in sorted(PER_ARM)} for each in self._constants]

    def constants(self, arm: int) -> dict[str, Any]:
        """Return copies of the constants of one arm."""
        own = self.own[arm // ARMS_PER_GROUP]
        lane = () if self._single else (..., arm % ARMS_PER_GROUP)
        return {name: values[lane].copy() for name, values in own.items()}

    def vary(self, arms: IntArray, constants: dict[str, Array]) -> None:
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

    def compute_outputs(self, arms: IntArray, rows: Array, outputs: Array) -> None:
        """Compute the outputs of some arms, by a run of zero steps."""
        self._observed[:] = layout.NOT_CONVERGED
        self._observed[arms] = layout.OK
        drives = np.zeros((len(rows), len(self._constants[0].mass) + 6))
        self._advance(drives, 0, rows, outputs, self._observed)

    def forget(self, arms: IntArray) -> None:
        """Do nothing: these methods keep no memory from step to step."""

    def integrate(self, drives: Array, periods: Array, rows: Array, outputs: Array, status: IntArray) -> None:
        """Integrate the arms whose status is OK over one control period."""
        self._advance(drives, self._substeps, rows, outputs, status)

    def single_arguments(
        self, drives: Array, rows: Array, outputs: Array, status: IntArray, period: Period
    ) -> tuple[Any, ...] | None:
        """Return the arguments of `kernels.batch.advance_single` for a control period of an environment.

        None for several arms, and for a control period of more steps than a call of a kernel may have.
        """
        if not self._single or self._substeps > self._most:
            return None
        tables = self._tables[0], self._work_tables[0], address_table(period, NUMBER)
        span = self._step, self._substeps
        return tables, self._method, drives[:, None], span, rows, outputs, status, self._no_record

    def integrate_periods(
        self, drives: Array, periods: Array, rows: Array, outputs: Array, status: IntArray, record: PeriodRecord
    ) -> None:
        """Integrate the arms whose status is OK over several control periods, in kernel calls of bounded length."""
        if self._substeps > self._most:
            super().integrate_periods(drives, periods, rows, outputs, status, record)
            return
        for first, count in _chunks(drives.shape[1], self._most // self._substeps):
            some = slice(first, first + count)
            part: PeriodRecord = tuple(np.ascontiguousarray(each[:, some]) for each in record)  # type: ignore[assignment]
            given = np.ascontiguousarray(drives[:, some])
            self._move(given, [self._substeps], (rows, outputs, status), max(1, self._most // count), part)
            record[0][:, some], record[1][:, some] = part

    def compute_tip_accelerations(self, drives: Array, rows: Array, result: Array) -> None:
        """Compute the tip accelerations of all arms."""
        if self._single:
            kernels.tip_accelerations_single(self._tables[0], self._work_tables[0], drives, rows, result)
            return

        def run_share(groups: slice, work: IntArray) -> Iterator[None]:
            arms = _arm_slice(groups)
            kernels.tip_accelerations_batch(self._tables[groups], work, drives[arms], rows[arms], result[arms])
            yield

        self._share(run_share)

    def run(
        self, drives: Array, rows: Array, outputs: Array, counts: IntArray, moment: tuple[float, float, int]
    ) -> None:
        """Integrate all arms from row to row, a period apart, see `kernels.batch.run_batch`.

        Not available for a single arm without foreshortening.

        Args:
            drives: (b, 7, n + 6) tables of the drives.
            rows: (b, r, 2 d + 2) states and ledgers, the first given, the others overwritten.
            outputs: (b, r, OUTPUTS), overwritten.
            counts: (b, 2) valid rows after the first, and steps taken; overwritten.
            moment: time of the first row (s), step (s), and number of steps in a period.
        """
        clock = TimeGrid(*moment, 0.0, 0.0)

        def run_share(groups: slice, work: IntArray) -> Iterator[None]:
            for group in range(groups.start, groups.stop):
                arms = _arm_slice(slice(group, group + 1))
                given = self._tables[group : group + 1], work, *self._method, drives[arms]
                yield from self._run_group(given, clock, rows[arms], outputs[arms], counts[arms])

        self._share(run_share)

    def _run_group(
        self, given: tuple[Any, ...], whole: TimeGrid, rows: Array, outputs: Array, counts: IntArray
    ) -> Iterator[None]:
        """Integrate a group of arms from row to row in kernel calls of bounded length."""
        last, ok = rows[:, 0].copy(), np.ones(len(rows), dtype=bool)
        for row, count, steps, first in _row_chunks(rows.shape[1] - 1, whole.substeps, self._most):
            part, read = (np.zeros((len(rows), count + 1, each.shape[2])) for each in (rows, outputs))
            part[:, 0], now = last, np.zeros_like(counts)
            clock = whole._replace(substeps=steps, first_step=first)
            kernels.run_batch(*given, clock, part, read, now)
            rows[:, row + 1 : row + count + 1], outputs[:, row + 1 : row + count + 1] = part[:, 1:], read[:, 1:]
            if first == 0:
                outputs[:, 0] = read[:, 0]
            counts[ok, 0], counts[:, 1] = row + now[ok, 0], counts[:, 1] + ok * now[:, 1]
            last, ok = part[:, -1], ok & (now[:, 0] == count)
            yield

    def _advance(self, drives: Array, substeps: int, rows: Array, outputs: Array, status: IntArray) -> None:
        """Integrate the arms whose status is OK; a period in several calls is applied as a whole or not at all."""
        together = max(1, self._most // max(1, substeps))  # groups in a call
        if together >= len(self._tables) and substeps <= self._most:
            self._move(drives[:, None], [substeps], (rows, outputs, status), together)
            return
        new, read, after = rows.copy(), outputs.copy(), status.copy()
        parts = [steps for _, steps in _chunks(substeps, self._most)]
        self._move(drives[:, None], parts or [0], (new, read, after), together)
        moved = (after == layout.OK)[:, None]
        np.copyto(rows, new, where=moved)
        np.copyto(outputs, read, where=moved)
        status[:] = after

    def _move(
        self,
        drives: Array,
        parts: list[int],
        moved: tuple[Array, Array, IntArray],
        together: int,
        record: PeriodRecord | None = None,
    ) -> None:
        """Integrate the arms over periods of constant drives and overwrite their rows, outputs and status.

        Args:
            drives: (b, T, n + 6) drives of T periods.
            parts: numbers of steps of successive kernel calls.
            moved: rows, outputs and status of the arms.
            together: number of groups in a call.
            record: rows and outputs after each period, overwritten; None for none.
        """
        rows, outputs, status = moved
        kept = record or self._no_record
        if self._single:
            tables = self._tables[0], self._work_tables[0], NO_PERIOD
            for part in parts:
                if status[0] == layout.OK:
                    kernels.advance_single(tables, self._method, drives, (self._step, part), *moved, kept)
            return

        def run_share(groups: slice, work: IntArray) -> Iterator[None]:
            for first, count in _chunks(groups.stop - groups.start, together):
                some = slice(groups.start + first, groups.start + first + count)
                arms = _arm_slice(some)
                for part in parts:
                    kernels.advance_batch(
                        self._tables[some], work, self._method, drives[arms], (self._step, part),
                        rows[arms], outputs[arms], status[arms], (kept[0][arms], kept[1][arms]),
                    )  # fmt: skip
                    yield

        self._share(run_share)

    def _share(self, task: Callable[[slice, IntArray], Iterator[None]]) -> None:
        """Run a function over the groups of each thread with its work space, kernel call by kernel call."""
        ended: list[bool] = []

        def part(thread: int) -> None:
            for _ in task(self._shares[thread], self._work_tables[thread]):
                if ended:
                    return

        workers = self._threads()
        for thread, worker in enumerate(workers, 1):
            worker.begin(partial(part, thread))
        try:
            part(0)
            for worker in workers:
                worker.finish()
        except BaseException:  # Ctrl-C reaches the calling thread only: the workers must stop before it returns
            ended.append(True)
            for worker in workers:
                worker.finish()
            raise

    def _threads(self) -> list[WorkerThread]:
        """Return the worker threads; a forked process starts its own."""
        if self._process != os.getpid():
            self._workers, self._process = [WorkerThread() for _ in self._shares[1:]], os.getpid()
        return self._workers


def _arm_slice(groups: slice) -> slice:
    """Return the indices of the arms of some groups."""
    return slice(groups.start * ARMS_PER_GROUP, groups.stop * ARMS_PER_GROUP)


def _lane_constants(constants: Constants) -> Constants:
    """Return the constants of ARMS_PER_GROUP equal arms."""
    own: dict[str, Any] = {name: aligned_zeros(getattr(constants, name).shape) for name in PER_ARM}
    for name, values in own.items():
        values[:] = getattr(constants, name)[..., None]
    return constants._replace(**own)


def _chunks(count: int, most: int) -> Iterator[tuple[int, int]]:
    """Return the first index and the length of consecutive pieces of `count` items, at most `most` in a piece."""
    for first in range(0, count, most):
        yield first, min(most, count - first)


def _row_chunks(rows: int, substeps: int, most: int) -> Iterator[tuple[int, int, int, int]]:
    """Return the kernel calls, of at most `most` steps, for `rows` rows of `substeps` steps each.

    Each is (row, count, steps, first): the row of its start, the number of rows to fill, the steps of each, and the
    steps of the row that precede it. A row of more than `most` steps is filled several times, the last time with its
    end state.
    """
    for row, count in _chunks(rows, max(1, most // substeps)):
        for first, steps in _chunks(substeps, most):
            yield row, count, steps, row * substeps + first

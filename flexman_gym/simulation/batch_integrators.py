"""Integrators of the arms of a batch: their protocol, and two that implement it, one arm after the other by any method
or several in lanes by linearly implicit methods.
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
from flexman_gym.kernels.layout import ARMS_PER_GROUP, Constants, IntArray, Tableau, TimeGrid, make_work
from flexman_gym.kernels.outputs import tip_accelerations
from flexman_gym.kernels.thread_sync import spin_wait
from flexman_gym.scene.signals import signal_table
from flexman_gym.simulation.integrator import LANE_COST_RATIO, Integrator, chunks, evaluations_per_call
from flexman_gym.simulation.methods import IteratedGauss, LinearlyImplicit

SPIN_CHECKS = (
    600_000  # of who waits before he falls asleep: 0.2 ms, in which a short control period comes after the last
)
GIVEN, DONE = 0, 1


class WorkerThread:
    """A thread that waits until it is given something to do, and ends with its owner.

    Two locks hand the work over and back. To wake a thread that sleeps at one takes as long as to move a few dozen
    arms, so that both sides look out for the other for a while before they sleep.
    """

    def __init__(self) -> None:
        self._desk, self._busy = _TaskSlot(), False
        Thread(target=_serve, args=(self._desk,), daemon=True).start()
        weakref.finalize(self, self._desk.give, None)

    def begin(self, task: Callable[[], object]) -> None:
        """Lets the thread call the task, and comes back at once."""
        self.finish()  # the last one, if an interrupt kept the owner from waiting for it
        self._busy = True
        self._desk.give(task)

    def finish(self) -> None:
        """Waits until the task is done, and raises what it raised; at once where there is none."""
        if not self._busy:
            return
        given = self._desk.counts[GIVEN]
        spin_wait(self._desk.counts, GIVEN, given, given, SPIN_CHECKS)
        self._desk.done.acquire()
        error, self._desk.error, self._busy = self._desk.error, None, False
        if error is not None:
            raise error


class _TaskSlot:
    """What the thread and its owner share, so that the thread does not keep its owner alive."""

    def __init__(self) -> None:
        self.task: Callable[[], object] | None = None
        self.error: BaseException | None = None
        self.counts = np.zeros(2, dtype=np.int64)  # of tasks given and done
        self.given, self.done = allocate_lock(), allocate_lock()
        self.given.acquire()
        self.done.acquire()

    def give(self, task: Callable[[], object] | None) -> None:
        """Puts down a task, None for the end."""
        self.task = task
        self.counts[GIVEN] += 1
        self.given.release()


def _serve(desk: _TaskSlot) -> None:
    """Does what is given, until there is nothing more to come."""
    done = 0
    while True:
        spin_wait(desk.counts, DONE, done, done + 1, SPIN_CHECKS)
        desk.given.acquire()
        if desk.task is None:
            return
        try:
            desk.task()
        except BaseException as error:  # the owner raises it
            desk.error = error
        desk.task, done = None, done + 1
        desk.done.release()


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

    def observe(self, arms: IntArray, rows: Array, outputs: Array) -> None:
        """Compute the outputs of some arms from their rows, and clear the memory of their method."""

    def forget(self, arms: IntArray) -> None:
        """Clear the memory that the method of some arms keeps from step to step."""

    def move(self, drives: Array, periods: Array, rows: Array, outputs: Array, status: IntArray) -> None:
        """Integrate the arms whose status is OK over one control period under drives (b, n + 6).

        Periods (b,) is the number of control periods since the reset of each arm. An arm that fails gets its status;
        its rows and outputs stay.
        """

    def roll(
        self, drives: Array, periods: Array, rows: Array, outputs: Array, status: IntArray, trail: PeriodRecord
    ) -> None:
        """Integrate the arms whose status is OK over T control periods of drives (b, T, n + 6), and fill the trail."""
        for period in range(drives.shape[1]):
            self.move(drives[:, period], periods + period, rows, outputs, status)
            well = status == layout.OK
            trail[0][well, period], trail[1][well, period] = rows[well], outputs[well]

    def sense(self, drives: Array, rows: Array, result: Array) -> None:
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
        """Constants of each arm, with the step size and the stages that its method keeps from step to step."""
        return [
            {name: getattr(run.constants, name) for name in sorted(PER_ARM)}
            | {"pace": run.work.pace, "stages": run.work.stages}
            for run in self._runs
        ]

    def observe(self, arms: IntArray, rows: Array, outputs: Array) -> None:
        """Compute the outputs of some arms, and clear the memory of their method."""
        for arm in arms:
            self._runs[arm].start(rows[arm], rows[arm].copy(), outputs[arm])

    def forget(self, arms: IntArray) -> None:
        """Clear the memory of the method of some arms."""
        for arm in arms:
            self._runs[arm].forget()

    def move(self, drives: Array, periods: Array, rows: Array, outputs: Array, status: IntArray) -> None:
        """Integrate the arms whose status is OK over one control period."""
        row, result = np.zeros((1, rows.shape[1])), np.zeros((1, layout.OUTPUTS))
        for arm in np.flatnonzero(status == layout.OK):
            self._drive[layout.OFFSET] = drives[arm]
            moment, state = (periods[arm] * self._period, self._step, self._substeps), rows[arm].copy()
            status[arm] = self._runs[arm](self._drive, moment, state, row, result)[0]
            if status[arm] == layout.OK:
                rows[arm], outputs[arm] = state, result[0]

    def sense(self, drives: Array, rows: Array, result: Array) -> None:
        """Compute the tip accelerations of all arms."""
        d = rows.shape[1] // 2 - 1
        for run, drive, row, out in zip(self._runs, drives, rows, result, strict=True):
            tip_accelerations(run.constants, run.work, row[:d], row[d : 2 * d], drive, out)


def _own_constants(constants: Constants) -> dict[str, Any]:
    """Return copies of the constants that may differ from arm to arm."""
    return {name: getattr(constants, name).copy() for name in PER_ARM}


GROUPS_PER_THREAD = 4  # groups that are worth a thread: to hand them over takes as long as to move one or two


class LaneIntegrator(BatchIntegrator):
    """Batch integrator by fixed steps of a linearly implicit method, ARMS_ABREAST arms in one pass of the kernels.

    A single arm without foreshortening is integrated by the kernels of one arm, faster and with the same bits.
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
        self._method: tuple[Tableau | None, tuple[int, int | None]]  # tableau, or sweeps without one
        self._method = (None, method.counts) if isinstance(method, IteratedGauss) else (method.tableau, (0, None))
        self._step, self._substeps = period[0] / period[1], period[1]
        self._alone = arms == 1 and len(constants.station_mass) == 0
        groups = -(-arms // ARMS_PER_GROUP)
        if self._alone:
            self._constants = [constants._replace(**_own_constants(constants))]
            self._works = [make_work(constants)]
        else:
            self._constants = [_lane_constants(constants) for _ in range(groups)]
            self._works = [
                make_work(constants, aligned_zeros) for _ in range(min(threads, -(-groups // GROUPS_PER_THREAD)))
            ]
        stages = method.evaluations
        self._most = max(1, evaluations_per_call(constants) // (LANE_COST_RATIO * stages))  # steps of a group in a call
        kind = NUMBER if self._alone else ARMS
        self._tables = np.array([address_table(each, kind) for each in self._constants])
        self._work_tables = [address_table(each, kind) for each in self._works]
        bounds = np.linspace(0, groups, len(self._works) + 1).round().astype(int)
        self._shares = [slice(int(first), int(end)) for first, end in pairwise(bounds)]
        self._observed = np.zeros(arms, dtype=np.int64)
        self._no_trail: PeriodRecord = np.zeros((arms, 0, 1)), np.zeros((arms, 0, 1))
        self._helpers: list[WorkerThread] = []
        self._process = 0

    @property
    def own(self) -> list[dict[str, Array]]:
        """The constants that arms may differ in, of each group."""
        return [{name: getattr(each, name) for name in sorted(PER_ARM)} for each in self._constants]

    def constants(self, arm: int) -> dict[str, Any]:
        """Return copies of the constants of one arm."""
        own = self.own[arm // ARMS_PER_GROUP]
        lane = () if self._alone else (..., arm % ARMS_PER_GROUP)
        return {name: values[lane].copy() for name, values in own.items()}

    def vary(self, arms: IntArray, constants: dict[str, Array]) -> None:
        """Set constants of some arms."""
        groups, lanes = np.divmod(arms, ARMS_PER_GROUP)
        for group in np.unique(groups).tolist():
            some = groups == group
            for name, values in constants.items():
                target = getattr(self._constants[group], name)
                if self._alone:
                    target[...] = values[-1]
                else:
                    target[..., lanes[some]] = np.moveaxis(values[some], 0, -1)

    def observe(self, arms: IntArray, rows: Array, outputs: Array) -> None:
        """Compute the outputs of some arms, by a run of zero steps."""
        self._observed[:] = layout.NOT_CONVERGED
        self._observed[arms] = layout.OK
        drives = np.zeros((len(rows), len(self._constants[0].mass) + 6))
        self._advance(drives, 0, rows, outputs, self._observed)

    def forget(self, arms: IntArray) -> None:
        """Do nothing: these methods keep no memory from step to step."""

    def move(self, drives: Array, periods: Array, rows: Array, outputs: Array, status: IntArray) -> None:
        """Integrate the arms whose status is OK over one control period."""
        self._advance(drives, self._substeps, rows, outputs, status)

    def roll(
        self, drives: Array, periods: Array, rows: Array, outputs: Array, status: IntArray, trail: PeriodRecord
    ) -> None:
        """Integrate the arms whose status is OK over several control periods, in kernel calls of bounded length."""
        if self._substeps > self._most:
            super().roll(drives, periods, rows, outputs, status, trail)
            return
        for first, count in chunks(drives.shape[1], self._most // self._substeps):
            some = slice(first, first + count)
            part: PeriodRecord = tuple(np.ascontiguousarray(each[:, some]) for each in trail)  # type: ignore[assignment]
            given = np.ascontiguousarray(drives[:, some])
            self._move(given, [self._substeps], (rows, outputs, status), max(1, self._most // count), part)
            trail[0][:, some], trail[1][:, some] = part

    def sense(self, drives: Array, rows: Array, result: Array) -> None:
        """Compute the tip accelerations of all arms."""
        if self._alone:
            kernels.tip_accelerations_single(self._tables[0], self._work_tables[0], drives, rows, result)
            return

        def share(groups: slice, work: IntArray) -> Iterator[None]:
            arms = _arm_slice(groups)
            kernels.tip_accelerations_batch(self._tables[groups], work, drives[arms], rows[arms], result[arms])
            yield

        self._share(share)

    def run(
        self, drives: Array, rows: Array, outputs: Array, counts: IntArray, moment: tuple[float, float, int]
    ) -> None:
        """Moves all arms from row to row, a period apart, each by its drive (b, 7, n + 6); as `kernels.batch.run_batch`.

        The moment is the time of the first row (s), the step (s) and the steps in a period. Not for an arm that is
        moved alone.
        """
        clock = TimeGrid(*moment, 0.0, 0.0)

        def share(groups: slice, work: IntArray) -> Iterator[None]:
            for group in range(groups.start, groups.stop):
                arms = _arm_slice(slice(group, group + 1))
                given = self._tables[group : group + 1], work, *self._method, drives[arms]
                yield from self._run_group(given, clock, rows[arms], outputs[arms], counts[arms])

        self._share(share)

    def _run_group(
        self, given: tuple[Any, ...], whole: TimeGrid, rows: Array, outputs: Array, counts: IntArray
    ) -> Iterator[None]:
        """Moves a group of arms from row to row in calls that are not too long."""
        last, well = rows[:, 0].copy(), np.ones(len(rows), dtype=bool)
        for row, many, steps, first in _row_chunks(rows.shape[1] - 1, whole.substeps, self._most):
            part, read = (np.zeros((len(rows), many + 1, each.shape[2])) for each in (rows, outputs))
            part[:, 0], now = last, np.zeros_like(counts)
            clock = whole._replace(substeps=steps, first=first)
            kernels.run_batch(*given, clock, part, read, now)
            rows[:, row + 1 : row + many + 1], outputs[:, row + 1 : row + many + 1] = part[:, 1:], read[:, 1:]
            if first == 0:
                outputs[:, 0] = read[:, 0]
            counts[well, 0], counts[:, 1] = row + now[well, 0], counts[:, 1] + well * now[:, 1]
            last, well = part[:, -1], well & (now[:, 0] == many)
            yield

    def _advance(self, drives: Array, substeps: int, rows: Array, outputs: Array, status: IntArray) -> None:
        """Moves the arms whose status is OK; a long way in several calls, or else not at all."""
        together = max(1, self._most // max(1, substeps))  # groups in a call
        if together >= len(self._tables) and substeps <= self._most:
            self._move(drives[:, None], [substeps], (rows, outputs, status), together)
            return
        new, read, after = rows.copy(), outputs.copy(), status.copy()
        parts = [steps for _, steps in chunks(substeps, self._most)]
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
        trail: PeriodRecord | None = None,
    ) -> None:
        """Moves rows, outputs and status of the arms, so many groups in a call, by some steps after others.

        Drives (b, T, n + 6) are those of T periods, of which a trail keeps rows and outputs.
        """
        rows, outputs, status = moved
        kept = trail or self._no_trail
        if self._alone:
            given = self._tables[0], self._work_tables[0], self._method, drives
            for part in parts:
                if status[0] == layout.OK:
                    kernels.advance_single(*given, (self._step, part), *moved, kept)
            return

        def share(groups: slice, work: IntArray) -> Iterator[None]:
            for first, count in chunks(groups.stop - groups.start, together):
                some = slice(groups.start + first, groups.start + first + count)
                arms = _arm_slice(some)
                for part in parts:
                    kernels.advance_batch(
                        self._tables[some], work, self._method, drives[arms], (self._step, part),
                        rows[arms], outputs[arms], status[arms], (kept[0][arms], kept[1][arms]),
                    )  # fmt: skip
                    yield

        self._share(share)

    def _share(self, share: Callable[[slice, IntArray], Iterator[None]]) -> None:
        """Goes through what a function does with the groups of each thread and its work space, call by call."""
        ended: list[bool] = []

        def part(thread: int) -> None:
            for _ in share(self._shares[thread], self._work_tables[thread]):
                if ended:
                    return

        helpers = self._threads()
        for thread, helper in enumerate(helpers, 1):
            helper.begin(partial(part, thread))
        try:
            part(0)
            for helper in helpers:
                helper.finish()
        except BaseException:  # Ctrl-C, which the calling thread alone hears: nobody may go on with shared work space
            ended.append(True)
            for helper in helpers:
                helper.finish()
            raise

    def _threads(self) -> list[WorkerThread]:
        """Gives the threads beside the calling one; a forked process has none of its parent's."""
        if self._process != os.getpid():
            self._helpers, self._process = [WorkerThread() for _ in self._shares[1:]], os.getpid()
        return self._helpers


def _arm_slice(groups: slice) -> slice:
    """The arms of groups."""
    return slice(groups.start * ARMS_PER_GROUP, groups.stop * ARMS_PER_GROUP)


def _lane_constants(constants: Constants) -> Constants:
    """Gives the constants of ARMS_ABREAST arms, all alike."""
    own: dict[str, Any] = {name: aligned_zeros(getattr(constants, name).shape) for name in PER_ARM}
    for name, values in own.items():
        values[:] = getattr(constants, name)[..., None]
    return constants._replace(**own)


def _row_chunks(rows: int, substeps: int, most: int) -> Iterator[tuple[int, int, int, int]]:
    """Gives the pieces of a run of `rows` of `substeps` steps each, of at most `most` steps.

    Each is the row from which it starts, how many rows it fills, the steps of each, and how many steps come before it.
    A row of more steps is filled several times, at last with its end.
    """
    for row, many in chunks(rows, max(1, most // substeps)):
        for first, steps in chunks(substeps, most):
            yield row, many, steps, row * substeps + first

"""Worker thread that takes tasks with little delay."""

import weakref
from _thread import allocate_lock
from collections.abc import Callable
from threading import Thread

import numpy as np

from flexman_gym.kernels.thread_sync import spin_wait

SPIN_CHECKS = 600_000  # reads of a flag before a waiting thread sleeps: 0.2 ms, more than the time between two tasks
GIVEN, DONE = 0, 1  # indices of the numbers of tasks passed to a worker thread and done by it


class WorkerThread:
    """Worker thread; it ends when this object is deleted.

    One lock signals a task, another its completion. Waking a sleeping thread takes as long as the integration of a few
    dozen arms, so both threads poll a flag for a short time before they sleep.
    """

    def __init__(self) -> None:
        self._slot, self._busy = _TaskSlot(), False
        Thread(target=_serve, args=(self._slot,), daemon=True).start()
        weakref.finalize(self, self._slot.give, None)

    def begin(self, task: Callable[[], object]) -> None:
        """Start a task in the thread and return at once."""
        self.finish()  # a task remains if Ctrl-C ended the wait for it
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
    """State shared by a worker thread and its `WorkerThread`, to which the thread holds no reference."""

    def __init__(self) -> None:
        self.task: Callable[[], object] | None = None
        self.error: BaseException | None = None
        self.counts = np.zeros(2, dtype=np.int64)  # numbers of tasks passed and done
        self.given, self.done = allocate_lock(), allocate_lock()
        self.given.acquire()
        self.done.acquire()

    def give(self, task: Callable[[], object] | None) -> None:
        """Pass a task to the thread; None ends the thread."""
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
        except BaseException as error:  # raised by `WorkerThread.finish`
            slot.error = error
        slot.task, done = None, done + 1
        slot.done.release()

"""Helper: a thread that does one thing at a time beside the calling one."""

import weakref
from _thread import allocate_lock
from collections.abc import Callable
from threading import Thread

import numpy as np

from flexman_gym.kernels.signals import watch

LOOKS = 600_000  # of who waits before he falls asleep: 0.2 ms, in which a short control period comes after the last
GIVEN, DONE = 0, 1


class Helper:
    """A thread that waits until it is given something to do, and ends with its owner.

    Two locks hand the work over and back. To wake a thread that sleeps at one takes as long as to move a few dozen
    arms, so that both sides look out for the other for a while before they sleep.
    """

    def __init__(self) -> None:
        self._desk, self._busy = _Desk(), False
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
        watch(self._desk.counts, GIVEN, given, given, LOOKS)
        self._desk.done.acquire()
        error, self._desk.error, self._busy = self._desk.error, None, False
        if error is not None:
            raise error


class _Desk:
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


def _serve(desk: _Desk) -> None:
    """Does what is given, until there is nothing more to come."""
    done = 0
    while True:
        watch(desk.counts, DONE, done, done + 1, LOOKS)
        desk.given.acquire()
        if desk.task is None:
            return
        try:
            desk.task()
        except BaseException as error:  # the owner raises it
            desk.error = error
        desk.task, done = None, done + 1
        desk.done.release()

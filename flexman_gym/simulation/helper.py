"""Helper: a thread that does one thing at a time beside the calling one."""

import weakref
from _thread import allocate_lock
from collections.abc import Callable
from threading import Thread


class Helper:
    """A thread that sleeps until it is given something to do, and ends with its owner.

    Two locks hand the work over and back; an executor of Python takes as long for that as eight arms for a period.
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
        self._desk.done.acquire()
        error, self._desk.error, self._busy = self._desk.error, None, False
        if error is not None:
            raise error


class _Desk:
    """What the thread and its owner share, so that the thread does not keep its owner alive."""

    def __init__(self) -> None:
        self.task: Callable[[], object] | None = None
        self.error: BaseException | None = None
        self.given, self.done = allocate_lock(), allocate_lock()
        self.given.acquire()
        self.done.acquire()

    def give(self, task: Callable[[], object] | None) -> None:
        """Puts down a task, None for the end."""
        self.task = task
        self.given.release()


def _serve(desk: _Desk) -> None:
    """Does what is given, until there is nothing more to come."""
    while desk.given.acquire() and desk.task is not None:
        try:
            desk.task()
        except BaseException as error:  # the owner raises it
            desk.error = error
        desk.task = None
        desk.done.release()

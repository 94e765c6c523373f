"""Progress of a long computation, reported on stderr every ten seconds."""

import os
import sys
from time import monotonic

INTERVAL = 10.0  # s; time between two lines


class Progress:
    """Counter that reports the progress of a long computation on stderr every 10 s.

    FLEXMAN_QUIET=1 silences it.

    Args:
        what: name of the counted items, in the plural.
        total: number of items; None if unknown.
    """

    def __init__(self, what: str, total: int | None = None) -> None:
        self._what, self._total, self._done = what, total, 0
        self._start = self._last = monotonic()

    def count(self) -> None:
        """Count one finished item."""
        self.reach(self._done + 1)

    def reach(self, done: int) -> None:
        """Report a number of finished items."""
        self._done, now = done, monotonic()
        if now - self._last < INTERVAL or self._done == self._total or os.environ.get("FLEXMAN_QUIET"):
            return
        self._last, elapsed = now, now - self._start
        if self._total is None:
            line = f"{self._done} {self._what} after {elapsed:.0f} s"
        else:
            remaining = elapsed / self._done * (self._total - self._done)  # s
            line = f"{self._done} of {self._total} {self._what}, about {remaining / 60:.1f} min left"
        print(line, file=sys.stderr, flush=True)

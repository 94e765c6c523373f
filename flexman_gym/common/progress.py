"""Progress of a long computation: a line on stderr every ten seconds."""

import os
import sys
from time import monotonic

INTERVAL = 10.0  # s between two lines


class Progress:
    """Counter of the parts of a long computation; a line on stderr every 10 s says how far it is.

    FLEXMAN_QUIET=1 silences it.

    Args:
        what: the parts, in the plural.
        total: how many there are; None where that is open.
    """

    def __init__(self, what: str, total: int | None = None) -> None:
        self._what, self._total, self._done = what, total, 0
        self._begun = self._said = monotonic()

    def count(self) -> None:
        """Count a part that is done."""
        self._done += 1
        now = monotonic()
        if now - self._said < INTERVAL or self._done == self._total or os.environ.get("FLEXMAN_QUIET"):
            return
        self._said, elapsed = now, now - self._begun
        if self._total is None:
            line = f"{self._done} {self._what} after {elapsed:.0f} s"
        else:
            left = elapsed / self._done * (self._total - self._done)
            line = f"{self._done} of {self._total} {self._what}, about {left / 60:.1f} min left"
        print(line, file=sys.stderr, flush=True)

"""Clock of real-time loops."""

import time
from typing import Protocol

SPIN = 1e-4  # s; end of a wait that is not slept, longer than a computer needs to wake up a process


class Clock(Protocol):
    """Clock of a real-time loop."""

    def now(self) -> float:
        """Return the time, s."""
        ...

    def wait(self, deadline: float) -> None:
        """Return at a time, s."""
        ...


class MonotonicClock:
    """Monotonic clock of the computer; `wait` sleeps until shortly before the deadline, and then spins."""

    def now(self) -> float:
        """Return the time, s."""
        return time.monotonic()

    def wait(self, deadline: float) -> None:
        """Return at a time, s."""
        if (rest := deadline - time.monotonic() - SPIN) > 0.0:
            time.sleep(rest)
        while time.monotonic() < deadline:
            pass

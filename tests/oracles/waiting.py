"""Waiting for an event of another thread, with a limit that no computer under load reaches."""

import time

LIMIT = 60.0  # s


def wait_until(condition):
    """Wait until a function returns True; TimeoutError after `LIMIT`, as the event will not come."""
    end = time.monotonic() + LIMIT
    while not condition():
        if time.monotonic() > end:
            raise TimeoutError(f"{condition} is not true after {LIMIT:g} s")
        time.sleep(0.01)

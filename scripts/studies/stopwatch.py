"""Stopwatch of the calls of a method."""

import time
from collections.abc import Callable
from typing import Any


class Stopwatch:
    """A context in which the time of all calls of a method is added up."""

    def __init__(self, owner: type, name: str) -> None:
        self._owner, self._name, self._method = owner, name, getattr(owner, name)
        self.cpu = self.wall = 0.0

    def __enter__(self) -> "Stopwatch":
        method: Callable[..., Any] = self._method

        def watched(*arguments: Any, **named: Any) -> Any:
            started = time.process_time(), time.perf_counter()
            try:
                return method(*arguments, **named)
            finally:
                self.cpu += time.process_time() - started[0]
                self.wall += time.perf_counter() - started[1]

        setattr(self._owner, self._name, watched)
        return self

    def __exit__(self, *error: object) -> None:
        setattr(self._owner, self._name, self._method)

"""Methods: which of them a study compares, in the order of `METHODS`, where a new one is enough to take part."""

from collections.abc import Iterable
from typing import Protocol

from flexman_gym.simulation.families import EXPLICIT
from flexman_gym.simulation.methods import METHODS


class MethodRow(Protocol):
    """A row of a study that knows its method."""

    @property
    def method(self) -> str:
        """A name from `METHODS`, or that of another code."""


def fixed_step_methods() -> list[str]:
    """Those that take steps of a given length: all but the reference methods, by which a study judges the others."""
    return [name for name, method in METHODS.items() if not method.adaptive]


def explicit_methods() -> list[str]:
    """Those of them whose step the highest natural frequency limits."""
    return [name for name in fixed_step_methods() if METHODS[name].kind == EXPLICIT]


def implicit_methods() -> list[str]:
    """Those of them that are not explicit: implicit and linearly implicit ones."""
    return [name for name in fixed_step_methods() if METHODS[name].kind != EXPLICIT]


def methods_of(rows: Iterable[MethodRow]) -> list[str]:
    """Those that these rows are about."""
    known = {row.method for row in rows}
    return [name for name in METHODS if name in known]


def extrapolations_of(rows: Iterable[MethodRow]) -> list[str]:
    """Those of them that extrapolate another method."""
    return [name for name in methods_of(rows) if len(getattr(METHODS[name], "sequence", ())) > 1]

"""Rounding: arms of which double precision leaves nothing to calculate with."""

from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np

from flexman_gym.checks import refusal


@contextmanager
def solvable(what: str) -> Iterator[None]:
    """Refuses an arm for which rounding leaves no solution of `what` is calculated within.

    Raises:
        ValueError: in place of the errors of linear algebra, and of numbers that are not finite.
    """
    try:
        with np.errstate(divide="raise", over="raise", invalid="raise"):
            yield
    except (FloatingPointError, ValueError):
        allowed = f"one for which there are {what}: masses, stiffness and torques of sizes that go together"
        raise refusal("arm", "this one", allowed) from None

"""Stability rows: all that the study measures."""

from collections.abc import Iterator

from studies.stability.cases import CASES
from studies.stability.damping import damping_rows
from studies.stability.drift import drift_rows
from studies.stability.limits import LIMIT_STUDIES, amplification_rows, limit_rows
from studies.stability.maps import map_rows, spin_limit_row
from studies.stability.measure import Row

QUICK_METHODS, QUICK_STEPS = ("ros2", "implicit_midpoint"), (0.005, 0.02)


def all_rows(quick: bool = False) -> Iterator[Row]:
    """All rows, or a small grid of them."""
    yield from amplification_rows()
    for study in LIMIT_STUDIES:
        yield from limit_rows(study, quick)
    yield spin_limit_row()
    for study in CASES:
        yield from map_rows(study, quick)
    for rotor_inertia in (1.0, 10.0):
        yield from damping_rows(rotor_inertia, QUICK_METHODS, QUICK_STEPS) if quick else damping_rows(rotor_inertia)
    yield from drift_rows(10_000) if quick else drift_rows()

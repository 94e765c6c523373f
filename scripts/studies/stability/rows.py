"""Stability rows: all that the study measures, cell by cell."""

from collections.abc import Callable, Iterator
from dataclasses import asdict
from pathlib import Path
from typing import Any, NamedTuple

from flexman_gym.evaluation.grid import Workers, gathered
from studies.methods import fixed_step_methods
from studies.stability.cases import CASES, parameters_of
from studies.stability.damping import damping_rows
from studies.stability.drift import DRIFT_STEPS, drift_rows
from studies.stability.limits import LIMIT_STUDIES, amplification_rows, limit_rows
from studies.stability.maps import map_rows, spin_limit_row
from studies.stability.measure import Row

QUICK_METHODS, QUICK_STEPS = ("ros2", "implicit_midpoint"), (0.005, 0.02)
MAKERS: dict[str, Callable[..., Iterator[Row]]] = {
    "amplification": amplification_rows,
    "limits": limit_rows,
    "spin limit": lambda: iter([spin_limit_row()]),
    "map": map_rows,
    "damping": damping_rows,
    "drift": drift_rows,
}


class Cell(NamedTuple):
    """Rows that are measured together: the name of what makes them, and its arguments."""

    maker: str
    arguments: tuple[Any, ...] = ()


def cells(quick: bool = False) -> list[Cell]:
    """All cells, or those of a small grid."""
    result = [Cell("amplification")]
    result += [
        Cell("limits", (study, quick, (each,))) for study in LIMIT_STUDIES for each in parameters_of(study, quick)
    ]
    result.append(Cell("spin limit"))
    for study in CASES:
        every = tuple(parameters_of(study, quick))
        together = CASES[study](every[0]).varied is not None  # arms side by side
        result += [Cell("map", (study, quick, part)) for part in ([every] if together else [(each,) for each in every])]
    result += [Cell("damping", (inertia, *(QUICK_METHODS, QUICK_STEPS) * quick)) for inertia in (1.0, 10.0)]
    return result + [Cell("drift", (10_000 if quick else DRIFT_STEPS, (name,))) for name in fixed_step_methods()]


def rows_of(cell: Cell) -> list[dict[str, Any]]:
    """The rows of a cell as plain data."""
    return [asdict(row) for row in MAKERS[cell.maker](*cell.arguments)]


def all_rows(quick: bool = False, workers: Workers | int = 1, kept: Path | None = None) -> list[Row]:
    """All rows, or a small grid of them; `workers` and `kept` as of `evaluation.grid.spread`."""
    return [Row(**row) for rows in gathered(rows_of, cells(quick), workers, kept) for row in rows]

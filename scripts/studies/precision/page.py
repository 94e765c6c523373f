"""Page of the work-precision study, and the computation of its rows."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from functools import cache
from pathlib import Path
from typing import Any

from flexman_gym.common.markdown import markdown_table
from flexman_gym.common.parallel import Workers, parallel_map
from flexman_gym.envs.vector_env import compile_kernels
from flexman_gym.toolbox.precision.runs import PrecisionRow, PrecisionScene
from studies.methods import extrapolations_of, fixed_step_methods, methods_of
from studies.precision.charts import PICTURE
from studies.precision.measure import (
    Floor,
    cases,
    cheapest,
    choices,
    grid,
    quick_grid,
    quick_study,
    reference_floors,
    setbacks,
    study,
)
from studies.screen import picture, screen

ERRORS = (1e-2, 1e-3, 1e-4)  # m; columns of the table
COUNTED = 1e-4  # m; time error at which the cheapest methods are counted
FEW, MESH = "4 modes a link", "elements"  # the model with few modes; word in the names of models with all coordinates
MESSAGE = "Error of the tip over cost of six methods, which differ most at small errors"
QUESTION = "Which integration method and which model reach a given error of the tip at the lowest cost?"
ANSWER = """**No method is the cheapest everywhere: at a time error of {counted:g} mm a Gauss method is in {gauss},
an extrapolation in {extrapolated} and a midpoint rule in {midpoint} of {count} combinations of scene and model.** A
model with the 4 lowest modes per link stays {least:.3g} to {most:.3g} mm from the best solution of its scene at any
step."""
BODY = """{picture}

The time error is the largest distance of the tip from the converged solution of the same model. The table has the
cheapest method within a time error and its CPU ms per simulated second, for models with all coordinates.

{table}

Extrapolations amplify undamped vibrations in a band of omega h, so that a shorter step can increase the error: in
{setbacks} combinations of scene, model and method. Choose by a scene that is similar to yours; `flexman precision
scene.yaml` draws your scene. The rows have {rows:,} runs of {methods} methods ({missing}) and all models, with time
and total errors."""


def page(rows: Sequence[PrecisionRow], floors: Sequence[Floor], files: Mapping[str, str]) -> str:
    """Return the page as Markdown; `files` are the files of rows and floors with their comments."""
    pairs = [(floor.scene, floor.model) for floor in floors if floor.model]
    best = [_best(rows, *pair, COUNTED) for pair in pairs]
    names = extrapolations_of(rows)
    left = [_least(rows, scene, FEW) for scene in dict.fromkeys(row.scene for row in rows)]
    harmful = [pair for pair in setbacks(rows) if pair[1].method in names]
    answer = ANSWER.format(
        counted=1e3 * COUNTED, count=len(pairs),
        gauss=sum(row is not None and row.method.startswith("gauss") for row in best),
        midpoint=sum(row is not None and "midpoint" in row.method for row in best),
        extrapolated=sum(row is not None and row.method in names for row in best),
        least=1e3 * min(left, default=math.nan), most=1e3 * max(left, default=math.nan),
    )  # fmt: skip
    body = BODY.format(
        picture=picture(MESSAGE, PICTURE),
        table="\n".join(_table(rows, [pair for pair in pairs if MESH in pair[1]])),
        setbacks=len(harmful), rows=len(rows), methods=len(methods_of(rows)), missing=_missing(rows),
    )  # fmt: skip
    return screen("Speed against accuracy", QUESTION, answer, body, files, "work_precision")


def _missing(rows: Sequence[PrecisionRow]) -> str:
    """Return the methods of fixed steps without rows as text."""
    names = [f"`{name}`" for name in fixed_step_methods() if name not in methods_of(rows)]
    return f"without {' and '.join(names)}" if names else "all methods of fixed steps"


def _table(rows: Sequence[PrecisionRow], pairs: Sequence[tuple[str, str]]) -> list[str]:
    """Return the table of the cheapest method within each time error."""
    cells = [(scene, model, *(_cell(_best(rows, scene, model, error)) for error in ERRORS)) for scene, model in pairs]
    return markdown_table(("scene", "model", *(f"{1e3 * error:g} mm" for error in ERRORS)), cells)


def _cell(row: PrecisionRow | None) -> str:
    return "none" if row is None else f"{row.method}: {1e3 * row.cpu:.3g}"


def _best(rows: Sequence[PrecisionRow], scene: str, model: str, error: float) -> PrecisionRow | None:
    """Return the cheapest run of a model in a scene within a time error (m)."""
    mine = [row for row in rows if row.scene == scene]
    every = [cheapest(mine, model, method, error) for method in methods_of(mine)]
    return min((row for row in every if row is not None), key=lambda row: row.cpu, default=None)


def _least(rows: Sequence[PrecisionRow], scene: str, model: str) -> float:
    """Return the smallest total error of a model in a scene, m; infinite without a run."""
    errors = [row.total_error for row in rows if (row.scene, row.model) == (scene, model)]
    return min((error for error in errors if error is not None), default=math.inf)


def compute(
    reference: Path, quick: bool = False, workers: Workers | int = 1, kept: Path | None = None
) -> tuple[list[PrecisionRow], list[Floor]]:
    """Return the rows of all runs and the errors of the reference solutions, or those of a small grid of a short scene.

    Args:
        reference: folder of the reference scenes and solutions.
        quick: compute only the small grid.
        workers: see `common.parallel.parallel_map`.
        kept: folder of finished cells, see `common.parallel.parallel_map`.
    """
    cells = [("", "", "")] if quick else [(str(reference), case.name, model) for case in cases(reference)
                                          for model in choices(case.scene)]  # fmt: skip
    rows: list[PrecisionRow] = []
    floors: dict[tuple[str, str], Floor] = {}
    for done in parallel_map(_computed, cells, workers, kept, compile_kernels):
        rows += [PrecisionRow(**row) for row in done["rows"]]
        floors |= {(each["scene"], each["model"]): Floor(**each) for each in done["floors"]}
    return rows, list(floors.values())


def _computed(cell: tuple[str, str, str]) -> dict[str, Any]:
    """Return rows and floors of a cell (reference folder, scene, model) as plain data; no scene: the quick study."""
    reference, scene, model = cell
    result, timed = _known_study(reference, scene)
    rows = grid(result, timed, [model]) if scene else quick_grid(result)
    return {"rows": [asdict(row) for row in rows], "floors": [asdict(floor) for floor in reference_floors(result)]}


@cache
def _known_study(reference: str, scene: str) -> tuple[PrecisionScene, tuple[str, ...]]:
    """Return a study and the models with studied time error, cached per process."""
    if not scene:
        return quick_study(), ()
    case = next(case for case in cases(Path(reference)) if case.name == scene)
    return study(case, Path(reference)), case.timed

"""Precision, files: what the study leaves in a folder, and the pictures and the page made from it."""

from dataclasses import asdict
from functools import cache
from pathlib import Path
from typing import Any

from flexman_gym.evaluation.grid import Workers, gathered
from studies.precision.cases import cases, choices, grid, quick_grid, quick_study, study
from studies.precision.charts import time_error_chart, total_error_chart
from studies.precision.measure import Floor, Row, Study
from studies.precision.page import page, pictures
from studies.table import read_rows, write_rows

ROWS, FLOORS, PAGE = "work_precision.csv", "work_precision_truths.csv", "work_precision.md"


def compute(
    reference: Path, folder: Path, quick: bool = False, workers: Workers | int = 1, kept: Path | None = None
) -> None:
    """Computes all rows, or a small grid of one short scene, and writes them and the errors of the truths.

    `reference` is the folder of the reference scenes and solutions; `workers` and `kept` as of `grid.spread`.
    """
    cells = [("", "", "")] if quick else [(str(reference), case.name, model) for case in cases(reference)
                                          for model in choices(case.scene)]  # fmt: skip
    rows: list[Row] = []
    floors: dict[tuple[str, str], Floor] = {}
    for done in gathered(computed, cells, workers, kept):
        rows += [Row(**row) for row in done["rows"]]
        floors |= {(each["scene"], each["model"]): Floor(**each) for each in done["floors"]}
    write_rows(rows, folder / ROWS)
    write_rows(list(floors.values()), folder / FLOORS)


def computed(cell: tuple[str, str, str]) -> dict[str, Any]:
    """Rows of a model of a scene, and the errors of the scene's truths, as plain data; of no scene the quick study."""
    reference, scene, model = cell
    result, timed = known_study(reference, scene)
    rows = grid(result, timed, [model]) if scene else quick_grid(result)
    return {"rows": [asdict(row) for row in rows], "floors": [asdict(floor) for floor in result.floors()]}


@cache
def known_study(reference: str, scene: str) -> tuple[Study, tuple[str, ...]]:
    """A study and the names of the models whose time error is studied; a process works its truths out once."""
    if not scene:
        return quick_study(), ()
    case = next(case for case in cases(Path(reference)) if case.name == scene)
    return study(case, Path(reference)), case.timed


def publish(folder: Path) -> None:
    """Draws what is in the files, and writes the page. Without Matplotlib there are no pictures."""
    rows, floors = read_rows(folder / ROWS, Row), read_rows(folder / FLOORS, Floor)
    for scene in dict.fromkeys(row.scene for row in rows):
        mine = [row for row in rows if row.scene == scene]
        total, *timed = (floor for floor in floors if floor.scene == scene)
        files = [folder / name for name in pictures(scene)]
        try:
            time_error_chart(mine, {each.model: each.floor for each in timed}, f"Time error: {total.title}", files[0])
            total_error_chart(mine, total.floor, f"Total error: {total.title}", files[1])
        except ImportError as error:
            print(f"no pictures: {error}")
    (folder / PAGE).write_text(page(rows, floors), encoding="utf-8")

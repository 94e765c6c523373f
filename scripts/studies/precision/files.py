"""Precision, files: what the study leaves in a folder, and the pictures and the page made from it."""

from pathlib import Path
from time import process_time

from studies.precision.cases import cases, grid, quick_grid, quick_study, study
from studies.precision.charts import time_error_chart, total_error_chart
from studies.precision.measure import Floor, Row
from studies.precision.page import page, pictures
from studies.table import read_rows, write_rows

ROWS, FLOORS, PAGE = "work_precision.csv", "work_precision_truths.csv", "work_precision.md"


def compute(reference: Path, folder: Path, quick: bool = False) -> None:
    """Computes all rows, or a small grid of one short scene, and writes them and the errors of the truths.

    `reference` is the folder of the reference scenes and solutions.
    """
    rows: list[Row] = []
    floors: list[Floor] = []
    for case in [None] if quick else cases(reference):
        started = process_time()
        result = quick_study() if case is None else study(case, reference)
        known = len(rows)
        rows += quick_grid(result) if case is None else grid(result, case.timed)
        floors += result.floors()
        print(f"{result.name}: {len(rows) - known} rows, {process_time() - started:.0f} s of CPU", flush=True)
        write_rows(rows, folder / ROWS)
        write_rows(floors, folder / FLOORS)


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

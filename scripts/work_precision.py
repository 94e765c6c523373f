"""Charts error against cost of all methods and models: python scripts/work_precision.py --folder docs"""

import argparse
import warnings
from pathlib import Path
from time import process_time

from flexman_gym.studies.precision.cases import cases, grid, quick_grid, quick_study, study
from flexman_gym.studies.precision.charts import time_error_chart, total_error_chart
from flexman_gym.studies.precision.measure import Floor, Row
from flexman_gym.studies.precision.page import page, pictures
from flexman_gym.studies.table import read_rows, write_rows

REFERENCE = Path(__file__).parents[1] / "tests" / "reference"
ROWS, FLOORS, PAGE = "work_precision.csv", "work_precision_truths.csv", "work_precision.md"


def compute(quick: bool, folder: Path) -> None:
    """Computes all rows, or a small grid of one short scene, and writes them and the errors of the truths."""
    rows: list[Row] = []
    floors: list[Floor] = []
    for case in [None] if quick else cases(REFERENCE):
        started = process_time()
        found = quick_study() if case is None else study(case, REFERENCE)
        known = len(rows)
        rows += quick_grid(found) if case is None else grid(found, case.timed)
        floors += found.floors()
        print(f"{found.name}: {len(rows) - known} rows, {process_time() - started:.0f} s of CPU", flush=True)
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


def main() -> None:
    """Reads the command line; computes, draws and writes."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="a small grid of one short scene")
    parser.add_argument("--redraw", action="store_true", help="only draw and write about the rows of an earlier run")
    parser.add_argument("--folder", type=Path, default=Path("out"), help="where rows, pictures and page go")
    options = parser.parse_args()
    warnings.filterwarnings("ignore", "Link.second_moment_y", UserWarning)  # of the paper's printed area of link 1
    options.folder.mkdir(parents=True, exist_ok=True)
    if not options.redraw:
        compute(options.quick, options.folder)
    publish(options.folder)


if __name__ == "__main__":
    main()

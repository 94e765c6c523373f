"""Train and evaluate the recipes, and ablate the settings of one."""

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from flexman_gym.common.computer import computer_text
from flexman_gym.common.parallel import Workers
from studies.files import folder, read_comment, read_rows, write_rows
from studies.learning.measure import (
    LearningCase,
    LearningRow,
    Point,
    cases,
    controllers,
    pictures,
    points,
    run_folder,
    runs,
    tasks,
)
from studies.learning.page import page
from studies.results import Results

ALONE = {"controllers": controllers, "tasks": tasks}  # cases without training
CURVES = "learning_curves.csv"


def main() -> int:
    """Train and evaluate the selected cases and write rows and page; return the exit code."""
    known = {f"{case.kind}/{case.name}": case for case in cases()}
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("case", nargs="*", help=f"cases to run, from {', '.join([*ALONE, *known])}; default: all")
    parser.add_argument("--redraw", action="store_true", help="write the page from the rows of an earlier run")
    parser.add_argument("--runs", type=folder, default="runs/learning", help="folder of the training runs")
    parser.add_argument("--folder", type=folder, default="docs", help="folder of the page and of evidence/, the rows")
    Workers.arguments(parser)
    options = parser.parse_args()
    evidence = folder(str(options.folder / "evidence"))
    if unknown := sorted(set(options.case) - {*ALONE, *known}):
        print(f"case: {unknown[0]} is not allowed; give {', '.join([*ALONE, *known])}", file=sys.stderr)
        return 2
    for name in () if options.redraw else options.case or [*known, *ALONE]:
        result = []
        for row in ALONE[name]() if name in ALONE else runs(known[name], options.runs, Workers.of(options)):
            print(row, flush=True)
            result.append(row)
        _keep(result, evidence / "learning.csv")
        if name in known and known[name].kind == "recipe":
            _keep(_curves(known[name], options.runs), evidence / CURVES)
    file = evidence / "learning.csv"
    if (evidence / CURVES).is_file():
        pictures(read_rows(evidence / CURVES, Point), evidence)
    text = page(read_rows(file, LearningRow), read_comment(file), Results())
    (options.folder / "results.md").write_text(text, encoding="utf-8")
    return 0


def _curves(case: LearningCase, folder: Path) -> list[Point]:
    """Return the learning curves of all seeds of a recipe."""
    return [point for seed in range(case.seeds) for point in points(case.name, seed, run_folder(case, folder, seed))]


def _keep(result: Sequence[LearningRow] | Sequence[Point], file: Path) -> None:
    """Write rows to a file and keep its rows of other cases."""
    own, kind = {_case(row) for row in result}, type(result[0])
    others = [row for row in read_rows(file, kind) if _case(row) not in own] if file.exists() else []
    write_rows([*others, *result], file, comment=computer_text(("stable-baselines3", "torch")))


def _case(row: LearningRow | Point) -> tuple[str, str]:
    return getattr(row, "kind", "recipe"), row.name


if __name__ == "__main__":
    sys.exit(main())

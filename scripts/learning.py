"""Trains the recipes and judges them: what they reach, and what each of their means contributes."""

import argparse
import sys
from pathlib import Path

from flexman_gym.evaluation.grid import Workers
from flexman_gym.verification.machine import machine_text
from studies.learning.cases import cases
from studies.learning.measure import Row, controllers, runs
from studies.learning.page import page
from studies.places import folder
from studies.table import read_comment, read_rows, write_rows

CONTROLLERS = "controllers"


def main() -> int:
    """Reads the command line, trains, judges, and writes rows and page; returns the exit code."""
    known = {f"{case.kind}/{case.name}": case for case in cases()}
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("case", nargs="*", help=f"{CONTROLLERS}, or some of {', '.join(known)}; without it all")
    parser.add_argument("--redraw", action="store_true", help="only write about the rows of an earlier run")
    parser.add_argument("--runs", type=folder, default="runs/learning", help="where the runs are kept")
    parser.add_argument("--folder", type=folder, default="docs", help="where rows and page go")
    Workers.arguments(parser)
    options = parser.parse_args()
    if unknown := sorted(set(options.case) - {CONTROLLERS, *known}):
        print(f"case: {unknown[0]} is not allowed; give {CONTROLLERS}, {', '.join(known)}", file=sys.stderr)
        return 2
    for name in () if options.redraw else options.case or [CONTROLLERS, *known]:
        result = []
        for row in controllers() if name == CONTROLLERS else runs(known[name], options.runs, Workers.of(options)):
            print(row, flush=True)
            result.append(row)
        _keep(result, options.folder / "learning.csv")
    file = options.folder / "learning.csv"
    (options.folder / "learning.md").write_text(page(read_rows(file, Row), read_comment(file)), encoding="utf-8")
    return 0


def _keep(result: list[Row], file: Path) -> None:
    """Writes rows beside those of other cases that are there already."""
    own = {(row.kind, row.name) for row in result}
    others = [row for row in read_rows(file, Row) if (row.kind, row.name) not in own] if file.exists() else []
    write_rows(others + result, file, comment=machine_text(("stable-baselines3", "torch")))


if __name__ == "__main__":
    sys.exit(main())

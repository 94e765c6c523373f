"""Judges the choices of `choose_model`: are they right, do they know their errors, and are they cheap?"""

import argparse

from studies.fidelity.cases import open_scenes, scenes
from studies.fidelity.measure import Row, rows
from studies.fidelity.page import page
from studies.places import folder
from studies.table import read_rows, write_rows

DIGITS = 9


def main() -> None:
    """Reads the command line, measures, and writes rows and page."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--redraw", action="store_true", help="only write about the rows of an earlier run")
    parser.add_argument("folder", nargs="?", type=folder, default="docs", help="where rows and page go")
    options = parser.parse_args()
    files = {"fidelity.csv": scenes(), "fidelity_open.csv": open_scenes()}
    for file, cases in files.items() if not options.redraw else ():
        result: list[Row] = []
        for name, scene in cases.items():
            for row in rows(name, scene):
                print(row, flush=True)
                result.append(row)
        write_rows(result, options.folder / file, DIGITS)
    known = [read_rows(options.folder / file, Row) if (options.folder / file).exists() else [] for file in files]
    (options.folder / "fidelity.md").write_text(page(*known), encoding="utf-8")


if __name__ == "__main__":
    main()

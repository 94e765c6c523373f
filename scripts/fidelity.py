"""Judges the choices of `choose_model`: are they right, do they know their errors, and are they cheap?"""

import argparse

from flexman_gym.studies.fidelity.cases import scenes
from flexman_gym.studies.fidelity.measure import Row, rows
from flexman_gym.studies.fidelity.page import page
from flexman_gym.studies.places import folder
from flexman_gym.studies.table import read_rows, write_rows

DIGITS = 9


def main() -> None:
    """Reads the command line, measures, and writes rows and page."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--redraw", action="store_true", help="only write about the rows of an earlier run")
    parser.add_argument("folder", nargs="?", type=folder, default="docs", help="where rows and page go")
    options = parser.parse_args()
    file, found = options.folder / "fidelity.csv", []
    for name, scene in () if options.redraw else scenes().items():
        for row in rows(name, scene):
            print(row, flush=True)
            found.append(row)
    if found:
        write_rows(found, file, DIGITS)
    (options.folder / "fidelity.md").write_text(page(read_rows(file, Row)), encoding="utf-8")


if __name__ == "__main__":
    main()

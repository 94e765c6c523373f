"""Measure the safety filter with agents, conditions and limits."""

import argparse

from flexman_gym.common.computer import computer_text
from studies.evidence import ROOT
from studies.files import folder, read_comments, read_rows, write_rows
from studies.readme import replaced_part
from studies.safety.learning import LearningRow, learning_rows
from studies.safety.measure import CELLS, SafetyRow, row
from studies.safety.page import cells, page

PAGE = ROOT / "docs" / "safety.md"  # has a table of the rows


def main() -> None:
    """Run the study and write rows and page."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--redraw", action="store_true", help="write the page from the rows of an earlier run")
    parser.add_argument("--folder", type=folder, default="out", help="output folder of rows and page")
    parser.add_argument("--kept", type=folder, default="out/safety", help="folder of finished parts, for a resumption")
    options = parser.parse_args()
    file, learning = options.folder / "safety.csv", options.folder / "safety_learning.csv"
    if not options.redraw:
        write_rows([row(cell, options.kept) for cell in CELLS], file, 4, computer_text())
        write_rows(list(learning_rows(options.kept)), learning, 4, computer_text())
    rows, files = read_rows(file, SafetyRow), read_comments(file, learning)
    (options.folder / "safety.md").write_text(page(rows, read_rows(learning, LearningRow), files), encoding="utf-8")
    PAGE.write_text(replaced_part(PAGE.read_text(encoding="utf-8"), "cells", cells(rows)), encoding="utf-8")


if __name__ == "__main__":
    main()

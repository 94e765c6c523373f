"""Compute robust controllers of a published arm."""

import argparse

from flexman_gym.common.computer import computer_text
from studies.files import folder, read_comments, read_rows, write_rows
from studies.robust.measure import RobustRow, rows
from studies.robust.page import page


def main() -> None:
    """Run the study and write rows and page."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--redraw", action="store_true", help="write the page from the rows of an earlier run")
    parser.add_argument("--folder", type=folder, default="out", help="output folder of rows and page")
    options = parser.parse_args()
    file = options.folder / "robust.csv"
    if not options.redraw:
        write_rows(list(rows()), file, 4, computer_text())
    text = page(read_rows(file, RobustRow), read_comments(file))
    (options.folder / "robust.md").write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()

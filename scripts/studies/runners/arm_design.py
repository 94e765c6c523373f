"""Compute designs of the paper's arm."""

import argparse

from flexman_gym.common.computer import computer_text
from studies.arm_design.measure import DesignRow, ProfileRow, rows
from studies.arm_design.page import draw, page
from studies.files import folder, read_comments, read_rows, write_rows


def main() -> None:
    """Run the study and write rows, page and chart."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--redraw", action="store_true", help="write page and chart from the rows of an earlier run")
    parser.add_argument("--folder", type=folder, default="out", help="output folder of rows, page and chart")
    options = parser.parse_args()
    files = options.folder / "arm_design.csv", options.folder / "arm_design_profiles.csv"
    if not options.redraw:
        results, shapes = rows()
        write_rows(results, files[0], 6, computer_text())
        write_rows(shapes, files[1], 6, computer_text())
    designs, profiles = read_rows(files[0], DesignRow), read_rows(files[1], ProfileRow)
    draw(profiles, options.folder)
    (options.folder / "arm_design.md").write_text(page(designs, profiles, read_comments(*files)), encoding="utf-8")


if __name__ == "__main__":
    main()

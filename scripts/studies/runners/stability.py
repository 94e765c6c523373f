"""Measure stability limits and numerical damping of all methods."""

import argparse
import sys
import warnings
from pathlib import Path
from time import perf_counter

from flexman_gym.common.computer import computer_text
from flexman_gym.common.parallel import Workers
from studies.files import folder, read_comments, read_rows, write_rows
from studies.stability.measure import StabilityRow
from studies.stability.page import page, summary
from studies.stability.rows import all_rows

DIGITS = 9


def main() -> int:
    """Run the study, print a summary and write the requested files."""
    parser = argparse.ArgumentParser(description="Measure stability limits and numerical damping of all methods.")
    parser.add_argument(
        "--quick", action="store_true", help="run a small grid, which takes less than 30 s after compilation"
    )
    parser.add_argument("--csv", type=Path, help="output file of the rows")
    parser.add_argument("--folder", type=folder, help="output folder of rows, plot and page")
    parser.add_argument("--rows", type=Path, help="read the rows from this file instead of measuring")
    parser.add_argument("--kept", type=Path, help="folder of finished cells, from which an interrupted study resumes")
    Workers.arguments(parser)
    options = parser.parse_args()
    if options.quick and options.folder:
        parser.error("--folder: the page needs all rows; omit --quick")
    warnings.filterwarnings(
        "ignore", "Link.second_moment_y", UserWarning
    )  # raised by the printed area of link 1 of the paper
    started = perf_counter()
    result = (
        read_rows(options.rows, StabilityRow)
        if options.rows
        else all_rows(options.quick, Workers.of(options), options.kept)
    )
    print(summary(result))
    print(f"{perf_counter() - started:.0f} s")
    if options.csv:
        write_rows(result, options.csv, DIGITS, computer_text())
    if options.folder:
        from studies.stability.charts import draw

        options.folder.mkdir(parents=True, exist_ok=True)
        file = options.rows or options.folder / "stability.csv"
        if not options.rows:
            write_rows(result, file, DIGITS, computer_text())
        result = read_rows(file, StabilityRow)
        draw(result, options.folder)
        (options.folder / "stability.md").write_text(page(result, read_comments(file)), encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())

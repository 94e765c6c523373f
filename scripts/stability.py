"""Measure where each method fails, and what it damps: python scripts/stability.py --folder docs"""

import argparse
import sys
import warnings
from pathlib import Path
from time import perf_counter

from flexman_gym.common.computer import computer_text
from flexman_gym.common.parallel import Workers
from studies.files import folder, read_comment, read_rows, write_rows
from studies.stability.measure import StabilityRow
from studies.stability.page import page, summary
from studies.stability.rows import all_rows

DIGITS = 9


def main() -> int:
    """Read the command line, print a summary and write the chosen files."""
    parser = argparse.ArgumentParser(description="Measure where each method fails, and what it damps.")
    parser.add_argument("--quick", action="store_true", help="a small grid, less than 30 s once compiled")
    parser.add_argument("--csv", type=Path, help="file for the rows")
    parser.add_argument("--folder", type=folder, help="folder for rows, pictures and page: stability.csv, *.png, *.md")
    parser.add_argument("--rows", type=Path, help="take the rows from this file instead of measuring")
    parser.add_argument("--kept", type=Path, help="folder for cells that are done, from which a killed study goes on")
    Workers.arguments(parser)
    options = parser.parse_args()
    if options.quick and options.folder:
        parser.error("--folder: the page needs all rows; leave --quick out")
    warnings.filterwarnings("ignore", "Link.second_moment_y", UserWarning)  # of the paper's printed area of link 1
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
        (options.folder / "stability.md").write_text(page(read_comment(file), result), encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())

"""Compute the full verification table."""

import argparse
import sys
import warnings

from flexman_gym.common.computer import computer_text
from flexman_gym.toolbox.verification.papers import paper_tables
from flexman_gym.toolbox.verification.table import VerificationRow, VerificationTable
from studies.files import folder, read_comments, read_rows, write_rows
from studies.verification.motions import REFERENCE, rows
from studies.verification.page import page
from studies.verification.papers import page as page_of_papers

FILE = "verification.csv"
PAPERS = ("printed", "computed")


def main() -> int:
    """Print the verification table and write rows and page; return 1 if a row fails."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="skip the motions that take minutes")
    parser.add_argument("--redraw", action="store_true", help="write the page from the rows of an earlier run")
    parser.add_argument("--folder", type=folder, default="out", help="output folder of rows and page")
    options = parser.parse_args()
    warnings.filterwarnings(
        "ignore", "Link.second_moment_y", UserWarning
    )  # raised by the printed area of link 1 of the paper
    file = options.folder / FILE
    if not options.redraw:
        write_rows(rows(REFERENCE, options.quick), file, 12, computer_text())
        for name, table in paper_tables().items():
            write_rows(table, options.folder / f"papers_{name}.csv", 12, computer_text())
    result = VerificationTable(read_rows(file, VerificationRow))
    print(result)
    (options.folder / "verification.md").write_text(page(result, read_comments(file)), encoding="utf-8")
    tables = [read_rows(options.folder / f"papers_{name}.csv", VerificationRow) for name in PAPERS]
    (options.folder / "papers.md").write_text(page_of_papers(*tables), encoding="utf-8")
    return result.exit_code


if __name__ == "__main__":
    sys.exit(main())

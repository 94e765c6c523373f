"""Verifies the simulator against closed forms and independent solutions: python scripts/verify.py --quick"""

import argparse
import sys
import warnings
from pathlib import Path
from time import perf_counter

from flexman_gym.studies.verification.cases import rows
from flexman_gym.studies.verification.page import as_json, page, table
from flexman_gym.studies.verification.rows import exit_code

REFERENCE = Path(__file__).parents[1] / "tests" / "reference"


def main() -> int:
    """Reads the command line and prints one table; returns 1 when a row fails."""
    parser = argparse.ArgumentParser(description="Compare the simulator with values that are known from elsewhere.")
    parser.add_argument("--quick", action="store_true", help="only what takes less than 30 s once compiled")
    parser.add_argument("--json", type=Path, help="file for the rows")
    parser.add_argument("--markdown", type=Path, help="file for the table as a page")
    parser.add_argument("--reference", type=Path, default=REFERENCE, help="folder of the reference solutions")
    options = parser.parse_args()
    if not options.reference.is_dir():
        parser.error(f"--reference: {options.reference} is not allowed; give the folder of the reference solutions")
    warnings.filterwarnings("ignore", "Link.second_moment_y", UserWarning)  # of the paper's printed area of link 1
    started = perf_counter()
    result = rows(options.reference, options.quick)
    print(table(result))
    print(f"{perf_counter() - started:.0f} s")
    for file, text in ((options.json, as_json), (options.markdown, page)):
        if file is not None:
            file.write_text(text(result), encoding="utf-8")
    return exit_code(result)


if __name__ == "__main__":
    sys.exit(main())

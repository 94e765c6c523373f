"""Compute the full verification table: python scripts/verification.py --folder docs/evidence"""

import argparse
import sys
import warnings

from flexman_gym.verification.table import exit_code, format_table
from studies.files import folder
from studies.verification.motions import REFERENCE, rows
from studies.verification.page import markdown_page


def main() -> int:
    """Print the verification table and write its page; return 1 if a row fails."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="skip the motions that take minutes")
    parser.add_argument("--folder", type=folder, default="out", help="output folder of the page")
    options = parser.parse_args()
    warnings.filterwarnings(
        "ignore", "Link.second_moment_y", UserWarning
    )  # raised by the printed area of link 1 of the paper
    result = rows(REFERENCE, options.quick)
    print(format_table(result))
    (options.folder / "verification.md").write_text(markdown_page(result), encoding="utf-8")
    return exit_code(result)


if __name__ == "__main__":
    sys.exit(main())

"""Measure the safety filter with agents, conditions and limits: python scripts/safety.py --folder docs/evidence"""

import argparse
from pathlib import Path

from flexman_gym.common.computer import computer_text
from studies.files import folder, write_rows
from studies.safety.measure import CELLS, row


def main() -> None:
    """Run the study and write rows and page."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--redraw", action="store_true", help="write the page from the rows of an earlier run")
    parser.add_argument("--folder", type=folder, default="out", help="output folder of rows and page")
    parser.add_argument("--kept", type=folder, default="out/safety", help="folder of finished parts, for a resumption")
    options = parser.parse_args()
    file: Path = options.folder / "safety.csv"
    if not options.redraw:
        result = []
        for cell in CELLS:
            result.append(row(cell, options.kept))
            print(result[-1], flush=True)
        write_rows(result, file, 4, computer_text())


if __name__ == "__main__":
    main()

"""Measures how much gain servos bear: python scripts/servos.py --folder docs"""

import argparse
import warnings

from flexman_gym.verification.machine import machine_text
from studies.places import folder
from studies.servos.friction import FrictionRow, friction_rows
from studies.servos.measure import Row, rows
from studies.servos.page import page
from studies.table import read_comment, read_rows, write_rows


def main() -> None:
    """Reads the command line, measures, and writes rows and a page."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--redraw", action="store_true", help="only write about the rows of an earlier run")
    parser.add_argument("--folder", type=folder, default="out", help="where rows and page go")
    options = parser.parse_args()
    file, rubbing = options.folder / "servos.csv", options.folder / "servos_friction.csv"
    if not options.redraw:
        warnings.filterwarnings("ignore", "actions: a servo", UserWarning)  # which is what is looked for
        write_rows(list(rows()), file, 6, machine_text())
        write_rows(list(friction_rows()), rubbing, 12, machine_text())
    text = page(read_comment(file), read_rows(file, Row), read_rows(rubbing, FrictionRow))
    (options.folder / "servos.md").write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()

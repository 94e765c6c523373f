"""Compute gain limits of joint servos."""

import argparse
import warnings

from flexman_gym.common.computer import computer_text
from studies.files import folder, read_comments, read_rows, write_rows
from studies.servos.measure import FrictionRow, ServoRow, friction_rows, rows
from studies.servos.page import page


def main() -> None:
    """Run the study and write rows and page."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--redraw", action="store_true", help="write the page from the rows of an earlier run")
    parser.add_argument("--folder", type=folder, default="out", help="output folder of rows and page")
    options = parser.parse_args()
    file, rubbing = options.folder / "servos.csv", options.folder / "servos_friction.csv"
    if not options.redraw:
        warnings.filterwarnings("ignore", "actions: a servo", UserWarning)  # unstable servos are intended here
        write_rows(list(rows()), file, 6, computer_text())
        write_rows(list(friction_rows()), rubbing, 12, computer_text())
    text = page(read_rows(file, ServoRow), read_rows(rubbing, FrictionRow), read_comments(file, rubbing))
    (options.folder / "servos.md").write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()

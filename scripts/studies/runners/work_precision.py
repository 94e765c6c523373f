"""Plot work-precision diagrams of all methods and models."""

import argparse
import warnings
from pathlib import Path

from flexman_gym.common.parallel import Workers
from studies.files import folder
from studies.precision.page import compute, publish
from studies.verification.motions import REFERENCE


def main() -> None:
    """Run the study and write rows, plots and page."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="run a small grid of one short scene")
    parser.add_argument("--redraw", action="store_true", help="draw plots and page from the rows of an earlier run")
    parser.add_argument("--folder", type=folder, default="out", help="output folder of rows, plots and page")
    parser.add_argument("--kept", type=Path, help="folder of finished cells, from which an interrupted study resumes")
    Workers.arguments(parser)
    options = parser.parse_args()
    warnings.filterwarnings(
        "ignore", "Link.second_moment_y", UserWarning
    )  # raised by the printed area of link 1 of the paper
    options.folder.mkdir(parents=True, exist_ok=True)
    if not options.redraw:
        compute(REFERENCE, options.folder, options.quick, Workers.of(options), options.kept)
    publish(options.folder)


if __name__ == "__main__":
    main()

"""Compare our model with a real two-link flexible arm."""

import argparse
from pathlib import Path

from flexman_gym.common.computer import computer_text
from studies.files import folder, read_comments, read_rows, write_rows
from studies.machine.measure import DATA, FitRow, coverage, stage_1, stages
from studies.machine.page import draw, page


def main() -> None:
    """Fit the model to the measurements and write rows, plots and page."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument(
        "--data", type=Path, default=DATA, help="folder of the single-stage runs, for example lqg_10deg.csv"
    )
    parser.add_argument("--stages", type=Path, help="record of both stages; default: two_stages.csv in the data folder")
    parser.add_argument("--redraw", action="store_true", help="write the page from the rows of an earlier run")
    parser.add_argument("--folder", type=folder, default="out", help="output folder of rows, plots and page")
    parser.add_argument(
        "--made-up",
        type=int,
        metavar="DRAWS",
        help="only fit this number of noisy records of each of 30 random simulated arms",
    )
    options = parser.parse_args()
    if options.made_up:
        part, known, unknown = coverage(30, options.made_up)
        print(
            f"{part:.1%} of {known} estimates are within two standard deviations of the true value; "
            f"{unknown} are reported as undetermined"
        )
        return
    file = options.folder / "machine.csv"
    if not options.redraw:
        rows, lines = stage_1(options.data)
        more = stages(options.stages or options.data / "two_stages.csv")
        write_rows([*rows, *more], file, comment=computer_text(("mujoco",)))
        draw(lines, options.folder)
    text = page(read_rows(file, FitRow), read_comments(file))
    (options.folder / "machine.md").write_text(text, encoding="utf-8")
    print(text)


if __name__ == "__main__":
    main()

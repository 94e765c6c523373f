"""Compare our model with a real two-link flexible arm: python scripts/machine.py --folder docs"""

import argparse
from pathlib import Path

from flexman_gym.common.computer import computer_text
from studies.files import folder, write_rows
from studies.machine.measure import DATA, coverage, stage_1, stages
from studies.machine.page import draw, page


def main() -> None:
    """Read the command line, fit, and write rows, pictures and a page."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--data", type=Path, default=DATA, help="folder of the runs, such as lqg_10deg.csv")
    parser.add_argument("--stages", type=Path, help="a record of both stages; two_stages.csv of the data without one")
    parser.add_argument("--folder", type=folder, default="out", help="where rows, pictures and page go")
    parser.add_argument(
        "--made-up", type=int, metavar="DRAWS", help="only fits to so many noisy draws of 30 made-up arms"
    )
    options = parser.parse_args()
    if options.made_up:
        part, known, unknown = coverage(30, options.made_up)
        print(f"{part:.1%} of {known} numbers are within two deviations of the truth; {unknown} are told to be unknown")
        return
    rows, lines = stage_1(options.data)
    more, told = stages(options.stages or options.data / "two_stages.csv")
    write_rows([*rows, *more], options.folder / "machine.csv", comment=computer_text(("mujoco",)))
    draw(lines, told, options.folder)
    text = page([*rows, *more], computer_text(("mujoco",)))
    (options.folder / "machine.md").write_text(text, encoding="utf-8")
    print(text)


if __name__ == "__main__":
    main()

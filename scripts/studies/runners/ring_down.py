"""Measure errors of integration methods on released vibrations."""

import argparse

from flexman_gym.common.computer import computer_text
from flexman_gym.envs.config.configuration import Configuration
from flexman_gym.envs.config.fidelity import resolve_fidelity
from studies.files import folder, read_comments, read_rows, write_rows
from studies.ringdown.measure import Errors, RingDownRow, errors_of_default, rows
from studies.ringdown.page import TITLES, accuracy_page, draw, page

ARMS, FEW, THEIRS, MANY = 128, 12, 6, 300  # arms per case: batched methods, other methods, MuJoCo, default


def compute(quick: bool) -> list[RingDownRow]:
    """Return the rows of all kinds of motion; `quick` uses a few arms."""
    arms, few, theirs = (2, 1, 1) if quick else (ARMS, FEW, THEIRS)
    result = [row for kind in TITLES for row in rows(kind, arms, few)]
    try:
        from studies.ringdown import mujoco
    except ModuleNotFoundError:
        print("MuJoCo is missing, so it is left out: pip install 'flexman_gym[peers]'")
        return result
    return [*result, *(() if quick else mujoco.rows(theirs))]


def main() -> None:
    """Run the study and write rows, plot and page."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="run a few arms")
    parser.add_argument("--redraw", action="store_true", help="draw plot and page from the rows of an earlier run")
    parser.add_argument("--folder", type=folder, default="out", help="output folder of rows, plot and page")
    parser.add_argument(
        "--default", action="store_true", help="measure only the default and similar methods, on many arms"
    )
    options = parser.parse_args()
    options.folder.mkdir(parents=True, exist_ok=True)
    if options.default:
        file = options.folder / "accuracy.csv"
        if not options.redraw:
            write_rows(errors_of_default(2 if options.quick else MANY), file, 3, computer_text())
        text = accuracy_page(read_rows(file, Errors), read_comments(file))
        (options.folder / "accuracy.md").write_text(text, encoding="utf-8")
        return
    file = options.folder / "ring_down.csv"
    if not options.redraw:
        write_rows(compute(options.quick), file, comment=computer_text())
    chosen, result = resolve_fidelity(Configuration()), read_rows(file, RingDownRow)
    default = str(chosen.method), chosen.step
    draw(result, options.folder, default)
    (options.folder / "ring_down.md").write_text(page(result, default, read_comments(file)), encoding="utf-8")


if __name__ == "__main__":
    main()

"""Benchmark environments, training and other simulators."""

import argparse

from flexman_gym.common.computer import computer_text
from studies.benchmark import measure
from studies.benchmark.page import ROWS_FILE, publish
from studies.files import folder, write_rows

EVALUATION_ROUNDS, PART_ROUNDS, STARTS = 40, 15, 5
PEERS = ("gymnasium", "stable-baselines3", "torch", "mujoco", "pin")


def main() -> None:
    """Run all benchmarks in interleaved rounds and write the rows and the page."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="run a few steps of each benchmark")
    parser.add_argument("--redraw", action="store_true", help="write the page from the rows of an earlier run")
    parser.add_argument("--folder", type=folder, default="out", help="output folder of rows and page")
    options = parser.parse_args()
    options.folder.mkdir(parents=True, exist_ok=True)
    if not options.redraw:
        grid = measure.QUICK if options.quick else measure.Grid()
        rows = measure.environment_rows(grid)
        rows += measure.part_rows(1 if options.quick else PART_ROUNDS)
        rows += measure.start_rows(1 if options.quick else STARTS, cold=not options.quick)
        rows += measure.evaluation_rows(2 if options.quick else EVALUATION_ROUNDS)
        write_rows(rows, options.folder / ROWS_FILE, comment=computer_text(PEERS))
    print(publish(options.folder))


if __name__ == "__main__":
    main()

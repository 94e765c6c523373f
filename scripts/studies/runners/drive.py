"""Measure real-time loops, their faults and a round trip, as root."""

import argparse
from collections.abc import Callable, Sequence
from typing import Any

from flexman_gym.common.computer import computer_text
from studies.drive.measure import (
    FAULT_LOOPS,
    LOOPS,
    UNDISTURBED,
    FaultRow,
    LoopRow,
    RoundTripRow,
    UndisturbedRow,
    conditions,
    measure_faults,
    measure_loop,
    measure_round_trip,
    measure_undisturbed,
)
from studies.drive.page import page
from studies.files import folder, read_comments, read_rows, write_rows

PARTS = ("drive", "drive_faults", "drive_undisturbed", "drive_fits")


def main() -> None:
    """Run the study, or write its page from existing rows."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--folder", type=folder, default="out", help="output folder of rows and page")
    parser.add_argument("--redraw", action="store_true", help="write the page from the rows of an earlier run")
    parser.add_argument("--parts", nargs="+", choices=PARTS, default=PARTS, help="parts to measure")
    parser.add_argument("--episodes", type=int, default=5, metavar="N", help="with priority (default: %(default)s)")
    parser.add_argument("--runs", type=int, default=100, metavar="N", help="undisturbed runs (default: %(default)s)")
    options = parser.parse_args()
    work: dict[str, Callable[[], Sequence[Any]]] = {
        "drive": lambda: [measure_loop(agent, name, each) for agent in LOOPS
                          for name, each in conditions(options.episodes).items()],
        "drive_faults": lambda: [row for agent in FAULT_LOOPS for row in measure_faults(agent)],
        "drive_undisturbed": lambda: [measure_undisturbed(agent, options.runs) for agent in UNDISTURBED],
        "drive_fits": lambda: [measure_round_trip(joint, factor) for joint in range(3) for factor in (0.8, 1.2)],
    }  # fmt: skip
    for name in () if options.redraw else options.parts:
        write_rows(work[name](), options.folder / f"{name}.csv", 4, computer_text())
    files = [options.folder / f"{name}.csv" for name in PARTS]
    loops, faults, undisturbed, fits = files
    text = page(
        read_rows(loops, LoopRow), read_rows(faults, FaultRow), read_rows(undisturbed, UndisturbedRow),
        read_rows(fits, RoundTripRow), read_comments(*files),
    )  # fmt: skip
    (options.folder / "drive.md").write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()

"""Test the fault tolerance of training runs and write its page."""

import argparse
import sys
from pathlib import Path
from tempfile import TemporaryDirectory

from flexman_gym.common.computer import computer_text
from studies.faults import Fault, disk_full, faults, page
from studies.files import folder, read_comments, read_rows, write_rows


def main() -> int:
    """Try all faults and write the page; return 1 if a run loses its results."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--folder", type=folder, default="docs/evidence", help="output folder of the page")
    parser.add_argument("--redraw", action="store_true", help="write the page from the rows of an earlier run")
    parser.add_argument(
        "--kills", type=int, nargs=2, default=(30, 15), help="kills per algorithm during saving and at random times"
    )
    parser.add_argument(
        "--small", type=Path, help="empty file system of a few MB for the test of a full disk; default: skip this test"
    )
    options = parser.parse_args()
    file = options.folder / "faults.csv"
    if not options.redraw:
        write_rows(measured(tuple(options.kills), options.small), file, comment=computer_text(("torch",)))
    result = read_rows(file, Fault)
    (options.folder / "faults.md").write_text(page(result, read_comments(file)), encoding="utf-8")
    return int(any(fault.survived < fault.tried for fault in result))


def measured(kills: tuple[int, int], small: Path | None) -> list[Fault]:
    """Return the results of all faults; `small` is the file system of the test of a full disk, if any."""
    result = []
    with TemporaryDirectory() as place:
        for fault in faults(Path(place), kills):
            print(fault, flush=True)
            result.append(fault)
        if small:
            result.append(disk_full(Path(place), small))
            print(result[-1], flush=True)
    return result


if __name__ == "__main__":
    sys.exit(main())

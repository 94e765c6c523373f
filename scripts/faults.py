"""Test the fault tolerance of training runs and write its page: python scripts/faults.py --folder docs/evidence"""

import argparse
import sys
from pathlib import Path
from tempfile import TemporaryDirectory

from studies.faults import disk_full, faults, page
from studies.files import folder


def main() -> int:
    """Try all faults and write the page; return 1 if a run loses its results."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--folder", type=folder, default="docs/evidence", help="output folder of the page")
    parser.add_argument(
        "--kills", type=int, nargs=2, default=(30, 15), help="kills per algorithm during saving and at random times"
    )
    parser.add_argument(
        "--small", type=Path, help="empty file system of a few MB for the test of a full disk; default: skip this test"
    )
    options = parser.parse_args()
    result = []
    with TemporaryDirectory() as place:
        for fault in faults(Path(place), tuple(options.kills)):
            print(fault, flush=True)
            result.append(fault)
        if options.small:
            result.append(disk_full(Path(place), options.small))
            print(result[-1], flush=True)
    (options.folder / "faults.md").write_text(page(result), encoding="utf-8")
    return int(any(fault.survived < fault.tried for fault in result))


if __name__ == "__main__":
    sys.exit(main())

"""Compare simulations of the paper's arm with other codes: python scripts/compare_peers.py --folder docs/evidence"""

import argparse

from studies.files import folder, read_rows, write_rows
from studies.peers import measure
from studies.peers.measure import in_turns, large_rotation_solution, ours, study, theirs
from studies.peers.page import publish
from studies.precision.measure import PrecisionRow
from studies.verification.motions import REFERENCE

SHOWN = 5  # number of last lines of the page that are printed


def main() -> None:
    """Run all simulators in interleaved rounds and write rows, chart and page."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--redraw", action="store_true", help="draw chart and page from the rows of an earlier run")
    parser.add_argument("--folder", type=folder, default="out", help="output folder of rows, chart and page")
    options = parser.parse_args()
    options.folder.mkdir(parents=True, exist_ok=True)
    file, known = options.folder / "peers.csv", large_rotation_solution(REFERENCE)
    if not options.redraw:
        result = study(known)
        alone = in_turns(ours(result) + theirs(result))
        write_rows(alone + measure.batch_rows(result, alone), file)
    text = publish(read_rows(file, PrecisionRow), known.floor, options.folder)
    print("\n".join(text.splitlines()[-SHOWN:]))


if __name__ == "__main__":
    main()

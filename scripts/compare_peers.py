"""Chart our runs beside those of other codes on the paper's arm: python scripts/compare_peers.py --folder docs"""

import argparse

from studies.files import folder, read_rows, write_rows
from studies.peers import measure
from studies.peers.measure import in_turns, ours, study, theirs, truth
from studies.peers.page import publish
from studies.precision.measure import PrecisionRow
from studies.verification.motions import REFERENCE

SHOWN = 5  # last lines of the page


def main() -> None:
    """Read the command line, run everything in turns, and write rows, a picture and a page."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--redraw", action="store_true", help="only draw and write about the rows of an earlier run")
    parser.add_argument("--folder", type=folder, default="out", help="where rows, picture and page go")
    options = parser.parse_args()
    options.folder.mkdir(parents=True, exist_ok=True)
    file, known = options.folder / "peers.csv", truth(REFERENCE)
    if not options.redraw:
        result = study(known)
        alone = in_turns(ours(result) + theirs(result))
        write_rows(alone + measure.batch_rows(result, alone), file)
    text = publish(read_rows(file, PrecisionRow), known.floor, options.folder)
    print("\n".join(text.splitlines()[-SHOWN:]))


if __name__ == "__main__":
    main()

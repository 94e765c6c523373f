"""Compare simulations of the paper's arm with other codes."""

import argparse

import flexman_gym as fm
from flexman_gym.common.computer import computer_text
from studies.files import folder, read_comments, read_rows, write_rows
from studies.peers import measure
from studies.peers.measure import PEERS, Decay, decays, in_turns, large_rotation_solution, of_peers, ours, study, theirs
from studies.peers.page import publish
from studies.precision.measure import PrecisionRow
from studies.verification.motions import REFERENCE


def main() -> None:
    """Run all simulators in interleaved rounds and write rows, chart and page."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--redraw", action="store_true", help="draw chart and page from the rows of an earlier run")
    parser.add_argument("--folder", type=folder, default="out", help="output folder of rows, chart and page")
    options = parser.parse_args()
    options.folder.mkdir(parents=True, exist_ok=True)
    file, damping = options.folder / "peers.csv", options.folder / "peers_damping.csv"
    known = large_rotation_solution(REFERENCE)
    if not options.redraw:
        result = study(known)
        alone = in_turns(ours(result) + theirs(result))
        comment = computer_text(PEERS.values())
        write_rows(alone + measure.batch_rows(result, alone), file, comment=comment)
        write_rows(list(decays(fm.catalog.paper_rrr(), of_peers(alone))), damping, comment=comment)
    rows, losses = read_rows(file, PrecisionRow), read_rows(damping, Decay)
    print(publish(rows, losses, known.floor, options.folder, read_comments(file, damping)))


if __name__ == "__main__":
    main()

"""Write saved episodes to a web page that replays them side by side."""

import argparse
from pathlib import Path

from flexman_gym.commands import CommandLine, output_file


def _arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command-line arguments."""
    parser.add_argument("episode", nargs="+", type=Path,
                        help="file of flexman evaluate --save or flexman simulate --out")  # fmt: skip
    parser.add_argument(
        "--out", type=output_file, metavar="FILE", default="replay.html", help="page to write (default: %(default)s)"
    )
    parser.add_argument("--title", default="", help="title of the page")


def _run(options: argparse.Namespace) -> int:
    """Write the page; return 0."""
    from flexman_gym.common.files import write_file
    from flexman_gym.simulation.episode import Episode
    from flexman_gym.toolbox.view.replay import replay_page

    text = replay_page([Episode.load(path) for path in options.episode], options.title)
    write_file(options.out, text)
    print(f"{options.out}: {len(text.encode()) / 1e3:.0f} kB; open it in a browser")
    return 0


EXAMPLES = (
    "flexman simulate paper_ff --out ff.npz",
    "flexman replay ff.npz --out ff.html  # opens in a browser",
)
COMMAND = CommandLine(_arguments, _run, EXAMPLES)

"""Replay saved episodes side by side, in one page for any browser."""

import argparse
from pathlib import Path

from flexman_gym.commands import CommandLine


def _arguments(result: argparse.ArgumentParser) -> None:
    """Add the command-line arguments."""
    result.add_argument("run", nargs="+", type=Path, help="a file of flexman evaluate --save or flexman simulate --out")
    result.add_argument("--out", type=Path, default=Path("replay.html"), help="the page")
    result.add_argument("--title", default="", help="of the page")


def _run(options: argparse.Namespace) -> int:
    """Write the page; return 0."""
    from flexman_gym.draw.replay import replay_page
    from flexman_gym.simulation.episode import Episode

    text = replay_page([Episode.load(path) for path in options.run], options.title)
    options.out.parent.mkdir(parents=True, exist_ok=True)
    options.out.write_text(text, encoding="utf-8")
    print(f"{options.out}: {len(text.encode()) / 1e3:.0f} kB; open it in a browser")
    return 0


COMMAND = CommandLine(_arguments, _run)

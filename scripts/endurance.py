"""Takes random steps of many randomised arms, of which none may give a NaN or keep memory."""

import argparse

from flexman_gym.studies.benchmark.endurance import ALLOWED, SETTLED, endure, publish
from flexman_gym.studies.places import folder


def main() -> None:
    """Reads the command line, runs, and writes the section; fails where memory grows."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--steps", type=int, default=10_000_000, help="of all arms together")
    parser.add_argument("--arms", type=int, default=256)
    parser.add_argument("--folder", type=folder, default="out", help="of the page whose section this is")
    options = parser.parse_args()
    count = endure(options.steps, options.arms, min(SETTLED, options.steps))
    options.folder.mkdir(parents=True, exist_ok=True)
    print(publish(count, options.arms, options.folder))
    if count.growth > ALLOWED:
        raise SystemExit(f"memory grew by {count.growth:.1%}")


if __name__ == "__main__":
    main()

"""Tunes the PD controller of a named environment: python scripts/tune.py FlexPlanar-v0"""

import argparse
import sys

from flexman_agents.tuning import tune
from flexman_gym.envs import NAMED


def main() -> int:
    """Reads the command line and prints gains; returns the exit code."""
    parser = argparse.ArgumentParser(description="Search for the gains of a PD controller with the highest reward.")
    parser.add_argument("env", choices=sorted(NAMED))
    parser.add_argument("--seed", type=int, default=0, help="of the search")
    options = parser.parse_args()
    found = tune(options.env, seed=options.seed)
    for name in ("stiffness", "damping"):
        print(f"{name}: {', '.join(f'{gain:.3g}' for gain in getattr(found, name))}")
    print(f"mean reward of 8 episodes: {found.reward:.1f}")
    return 0


if __name__ == "__main__":
    sys.exit(main())

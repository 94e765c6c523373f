"""Evaluates policies side by side on the same episodes: python scripts/evaluate.py runs/first pd zero"""

import argparse
import sys

from flexman_agents.evaluation import BASELINES, evaluate, table


def main() -> int:
    """Reads the command line and prints one table; returns the exit code."""
    parser = argparse.ArgumentParser(description="Evaluate policies on the same episodes of FlexRRR-v0.")
    parser.add_argument("policy", nargs="+", help=f"folder of a training run, or {', '.join(BASELINES)}")
    parser.add_argument("--episodes", type=int, default=20)
    parser.add_argument("--seed", type=int, default=1000, help="of the first episode; the next have the next seeds")
    options = parser.parse_args()
    if options.episodes < 1:
        parser.error(f"--episodes: {options.episodes} is not allowed; give a whole number > 0")
    try:
        results = {name: evaluate(name, options.episodes, options.seed) for name in options.policy}
    except (ValueError, FileNotFoundError) as error:
        print(error, file=sys.stderr)
        return 2
    print(table(results))
    return 0


if __name__ == "__main__":
    sys.exit(main())

"""Evaluates policies side by side on the same episodes: python scripts/evaluate.py runs/first pd zero"""

import argparse
import sys

from flexman_agents.evaluation import changed_environment, common_environment, evaluate, table
from flexman_agents.policies import BASELINES, find_policy
from flexman_agents.seeds import TEST
from flexman_gym.envs import NAMED
from flexman_gym.envs.description import Description


def main() -> int:
    """Reads the command line and prints one table; returns the exit code."""
    parser = argparse.ArgumentParser(description="Evaluate policies on the same episodes of one environment.")
    parser.add_argument("policy", nargs="+", help=f"folder of a training run, or {', '.join(BASELINES)}")
    parser.add_argument("--episodes", type=int, default=len(TEST))
    parser.add_argument("--seed", type=int, default=TEST.start, help="of the first episode; the next follow")
    parser.add_argument("--env", help=f"a file that describes an environment, or one of {', '.join(sorted(NAMED))}; "
                        "without it that of the runs")  # fmt: skip
    parser.add_argument("--set", action="append", default=[], metavar="NAME=VALUE", help="a setting of the environment")
    parser.add_argument("--trust", action="store_true", help="read files of Stable-Baselines3, which can run any code")
    options = parser.parse_args()
    if options.episodes < 1:
        parser.error(f"--episodes: {options.episodes} is not allowed; give a whole number > 0")
    try:
        policies = {name: find_policy(name, options.trust) for name in options.policy}
        named = Description.find(options.env) if options.env else None
        environment = changed_environment(common_environment(list(policies.values()), named), options.set)
        seeds = range(options.seed, options.seed + options.episodes)
        results = {name: evaluate(policy, environment, seeds) for name, policy in policies.items()}
    except (ValueError, OSError) as error:
        print(error, file=sys.stderr)
        return 2
    print(table(results, environment))
    return 0


if __name__ == "__main__":
    sys.exit(main())

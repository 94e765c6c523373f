"""Evaluate policies and controllers on the same episodes."""

import argparse
from pathlib import Path

from flexman_gym.commands import CommandLine, add_options, load_agent


def _arguments(result: argparse.ArgumentParser) -> None:
    """Add the command-line arguments."""
    add_options(result, "entrant", "--episodes", "--seed", "--env", "--set", "--trust", entrant={"nargs": "+"})
    result.add_argument("--save", type=Path, metavar="FOLDER", help="keep each episode there, a file of arrays each")


def _run(options: argparse.Namespace) -> int:
    """Print one table of all agents; return 0."""
    from flexman_gym.envs.config.configuration import Configuration
    from flexman_gym.evaluation import metrics_table, rollout
    from flexman_gym.evaluation.agent import common_environment

    if options.episodes < 1:
        options.parser.error(f"--episodes: {options.episodes} is not allowed; give a whole number > 0")
    named = Configuration.find(options.env) if options.env else None
    entrants = {name: load_agent(name, options.trust, named) for name in options.entrant}
    environment = common_environment(list(entrants.values()), named, options.set)
    seeds = range(options.seed, options.seed + options.episodes)
    results = {name: rollout(each, environment, seeds) for name, each in entrants.items()}
    print(metrics_table({name: each.records for name, each in results.items()}, environment))
    if options.save is not None:
        files = [path for each in results.values() for path in each.save(options.save)]
        print(f"{len(files)} episodes are in {options.save}; see some: flexman replay {files[0]} --out page.html")
    return 0


COMMAND = CommandLine(_arguments, _run)

"""Search for better settings of a recipe, with Optuna."""

import argparse
from pathlib import Path

from flexman_gym.commands import CommandLine


def _arguments(result: argparse.ArgumentParser) -> None:
    """Add the command-line arguments."""
    from flexman_gym.common.parallel import Workers

    result.add_argument("recipe", help="a file of settings, or the name of a recipe")
    result.add_argument("--over", type=Path, required=True, metavar="FILE", help="settings, each with what it may be")
    result.add_argument("--trials", type=int, default=20, help="in all, those of a search that goes on included")
    result.add_argument("--seed", type=int, default=0, help="of the search; the runs keep the recipe's")
    result.add_argument("--folder", type=Path, default=Path("runs/search"), help="of trials; what it has is kept")
    Workers.arguments(result)


def _run(options: argparse.Namespace) -> int:
    """Search and print the path of the best settings; return 0."""
    from flexman_agents.search import search
    from flexman_agents.settings import find_recipe
    from flexman_gym.common import files
    from flexman_gym.common.checks import value_error
    from flexman_gym.common.parallel import Workers

    over = files.read_data(options.over)
    if not isinstance(over, dict) or not over:
        raise value_error("over", str(options.over), "a file with a mapping of settings")
    options_of_search = options.folder, options.trials, Workers.of(options), options.seed
    path = search(find_recipe(options.recipe), over, *options_of_search)
    print(f"The best is in {path}; train it with other seeds: flexman train {path} --seeds 5")
    return 0


COMMAND = CommandLine(_arguments, _run)

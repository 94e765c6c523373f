"""Search for better hyperparameters of a recipe with Optuna."""

import argparse
from pathlib import Path

from flexman_gym.commands import CommandLine


def _arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command-line arguments."""
    from flexman_gym.common.parallel import Workers

    parser.add_argument("recipe", help="name of a recipe (flexman list recipes), or file of settings")
    parser.add_argument(
        "--over", type=Path, required=True, metavar="FILE", help="file with settings and their ranges (YAML or JSON)"
    )
    parser.add_argument(
        "--trials",
        type=int,
        metavar="N",
        default=20,
        help="total number of trials, including those in the folder (default: 20)",
    )
    parser.add_argument(
        "--seed", type=int, metavar="N", default=0, help="seed of the search; runs use the seed of the recipe"
    )
    parser.add_argument(
        "--folder",
        type=Path,
        default=Path("runs/search"),
        help="folder of the trials; an earlier search in this folder is resumed (default: %(default)s)",
    )
    Workers.arguments(parser)


def _run(options: argparse.Namespace) -> int:
    """Run the search and print the path of the best settings; return 0."""
    from flexman_agents.search import search
    from flexman_agents.settings import find_recipe
    from flexman_gym.common import files
    from flexman_gym.common.errors import value_error
    from flexman_gym.common.parallel import Workers

    over = files.read_data(options.over)
    if not isinstance(over, dict) or not over:
        raise value_error("over", str(options.over), "a file with a mapping of settings")
    options_of_search = options.folder, options.trials, Workers.of(options), options.seed
    path = search(find_recipe(options.recipe), over, *options_of_search)
    print(f"The best settings are in {path}; to train them with several seeds: flexman train {path} --seeds 5")
    return 0


EXAMPLES = (
    "echo 'hyperparameters: {gamma: {low: 0.9, high: 0.999}}' > over.yaml",
    "flexman search ppo_on_pd_minute --over over.yaml --trials 2",
)
COMMAND = CommandLine(_arguments, _run, EXAMPLES)

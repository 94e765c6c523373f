"""Search for better settings of a recipe, with Optuna."""

import argparse
from pathlib import Path


def arguments(result: argparse.ArgumentParser) -> None:
    """Says what it takes."""
    from flexman_gym.evaluation.grid import Workers

    result.add_argument("recipe", help="a file of settings, or the name of a recipe")
    result.add_argument("--over", type=Path, required=True, metavar="FILE", help="settings, each with what it may be")
    result.add_argument("--trials", type=int, default=20, help="in all, those of a search that goes on included")
    result.add_argument("--seed", type=int, default=0, help="of the search; the runs keep the recipe's")
    result.add_argument("--folder", type=Path, default=Path("runs/search"), help="of trials; what it has is kept")
    Workers.arguments(result)


def run(options: argparse.Namespace) -> int:
    """Searches; returns the exit code."""
    from flexman_agents.recipes import find_recipe
    from flexman_agents.search import flat, search
    from flexman_gym.checks import refusal
    from flexman_gym.evaluation.grid import Workers
    from flexman_gym.scene import file

    over = file.read(options.over)
    if not isinstance(over, dict) or not over:
        raise refusal("over", str(options.over), "a file with a mapping of settings")
    how = options.folder, options.trials, Workers.of(options), options.seed
    path = search(find_recipe(options.recipe), flat(over), *how)
    print(f"The best is in {path}; train it with other seeds: flexman train {path} --seeds 5")
    return 0

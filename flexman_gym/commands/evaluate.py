"""Evaluate policies and controllers on the same episodes."""

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from flexman_gym.envs.config.configuration import Configuration
    from flexman_gym.evaluation.agent import AgentSpec


def arguments(result: argparse.ArgumentParser) -> None:
    """Says what it takes."""
    add_episode_arguments(result)
    result.add_argument("--save", type=Path, metavar="FOLDER", help="keep each episode there, a file of arrays each")


def add_episode_arguments(result: argparse.ArgumentParser) -> None:
    """Says which entrants play which episodes."""
    from flexman_gym.envs import NAMED
    from flexman_gym.envs.config.configuration import SET_HELP
    from flexman_gym.evaluation.agent import AGENTS
    from flexman_gym.evaluation.rollout import TEST_SEEDS

    result.add_argument("entrant", nargs="+", help=f"folder of a run or a policy, a zip, or {', '.join(AGENTS)}")
    result.add_argument("--episodes", type=int, default=len(TEST_SEEDS))
    result.add_argument("--seed", type=int, default=TEST_SEEDS.start, help="of the first episode; the next follow")
    where = f"a file, an id and a condition such as FlexRRR-v0/delay, or one of {', '.join(sorted(NAMED))}"
    result.add_argument("--env", help=f"{where}; without it that of the runs")
    result.add_argument("--set", action="append", default=[], metavar="NAME=VALUE", help=SET_HELP)
    result.add_argument("--trust", action="store_true", help="read files of Stable-Baselines3, which can run any code")


def run(options: argparse.Namespace) -> int:
    """Prints one table; returns the exit code."""
    from flexman_gym.envs.config.configuration import Configuration
    from flexman_gym.evaluation import rollout, table
    from flexman_gym.evaluation.agent import change_environment, common_environment

    if options.episodes < 1:
        options.parser.error(f"--episodes: {options.episodes} is not allowed; give a whole number > 0")
    named = Configuration.find(options.env) if options.env else None
    entrants = {name: load_agent(name, options.trust, named) for name in options.entrant}
    environment = change_environment(common_environment(list(entrants.values()), named), options.set)
    seeds = range(options.seed, options.seed + options.episodes)
    results = {name: rollout(each, environment, seeds) for name, each in entrants.items()}
    print(table({name: each.records for name, each in results.items()}, environment))
    if options.save is not None:
        files = [path for each in results.values() for path in each.save(options.save)]
        print(f"{len(files)} episodes are in {options.save}; see some: flexman replay {files[0]} --out page.html")
    return 0


def load_agent(name: str, trust: bool, named: "Configuration | None" = None) -> "AgentSpec":
    """Gives an entrant; files of Stable-Baselines3 only where they are trusted, as reading them runs code.

    A zip sees and holds as the named environment says.
    """
    from flexman_gym.evaluation.agent import find_agent, is_sb3_folder

    if trust and (is_sb3_folder(Path(name)) or name.endswith(".zip")):
        from flexman_agents.sb3 import load_sb3_run, load_sb3_zip

        return load_sb3_zip(Path(name), named) if name.endswith(".zip") else load_sb3_run(Path(name))
    return find_agent(name)

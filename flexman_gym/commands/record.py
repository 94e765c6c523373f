"""Record episodes as Minari datasets for offline learning."""

import argparse
from pathlib import Path

from flexman_gym.commands import CommandLine, add_options


def _arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command-line arguments."""
    from flexman_gym.common.parallel import Workers

    parser.add_argument(
        "agents", metavar="agent", nargs="+", help="agents, as in flexman evaluate; each gets its own dataset"
    )
    env = {
        "default": "FlexRRR-v0",
        "help": "environment: an id, an id with a condition, or a file (default: %(default)s)",
    }
    shared = "--env", "--set", "--episodes", "--seed"
    add_options(parser, *shared, env=env, episodes={"default": 100}, seed={"default": 0})
    parser.add_argument(
        "--name", default="flexman", help="first part of the names NAME/AGENT-v0 (default: %(default)s)"
    )
    parser.add_argument(
        "--form", choices=("hdf5", "arrow"), default="hdf5", help="format of the files (default: %(default)s)"
    )
    Workers.arguments(parser)


def _run(options: argparse.Namespace) -> int:
    """Write the datasets; return 0."""
    from flexman_gym.common.checks import whole_number
    from flexman_gym.common.parallel import Workers
    from flexman_gym.envs.config.configuration import Configuration
    from flexman_gym.toolbox.interchange.dataset import record_dataset

    environment = Configuration.find(options.env).changed(options.set)
    first = whole_number("--seed", options.seed, 0, 10**9)
    seeds = range(first, first + whole_number("--episodes", options.episodes, 1, 10**6))
    for agent in options.agents:
        name = f"{options.name}/{Path(agent).name}-v0"
        data = record_dataset(agent, environment, seeds, name, options.form, Workers.of(options))
        size = sum(path.stat().st_size for path in Path(data.storage.data_path).rglob("*") if path.is_file())
        print(f"{name}: {data.total_episodes} episodes, {data.total_steps} steps, {size / 1e6:.1f} MB", flush=True)
    return 0


EXAMPLES = ("flexman record lqr --env FlexOne-v0 --episodes 10",)
COMMAND = CommandLine(_arguments, _run, EXAMPLES)

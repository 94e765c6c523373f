"""Record episodes as Minari datasets, for offline learning."""

import argparse
from pathlib import Path


def arguments(result: argparse.ArgumentParser) -> None:
    """Says what it takes."""
    from flexman_gym.common.grid import Workers
    from flexman_gym.envs.config.configuration import SET_HELP

    result.add_argument("entrants", nargs="+", help="as of flexman evaluate; a dataset each")
    result.add_argument("--env", default="FlexRRR-v0", help="an id, an id and a condition, or the path of a file")
    result.add_argument("--set", action="append", default=[], metavar="NAME=VALUE", help=SET_HELP)
    result.add_argument("--episodes", type=int, default=100)
    result.add_argument("--seed", type=int, default=0, help="of the first episode; the next follow")
    result.add_argument("--name", default="flexman", help="of the datasets, before /ENTRANT-v0")
    result.add_argument("--form", choices=("hdf5", "arrow"), default="hdf5", help="of the files")
    Workers.arguments(result)


def run(options: argparse.Namespace) -> int:
    """Writes the datasets; returns the exit code."""
    from flexman_gym.common.checks import whole_number
    from flexman_gym.common.grid import Workers
    from flexman_gym.envs.config.configuration import Configuration
    from flexman_gym.evaluation.dataset import record_dataset

    environment = Configuration.find(options.env).changed(options.set)
    first = whole_number("--seed", options.seed, 0, 10**9)
    seeds = range(first, first + whole_number("--episodes", options.episodes, 1, 10**6))
    for entrant in options.entrants:
        name = f"{options.name}/{Path(entrant).name}-v0"
        data = record_dataset(entrant, environment, seeds, name, options.form, Workers.of(options))
        size = sum(path.stat().st_size for path in Path(data.storage.data_path).rglob("*") if path.is_file())
        print(f"{name}: {data.total_episodes} episodes, {data.total_steps} steps, {size / 1e6:.1f} MB", flush=True)
    return 0

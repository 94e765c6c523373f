"""Optimise slews: the quickest torques of episodes, in a table."""

import argparse
from pathlib import Path

import numpy as np

from flexman_gym.commands import CommandLine


def _arguments(result: argparse.ArgumentParser) -> None:
    """Add the command-line arguments."""
    result.add_argument("environment", help="an id, or a file, of an environment that draws starts and goals only")
    result.add_argument("--seeds", type=int, nargs=2, default=(9000, 100), metavar=("FIRST", "COUNT"))
    result.add_argument("--out", type=Path, required=True, help="a .npz file; slews that it has are not searched again")


def _run(options: argparse.Namespace) -> int:
    """Print a line for each episode, after which the table is written; return 0."""
    from flexman_gym.control.references.optimised_slews import SlewTable
    from flexman_gym.envs.config.configuration import Configuration
    from flexman_gym.evaluation.optimisation import empty_slew_table, optimise_slews

    environment, (first, count) = Configuration.find(options.environment), options.seeds
    if first < 0 or count < 1:
        options.parser.error(f"--seeds: {first} {count} is not allowed; give a first seed and how many, at least one")
    table = SlewTable.load(options.out) if options.out.exists() else empty_slew_table(environment)
    table.about = {**table.about, "command": f"flexman optimise {options.environment} --seeds {first} {count}"}
    print(f"{'seed':>8}{'settling, s':>13}{'tracking LQR, s':>17}{'ratio':>7}{'search, CPU s':>15}")
    for found in optimise_slews(environment, range(first, first + count), table):
        ratio = found.time / found.tracking
        line = f"{found.seed:>8}{found.time:>13.2f}{found.tracking:>17.2f}{ratio:>7.2f}{found.seconds:>15.1f}"
        print(line, flush=True)
        table.save(options.out)
    known = [table.settling_time(seed) for seed in range(first, first + count) if seed in table.found]
    median = f", median settling time {np.median(known):.2f} s" if known else ""
    print(f"{len(known)} of {count} episodes have a slew in {options.out}{median}")
    return 0


COMMAND = CommandLine(_arguments, _run)

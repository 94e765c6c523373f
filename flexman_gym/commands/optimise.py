"""Optimise the torques of slews for the shortest settling time."""

import argparse
from pathlib import Path

import numpy as np

from flexman_gym.commands import CommandLine


def _arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command-line arguments."""
    parser.add_argument("environment", help="id or file of an environment that randomises starts and goals only")
    parser.add_argument("--seeds", type=int, nargs=2, default=(9000, 100), metavar=("FIRST", "COUNT"),
                        help="first seed and number of episodes (default: 9000 100)")  # fmt: skip
    parser.add_argument(
        "--out",
        type=Path,
        required=True,
        metavar="FILE",
        help="table of slews (.npz); slews in an existing table are kept",
    )


def _run(options: argparse.Namespace) -> int:
    """Print a line for each episode and write the table after each episode; return 0."""
    from flexman_gym.control.references.optimised_slews import SlewTable
    from flexman_gym.envs.config.configuration import Configuration
    from flexman_gym.evaluation.optimisation import empty_slew_table, optimise_slews

    environment, (first, count) = Configuration.find(options.environment), options.seeds
    if first < 0 or count < 1:
        options.parser.error(
            f"--seeds: {first} {count} is not allowed; give a first seed >= 0 and a number of episodes >= 1"
        )
    table = SlewTable.load(options.out) if options.out.exists() else empty_slew_table(environment)
    table.about = {**table.about, "command": f"flexman optimise {options.environment} --seeds {first} {count}"}
    print(f"{'seed':>8}{'settling, s':>13}{'tracking LQR, s':>17}{'ratio':>7}{'search, CPU s':>15}")
    for slew in optimise_slews(environment, range(first, first + count), table):
        ratio = slew.settling_time / slew.tracking
        line = f"{slew.seed:>8}{slew.settling_time:>13.2f}{slew.tracking:>17.2f}{ratio:>7.2f}{slew.cpu_time:>15.1f}"
        print(line, flush=True)
        table.save(options.out)
    known = [table.settling_time(seed) for seed in range(first, first + count) if seed in table.found]
    median = f", median settling time {np.median(known):.2f} s" if known else ""
    print(f"{len(known)} of {count} episodes have a slew in {options.out}{median}")
    return 0


COMMAND = CommandLine(_arguments, _run)

"""Tune the PD gains of an environment, with stability margins."""

import argparse
import sys

from flexman_gym.commands import CommandLine


def _arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command-line arguments."""
    from flexman_gym.common.parallel import Workers

    parser.add_argument("env", help="environment: an id, an id with a condition such as FlexRRR-v0/delay, or a file")
    parser.add_argument("--no-margins", action="store_true", help="also try gains without gain and phase margins")
    parser.add_argument("--seed", type=int, metavar="N", default=0, help="seed of the search (default: %(default)s)")
    Workers.arguments(parser)


def _run(options: argparse.Namespace) -> int:
    """Print the gains and their margins; return the exit status."""
    from flexman_gym.common.parallel import Workers
    from flexman_gym.control.margins import describe_stuck_motors
    from flexman_gym.envs.config.configuration import Configuration
    from flexman_gym.evaluation.optimisation import tune

    try:
        environment = Configuration.find(options.env)
    except (ValueError, OSError) as error:
        options.parser.error(str(error))
    try:
        result = tune(environment, seed=options.seed, margin=not options.no_margins, workers=Workers.of(options))
    except ValueError as error:
        print(f"{error}; or give --no-margins", file=sys.stderr)
        return 2
    for name in ("stiffness", "damping"):
        print(f"{name}: {', '.join(f'{gain:.3g}' for gain in getattr(result, name))}")
    gains = {name: [float(f"{gain:.3g}") for gain in getattr(result, name)] for name in ("stiffness", "damping")}
    print(f"in a file of an environment: gains: {gains}".replace("'", ""))
    where = describe_stuck_motors(result.margins.stuck)
    print(f"gain margin: {result.margins.gain:.3g}, phase margin: {result.margins.phase:.3g} degrees{where}")
    print(f"mean reward of 8 episodes: {result.reward:.1f}")
    return 0


COMMAND = CommandLine(_arguments, _run)

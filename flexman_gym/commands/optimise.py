"""Optimise slews, the gains of a PD, or the arm itself.

"slews" computes torques for the shortest settling time, "gains" tunes the PD of an environment with stability margins,
and "arm" varies the thickness of the links along their length, for "settling" also gear ratios and PD gains.
"""

import argparse
import sys
from collections.abc import Mapping, Sequence

import numpy as np

from flexman_gym.commands import CommandLine, output_file


def _arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command-line arguments."""
    from flexman_gym.common.parallel import Workers
    from flexman_gym.toolbox.sensitivity.arm_design import DESIGN_METRICS, KEPT

    kinds = parser.add_subparsers(dest="kind", required=True, metavar="|".join(PURPOSES))
    slews, gains, arm = (kinds.add_parser(name, help=text, description=text) for name, text in PURPOSES.items())
    slews.add_argument("environment", help="id or file of an environment that randomises starts and goals only")
    slews.add_argument("--seeds", type=int, nargs=2, default=(9000, 100), metavar=("FIRST", "COUNT"),
                       help="first seed and number of episodes (default: 9000 100)")  # fmt: skip
    slews.add_argument("--out", type=output_file, required=True, metavar="FILE",
                       help="table of slews (.npz); slews in an existing table are kept")  # fmt: skip
    slews.add_argument("--learn", action="store_true", help="begin searches with slews predicted from the table")
    known = "environment: an id, an id with a condition such as FlexRRR-v0/delay, or a file"
    gains.add_argument("environment", help=known)
    gains.add_argument("--no-margins", action="store_true", help="also try gains without gain and phase margins")
    gains.add_argument("--seed", type=int, metavar="N", default=0, help="seed of the search (default: %(default)s)")
    Workers.arguments(gains)
    arm.add_argument("environment", help=known)
    arm.add_argument("--metric", choices=DESIGN_METRICS, default="frequency",
                     help="largest frequency, least mass or shortest settling time (default: %(default)s)")  # fmt: skip
    arm.add_argument("--sections", type=int, default=8, metavar="N",
                     help="number of sections of each link (default: %(default)s)")  # fmt: skip
    for name, default in (("--thickness", (0.5, 2.0)), ("--gears", (1.0, 1.0))):
        arm.add_argument(name, type=float, nargs=2, default=default, metavar=("LEAST", "MOST"),
                         help="bounds, as factors of the given (default: {:g} {:g})".format(*default))  # fmt: skip
    arm.add_argument("--keep", choices=KEPT, default="arm", help="keep the mass of the arm or of each of its links")
    arm.add_argument("--tip-force", type=float, nargs=3, default=(0.0, 0.0, 0.0), metavar=("X", "Y", "Z"),
                     help="load of the metric mass in addition to gravity, N")  # fmt: skip
    arm.add_argument("--out", type=output_file, metavar="FILE",
                     help="environment with the new arm and gains (.yaml or .json)")  # fmt: skip


def _run_slews(options: argparse.Namespace) -> int:
    """Print a line for each episode and write the table after each episode; return 0."""
    from flexman_gym.envs.config.configuration import Configuration
    from flexman_gym.toolbox.controllers.references.optimised_slews import SlewTable
    from flexman_gym.toolbox.controllers.tuning import empty_slew_table, optimise_slews

    environment, (first, count) = Configuration.find(options.environment), options.seeds
    if first < 0 or count < 1:
        options.parser.error(
            f"--seeds: {first} {count} is not allowed; give a first seed >= 0 and a number of episodes >= 1"
        )
    table = SlewTable.load(options.out) if options.out.exists() else empty_slew_table(environment)
    learn = " --learn" if options.learn else ""
    command = f"flexman optimise slews {options.environment} --seeds {first} {count}{learn}"
    table.about = {**table.about, "command": command}
    if all(seed in table.found for seed in range(first, first + count)):
        print("no slew is missing; nothing is left to do")
    else:
        print(f"{'seed':>8}{'settling, s':>13}{'tracking LQR, s':>17}{'ratio':>7}{'search, CPU s':>15}")
    for slew in optimise_slews(environment, range(first, first + count), table, options.learn):
        ratio = slew.settling_time / slew.tracking
        line = f"{slew.seed:>8}{slew.settling_time:>13.2f}{slew.tracking:>17.2f}{ratio:>7.2f}{slew.cpu_time:>15.1f}"
        print(line, flush=True)
        table.save(options.out)
    known = [table.settling_time(seed) for seed in range(first, first + count) if seed in table.found]
    median = f", median settling time {np.median(known):.2f} s" if known else ""
    print(f"{len(known)} of {count} episodes have a slew in {options.out}{median}")
    return 0


def _run_gains(options: argparse.Namespace) -> int:
    """Print the gains and their margins; return the exit status."""
    from flexman_gym.common.parallel import Workers
    from flexman_gym.envs.config.configuration import Configuration
    from flexman_gym.toolbox.controllers.margins import describe_stuck_motors
    from flexman_gym.toolbox.controllers.tuning import tune

    try:
        environment = Configuration.find(options.environment)
    except (ValueError, OSError) as error:
        options.parser.error(str(error))
    try:
        result = tune(environment, seed=options.seed, margin=not options.no_margins, workers=Workers.of(options))
    except ValueError as error:
        print(f"{error}; or give --no-margins", file=sys.stderr)
        return 2
    _print_gains(result.gains)
    where = describe_stuck_motors(result.margins.stuck)
    print(f"gain margin: {result.margins.gain:.3g}, phase margin: {result.margins.phase:.3g} degrees{where}")
    print(f"mean reward of 8 episodes: {result.reward:.1f}")
    return 0


def _print_gains(gains: Mapping[str, Sequence[float]]) -> None:
    """Print PD gains in words and as the line of a file."""
    for name, values in gains.items():
        print(f"{name}: {_numbers(values)}")
    rounded = {name: [float(f"{gain:.3g}") for gain in values] for name, values in gains.items()}
    print(f"in a file of an environment: gains: {rounded}".replace("'", ""))


def _numbers(values: Sequence[float]) -> str:
    """Return numbers with three digits, separated by commas."""
    return ", ".join(f"{value:.3g}" for value in values)


def _run_arm(options: argparse.Namespace) -> int:
    """Print the metric, masses and thickness before and after; return the exit status."""
    from flexman_gym.common.files import check_suffix
    from flexman_gym.envs.config.configuration import Configuration
    from flexman_gym.toolbox.sensitivity.arm_design import DESIGN_METRICS, optimise_arm

    if options.out:
        check_suffix(options.out)
    names = ("metric", "sections", "thickness", "gears", "keep", "tip_force")
    found = optimise_arm(Configuration.find(options.environment), **{name: getattr(options, name) for name in names})
    unit = DESIGN_METRICS[found.metric]
    print(f"{found.metric}: {found.before:.4g} {unit} before, {found.after:.4g} {unit} after, "
          f"{100.0 * (found.after / found.before - 1.0):+.1f} %")  # fmt: skip
    print(f"masses of the links: {_numbers(found.masses)} kg")
    for number, factors in enumerate(found.thickness, 1):
        print(f"thickness of link {number}, base to tip, times the given: {_numbers(factors)}")
    if found.metric == "settling":
        print(f"gear ratios, times the given: {_numbers(found.gears)}")
        _print_gains(found.environment.gains)
    if options.out:
        found.environment.save(options.out)
        print(f"{options.out} has the new arm; flexman optimise gains {options.out} tunes its PD gains")
    if not found.converged:
        print(f"the optimiser stopped after {found.iterations} iterations without convergence", file=sys.stderr)
    return 0 if found.converged else 1


def _run(options: argparse.Namespace) -> int:
    """Run the optimisation and return the exit status."""
    return {"slews": _run_slews, "gains": _run_gains, "arm": _run_arm}[options.kind](options)


PURPOSES = {
    "slews": "Optimise the torques of slews for the shortest settling time.",
    "gains": "Tune the PD gains of an environment, with stability margins.",
    "arm": "Optimise the thickness of the links of an arm, its gear ratios and PD gains, with exact gradients.",
}
EXAMPLES = (
    "flexman optimise slews FlexOne-v0 --seeds 9000 2 --out slews.npz",
    "flexman optimise gains FlexOne-v0",
    "flexman optimise arm FlexOne-v0 --out thin.yaml",
)
COMMAND = CommandLine(_arguments, _run, EXAMPLES)

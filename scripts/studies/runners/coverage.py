"""Share of fitted parameters of random simulated arms that are within two standard deviations of the true value."""

from argparse import ArgumentParser, Namespace

from flexman_gym.commands import CommandLine
from studies.machine.measure import coverage

ARMS = 30


def arguments(parser: ArgumentParser) -> None:
    """Add the number of records."""
    parser.add_argument("--draws", type=int, default=10, help=f"noisy records of each of {ARMS} arms")


def run(options: Namespace) -> int:
    """Print the share."""
    part, known, unknown = coverage(ARMS, options.draws)
    print(f"{part:.1%} of {known} estimates are within two standard deviations of the true value; "
          f"{unknown} are reported as undetermined")  # fmt: skip
    return 0


RUNNER = CommandLine(arguments, run)

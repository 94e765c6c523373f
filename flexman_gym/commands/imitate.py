"""Train a policy to imitate a controller (DAgger)."""

import argparse

import yaml

from flexman_gym.commands import CommandLine, train
from flexman_gym.common.errors import value_error

# options of flexman train without use here
TRAIN_ONLY_OPTIONS = ("algo", "engine", "runners", "device", "eval_every", "checkpoint_every")


def _arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command-line arguments."""
    from flexman_gym.agent.base_controllers import BASES

    names = ", ".join(BASES)
    parser.add_argument("teacher", type=yaml.safe_load, help=f"controller to imitate: {names}, or a mapping with kind")
    train.COMMAND.arguments(parser)
    for action in parser._actions:
        if action.dest in TRAIN_ONLY_OPTIONS:
            action.help = argparse.SUPPRESS


def _run(options: argparse.Namespace) -> int:
    """Train the student; return the exit status."""
    if options.algo not in (None, "dagger"):
        raise value_error("algo", options.algo, "no algorithm: imitation uses DAgger")
    options.algo = "dagger"
    return train.COMMAND.run(options)


EXAMPLES = (
    "flexman imitate pd --env FlexPlanar-v0 --set sensors=servo --steps 40000",
    "flexman evaluate runs/latest pd",
)
COMMAND = CommandLine(_arguments, _run, EXAMPLES)

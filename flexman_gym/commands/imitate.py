"""Imitate a controller with a network, from what sensors read."""

import argparse

import yaml

from flexman_gym.commands import CommandLine, train
from flexman_gym.common.checks import value_error

TRAIN_ONLY_OPTIONS = (
    "algo",
    "engine",
    "runners",
    "device",
    "eval_every",
    "checkpoint_every",
)  # that only a training has


def _arguments(result: argparse.ArgumentParser) -> None:
    """Add the command-line arguments."""
    from flexman_gym.control.base_controllers import BASES

    known = ", ".join(BASES)
    result.add_argument("teacher", type=yaml.safe_load, help=f"one of {known}, or a mapping with one at kind")
    train.COMMAND.arguments(result)
    for action in result._actions:
        if action.dest in TRAIN_ONLY_OPTIONS:
            action.help = argparse.SUPPRESS


def _run(options: argparse.Namespace) -> int:
    """Train the student; return the exit status."""
    if options.algo not in (None, "dagger") or options.engine != "sb3":
        raise value_error("algo", options.algo or options.engine, "nothing: a controller is imitated by DAgger")
    options.algo = "dagger"
    return train.COMMAND.run(options)


COMMAND = CommandLine(_arguments, _run)

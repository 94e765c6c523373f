"""Imitate a controller: a network learns, from what its sensors read, what the controller would do."""

import argparse

import yaml

from flexman_gym.checks import refusal
from flexman_gym.commands import train


def arguments(result: argparse.ArgumentParser) -> None:
    """Says what it takes."""
    from flexman_gym.control.bases import BASES

    known = ", ".join(BASES)
    result.add_argument("teacher", type=yaml.safe_load, help=f"one of {known}, or a mapping with one at kind")
    train.arguments(result)


def run(options: argparse.Namespace) -> int:
    """Learns; returns the exit code."""
    if options.algo not in (None, "dagger") or options.engine != "sb3":
        raise refusal("algo", options.algo or options.engine, "nothing: a controller is imitated by DAgger")
    options.algo = "dagger"
    return train.run(options)

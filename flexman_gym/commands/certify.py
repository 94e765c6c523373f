"""Certify a policy: `league --agent`, where it fails, written beside it."""

import argparse
from typing import TYPE_CHECKING

from flexman_gym.commands import CommandLine

if TYPE_CHECKING:
    from flexman_gym.common.parallel import Workers


def _arguments(result: argparse.ArgumentParser) -> None:
    """Add the command-line arguments."""
    from flexman_gym.evaluation.policy_files import POLICIES

    result.add_argument("policy", help=f"folder of an exported policy, or {', '.join(POLICIES)}")


def _run(options: argparse.Namespace) -> int:
    """Write the certificate; return 0, or 1 where something fails."""
    return print_certificate(options.policy)


def print_certificate(policy: str, jobs: "Workers | int" = 1) -> int:
    """Write the certificate of a policy and print its rows; return 0, or 1 where something fails."""
    import json

    from flexman_gym.league.certificate import certify

    path = certify(policy, jobs=jobs, log=lambda line: print(line, flush=True))
    fails = json.loads(path.read_bytes())["fails"]
    print(f"{path}: {'not recommended, it fails ' + ', '.join(fails) if fails else 'recommended'}")
    return 1 if fails else 0


COMMAND = CommandLine(_arguments, _run)

"""Certify a policy: where it fails, written beside it."""

import argparse

from flexman_gym.commands import CommandLine


def _arguments(result: argparse.ArgumentParser) -> None:
    """Add the command-line arguments."""
    from flexman_gym.evaluation.policy_files import POLICIES

    result.add_argument("policy", help=f"folder of an exported policy, or {', '.join(POLICIES)}")


def _run(options: argparse.Namespace) -> int:
    """Writes the certificate; returns 0, or 1 where something fails."""
    import json

    from flexman_gym.league.certificate import certify

    path = certify(options.policy, say=lambda said: print(said, flush=True))
    fails = json.loads(path.read_bytes())["fails"]
    print(f"{path}: {'not recommended, it fails ' + ', '.join(fails) if fails else 'recommended'}")
    return 1 if fails else 0


COMMAND = CommandLine(_arguments, _run)

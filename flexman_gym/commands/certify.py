"""Test a policy under other physics, parameters, delays and noise.

The certificate with all results and the worst episodes is written to the folder of the policy. The exit status is 1 if
the policy exceeds a limit of the certificate.
"""

import argparse
import json

from flexman_gym.commands import CommandLine


def _arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command-line arguments."""
    from flexman_gym.evaluation.policy_files import POLICIES

    parser.add_argument("policy", help=f"folder of an exported policy, or {', '.join(POLICIES)}")
    parser.set_defaults(workers=1)


def _run(options: argparse.Namespace) -> int:
    """Write the certificate and print its rows; return 0, or 1 if the policy exceeds a limit."""
    from flexman_gym.league.certificate import certify

    path = certify(options.policy, jobs=options.workers, log=lambda line: print(line, flush=True))
    fails = json.loads(path.read_bytes())["fails"]
    print(f"{path}: {'beyond its limits in ' + ', '.join(fails) if fails else 'within all limits'}")
    return 1 if fails else 0


COMMAND = CommandLine(_arguments, _run)

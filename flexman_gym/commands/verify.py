"""Verify the model against closed-form solutions."""

import argparse
from pathlib import Path
from time import perf_counter

from flexman_gym.commands import CommandLine

FULL_TABLE_HINT = (
    "These are the closed-form cases. The full table, with trajectories of independent codes, is in "
    "docs/evidence/verification.md; `make verify` in the repository computes it."
)


def _arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command-line arguments."""
    parser.add_argument("--quick", action="store_true", help="print no reference to the full table")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write the rows to a JSON file")


def _run(options: argparse.Namespace) -> int:
    """Print the table; return 0, or 1 if a row fails."""
    from flexman_gym.verification.cases import closed_form_rows
    from flexman_gym.verification.table import exit_code, format_json, format_table

    started = perf_counter()
    result = closed_form_rows()
    print(format_table(result))
    print(f"{perf_counter() - started:.0f} s")
    if not options.quick:
        print(FULL_TABLE_HINT)
    if options.json is not None:
        options.json.write_text(format_json(result), encoding="utf-8")
    return exit_code(result)


COMMAND = CommandLine(_arguments, _run)

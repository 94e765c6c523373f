"""Verify the model by closed-form solutions or results of papers."""

import argparse
from pathlib import Path
from time import perf_counter

from flexman_gym.commands import CommandLine, output_file

FULL_TABLE_HINT = (
    "These are the closed-form cases. The full table, with trajectories of independent codes, is in "
    "docs/evidence/verification.md; `make verify` in the repository computes it."
)


def _arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command-line arguments."""
    parser.add_argument(
        "table", nargs="?", choices=("closed-forms", "papers"), default="closed-forms",
        help="closed-forms, or papers: printed, measured and computed results of published arms (default: %(default)s)",
    )  # fmt: skip
    parser.add_argument(
        "--data", type=Path, metavar="FILE", help="fit a machine to a measured response, a CSV file with frequency "
        "(Hz), real and imaginary: the rotary flexible link, hub angle to voltage (rad/V), or the axis of Wernholt and "
        "Gunnarsson, motor rate to torque (rad/s/(N m)); or a record of this axis: time (s), motor torque (N m), "
        "motor rate (rad/s)",
    )  # fmt: skip
    parser.add_argument("--quick", action="store_true", help="print no reference to the full table")
    parser.add_argument("--json", type=output_file, metavar="FILE", help="write the rows to a JSON file")


def _run(options: argparse.Namespace) -> int:
    """Print the table; return 0, or 1 if a row fails."""
    from flexman_gym.common.files import write_file
    from flexman_gym.toolbox.verification import papers
    from flexman_gym.toolbox.verification.cases import CLOSED_FORMS
    from flexman_gym.toolbox.verification.table import PASS, VerificationTable

    if options.data is not None:
        if options.table != "papers":
            options.parser.error("--data belongs to: flexman verify papers --data FILE")
        from flexman_gym.toolbox.verification.response import fit_response, read_response

        try:
            print(fit_response(*read_response(options.data)))
        except (ValueError, OSError) as error:
            options.parser.error(str(error))
        return 0
    started = perf_counter()
    if options.table == "papers":
        tables = papers.paper_tables().values()
        rows = [row for table in tables for row in table]
        print(*tables, sep="\n\n")
        explained = [row for row in rows if row.verdict != PASS and row.case in papers.REASONS]
        print(*(f"{row.case}: {papers.REASONS[row.case]}" for row in explained), sep="\n")
        result, judged = VerificationTable(rows), VerificationTable([row for row in rows if row not in explained])
    else:
        result = judged = VerificationTable([row for case in CLOSED_FORMS for row in case()])
        print(result)
    print(f"{perf_counter() - started:.0f} s")
    if not options.quick and options.table != "papers":
        print(FULL_TABLE_HINT)
    if options.json is not None:
        write_file(options.json, result.to_json())
    return judged.exit_code


EXAMPLES = (
    "flexman verify --quick",
    "flexman verify papers --json papers.json",
)
COMMAND = CommandLine(_arguments, _run, EXAMPLES)

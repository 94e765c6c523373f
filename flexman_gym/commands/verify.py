"""Verify the simulator against closed forms and other solutions."""

import argparse
import warnings
from pathlib import Path
from time import perf_counter


def arguments(result: argparse.ArgumentParser) -> None:
    """Says what it takes."""
    from flexman_gym.verification.cases import REFERENCE

    result.add_argument("--quick", action="store_true", help="only what takes less than 30 s once compiled")
    result.add_argument("--json", type=Path, help="file for the rows")
    result.add_argument("--markdown", type=Path, help="file for the table as a page")
    result.add_argument("--reference", type=Path, default=REFERENCE, help="folder of the reference solutions")


def run(options: argparse.Namespace) -> int:
    """Prints one table; returns 1 when a row fails."""
    from flexman_gym.verification.cases import rows
    from flexman_gym.verification.table import as_json, exit_code, markdown_page, text_table

    if not options.reference.is_dir():
        allowed = "give the folder of the reference solutions"
        options.parser.error(f"--reference: {options.reference} is not allowed; {allowed}")
    warnings.filterwarnings("ignore", "Link.second_moment_y", UserWarning)  # of the paper's printed area of link 1
    started = perf_counter()
    result = rows(options.reference, options.quick)
    print(text_table(result))
    print(f"{perf_counter() - started:.0f} s")
    for file, text in ((options.json, as_json), (options.markdown, markdown_page)):
        if file is not None:
            file.write_text(text(result), encoding="utf-8")
    return exit_code(result)

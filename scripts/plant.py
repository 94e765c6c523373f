"""Plant errors one at a time and run the tests: python scripts/plant.py --part kernels --folder docs/evidence"""

import argparse
import sys
from collections.abc import Mapping
from functools import partial
from pathlib import Path

from flexman_gym.common.computer import computer_text
from flexman_gym.common.parallel import Workers, parallel_map_unordered
from studies.files import folder, made_comment, read_comments, read_rows, today, write_rows
from studies.planted.measure import (
    CHECKOUT,
    PARTS,
    SURVIVED,
    Planted,
    is_current,
    kept,
    misplaced,
    passing,
    planted,
    with_first_test,
)
from studies.planted.page import counts, page


def main() -> int:
    """Plant the chosen errors and write rows and page; return 1 if an error survives or has no outcome."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--part", choices=PARTS, help="part of the library; default: all parts")
    parser.add_argument("--only", default="", help="only errors whose description or file contains this text")
    parser.add_argument("--anew", action="store_true", help="run errors again that have a row of the present code")
    parser.add_argument("--redraw", action="store_true", help="write the page from the rows of an earlier run")
    parser.add_argument("--folder", type=folder, default="docs/evidence", help="folder of the page and its rows")
    Workers.arguments(parser)
    options = parser.parse_args()
    file = options.folder / "planted.csv"
    if options.redraw:
        _write_page(file)
        return 0
    rows = kept(file)
    chosen = [
        change
        for change in (change for name, every in PARTS.items() if options.part in (None, name) for change in every)
        if options.only in f"{change.error} {change.file}" and (options.anew or not is_current(change, rows))
    ]
    if faults := misplaced(CHECKOUT, chosen):
        parser.error("; ".join(faults))
    chosen = [with_first_test(change, rows.get((change.part, change.error))) for change in chosen]
    first = sorted({change.first for change in chosen if change.first})
    task = partial(planted, green=passing(first) if len(first) > 1 else ())
    failures = []  # errors whose tests fail without them; they get no row
    for _, row in parallel_map_unordered(task, chosen, Workers.of(options)):
        if isinstance(row, str):
            print(f"no outcome: {row}", flush=True)
            failures.append(row)
            continue
        print(f"{row.outcome:10} {row.seconds:4.0f} s  {row.part}: {row.error} ({row.by})", flush=True)
        rows[row.part, row.error] = row
        result = _in_order(rows)
        write_rows(result, file, 2, made_comment(computer_text(), today(), len(result)))
        _write_page(file)
    if not chosen:
        print("no error matches the options, or all have rows of the present code")
        return 0
    result = _in_order(rows)
    for part, *numbers in counts(result):
        print(part, *numbers)
    return int(bool(failures) or any(row.outcome == SURVIVED for row in result))


def _in_order(rows: Mapping[tuple[str, str], Planted]) -> list[Planted]:
    """Return the rows of the errors that are in the tables, in the order of the tables."""
    every = [(change.part, change.error) for part in PARTS.values() for change in part]
    return [rows[key] for key in every if key in rows]


def _write_page(file: Path) -> None:
    file.with_suffix(".md").write_text(page(read_rows(file, Planted), read_comments(file)), encoding="utf-8")


if __name__ == "__main__":
    sys.exit(main())

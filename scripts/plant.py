"""Plant errors one at a time and says which the tests notice: python scripts/plant.py --room kernels --folder docs"""

import argparse
import sys

from flexman_gym.common.parallel import Workers, parallel_map_unordered
from studies.files import folder, write_rows
from studies.planted.measure import CAUGHT, CHECKOUT, ROOMS, SURVIVED, kept, misplaced, planted
from studies.planted.page import counts, page


def main() -> int:
    """Read the command line, plant the errors and write the page; return 1 if one survives."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--room", choices=ROOMS, help="errors of one room only")
    parser.add_argument("--only", default="", help="errors whose words or file contain this")
    parser.add_argument("--new", action="store_true", help="only errors that no row has as caught")
    parser.add_argument("--folder", type=folder, default="docs", help="where page and rows go")
    Workers.arguments(parser)
    options = parser.parse_args()
    file = options.folder / "planted.csv"
    rows = kept(file)
    known = {(row.room, row.error) for row in rows.values() if row.outcome == CAUGHT} if options.new else set()
    chosen = [
        change
        for change in (change for name, room in ROOMS.items() if options.room in (None, name) for change in room)
        if options.only in f"{change.error} {change.file}" and (change.room, change.error) not in known
    ]
    if faults := misplaced(CHECKOUT, chosen):
        parser.error("; ".join(faults))
    for _, row in parallel_map_unordered(planted, chosen, Workers.of(options)):
        print(f"{row.outcome:10} {row.seconds:4.0f} s  {row.room}: {row.error} ({row.by})", flush=True)
        rows[row.room, row.error] = row
        result = [rows[change.room, change.error] for room in ROOMS.values() for change in room
                 if (change.room, change.error) in rows]  # fmt: skip
        write_rows(result, file, digits=2)
        (options.folder / "planted.md").write_text(page(result), encoding="utf-8")
    if not chosen:
        print("no error of the table is meant")
        return 0
    for room, *numbers in counts(result):
        print(room, *numbers)
    return int(any(row.outcome == SURVIVED for row in result))


if __name__ == "__main__":
    sys.exit(main())

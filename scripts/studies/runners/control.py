"""Compare controllers of an arm with uncertain parameters."""

import argparse

from studies.control.cases import CASES, ControlRow, run_case
from studies.control.page import page
from studies.files import folder, read_rows, write_rows
from studies.results import Results


def main() -> None:
    """Run the selected cases and write table and page."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--episodes", type=int, default=100, help="episodes per case")
    parser.add_argument("--seed", type=int, default=9000, help="seed of the first episode")
    parser.add_argument("--only", help="prefix of the names of the cases to run")
    parser.add_argument("--redraw", action="store_true", help="write the page from the rows of an earlier run")
    parser.add_argument("--folder", type=folder, default="out/control", help="output folder of table and page")
    options = parser.parse_args()
    path = options.folder / "control.csv"
    rows = {row.case: row for row in read_rows(path, ControlRow)} if path.exists() else {}
    for case in () if options.redraw else CASES:
        if not options.only or case.name.startswith(options.only):
            row = rows[case.name] = run_case(case, options.episodes, options.seed)
            print(row, flush=True)
            write_rows([rows[each.name] for each in CASES if each.name in rows], path)
    (options.folder / "control.md").write_text(
        page([rows[case.name] for case in CASES if case.name in rows], Results())
    )


if __name__ == "__main__":
    main()

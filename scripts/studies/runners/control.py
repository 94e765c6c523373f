"""Controllers of arms with uncertain parameters, and faults under which they fail."""

from argparse import Namespace

from studies.control.cases import CASES, ControlRow, run_case
from studies.control.page import page
from studies.files import read_rows
from studies.results import Results
from studies.study import Study, Table


def measure(options: Namespace) -> list[list[ControlRow]]:
    """Return the rows of the chosen cases, and the stored rows of the others."""
    path = options.folder / "control.csv"
    rows = {row.case: row for row in read_rows(path, ControlRow)} if path.exists() else {}
    for case in CASES:
        if case.name.startswith(options.only):
            rows[case.name] = run_case(case, options.episodes, options.seed)
    return [[rows[case.name] for case in CASES if case.name in rows]]


RUNNER = Study(
    tables=(Table("control", ControlRow),),
    measure=measure,
    pages={"control.md": lambda rows, _: page(rows, Results())},
    options={
        "--episodes": {"type": int, "default": 100, "help": "episodes per case (default: %(default)s)"},
        "--seed": {"type": int, "default": 9000, "help": "seed of the first episode (default: %(default)s)"},
        "--only": {"default": "", "help": "prefix of the names of the cases to run; others keep their rows"},
    },
)

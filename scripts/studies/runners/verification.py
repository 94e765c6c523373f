"""Full table of the verification, and tables of papers."""

from argparse import Namespace
from collections.abc import Iterator, Sequence

from flexman_gym.toolbox.verification.papers import paper_tables
from flexman_gym.toolbox.verification.table import VerificationRow, VerificationTable
from studies.study import QUICK, Study, Table
from studies.verification.motions import REFERENCE, rows
from studies.verification.page import page
from studies.verification.papers import page as page_of_papers

FILES = ("verification", "papers_printed", "papers_computed")


def measure(options: Namespace) -> Iterator[Sequence[VerificationRow]]:
    """Yield the rows of the verification and of both tables of papers; motions of minutes only without --quick."""
    yield rows(REFERENCE, options.quick)
    papers = paper_tables()
    yield papers["printed"]
    yield papers["computed"]


def report(result: Sequence[VerificationRow], *_: Sequence[VerificationRow]) -> int:
    """Print the table and return 1 if a row fails."""
    table = VerificationTable(result)
    print(table)
    return table.exit_code


RUNNER = Study(
    tables=[Table(file, VerificationRow, 12) for file in FILES],
    measure=measure,
    pages={
        "verification.md": lambda rows, _, __, files: page(
            VerificationTable(rows), {"verification.csv": files["verification.csv"]}
        ),
        "papers.md": lambda _, printed, computed, __: page_of_papers(printed, computed),
    },
    report=report,
    options=QUICK,
)

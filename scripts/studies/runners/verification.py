"""Full table of the verification, tables of papers, and the benchmark of two masses."""

from argparse import Namespace
from collections.abc import Iterable, Iterator, Sequence

from flexman_gym.toolbox.verification.papers import paper_tables
from flexman_gym.toolbox.verification.table import VerificationRow, VerificationTable
from studies.study import QUICK, Study, Table
from studies.verification.motions import REFERENCE, rows
from studies.verification.page import page
from studies.verification.papers import masses_page
from studies.verification.papers import page as page_of_papers
from studies.verification.two_mass import DRAWS, QUICK_DRAWS, TwoMassRow, two_mass_rows

FILES = ("verification", "papers_printed", "papers_computed")
Row = VerificationRow | TwoMassRow


def measure(options: Namespace) -> Iterator[Iterable[Row]]:
    """Yield the rows of all tables; motions of minutes, and 1,000 random springs, only without --quick."""
    yield rows(REFERENCE, options.quick)
    papers = paper_tables()
    yield papers["printed"]
    yield papers["computed"]
    yield two_mass_rows(QUICK_DRAWS if options.quick else DRAWS)


def report(result: Sequence[VerificationRow], *_: Sequence[Row]) -> int:
    """Print the table and return 1 if a row fails."""
    table = VerificationTable(result)
    print(table)
    return table.exit_code


RUNNER = Study(
    tables=[*(Table(file, VerificationRow, 12) for file in FILES), Table("two_mass", TwoMassRow)],
    measure=measure,
    pages={
        "verification.md": lambda rows, _, __, ___, files: page(
            VerificationTable(rows), {"verification.csv": files["verification.csv"]}
        ),
        "papers.md": lambda _, printed, computed, __, ___: page_of_papers(printed, computed),
        "two_masses.md": lambda _, __, ___, masses, ____: masses_page(masses),
    },
    report=report,
    options=QUICK,
)

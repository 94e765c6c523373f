"""Exact derivatives compared with differences, and their costs."""

from collections.abc import Iterator

from studies.derivatives.costs import CostRow, cost_rows
from studies.derivatives.measure import DerivativeRow, rows
from studies.derivatives.page import page
from studies.study import Study, Table


def costs() -> Iterator[CostRow]:
    """Yield the rows of the costs after a first round, which compiles."""
    cost_rows(1)
    yield from cost_rows()


RUNNER = Study(
    tables=(Table("derivatives", DerivativeRow), Table("derivatives_costs", CostRow, 4)),
    measure=lambda _: (rows(), costs()),
    pages={"derivatives.md": page},
)

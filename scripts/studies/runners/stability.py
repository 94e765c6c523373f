"""Stability limits and numerical damping of all methods."""

from flexman_gym.common.parallel import Workers
from studies.stability.charts import draw
from studies.stability.measure import StabilityRow
from studies.stability.page import page, summary
from studies.stability.rows import all_rows
from studies.study import KEPT, QUICK, Study, Table

RUNNER = Study(
    tables=(Table("stability", StabilityRow, 9),),
    measure=lambda options: [all_rows(options.quick, Workers.of(options), options.kept)],
    pages={"stability.md": page},
    charts=lambda folder, rows: draw(rows, folder),
    report=lambda rows: print(summary(rows)),
    options=QUICK | KEPT,
    parallel=True,
)

"""Stability limits and numerical damping of all methods."""

from argparse import ArgumentParser

from flexman_gym.common.parallel import Workers
from studies.stability.charts import draw
from studies.stability.measure import StabilityRow
from studies.stability.page import page, summary
from studies.stability.rows import all_rows
from studies.study import Study, Table, quick, workers


def arguments(parser: ArgumentParser) -> None:
    """Add the small grid and the workers."""
    quick(parser)
    workers(parser)


RUNNER = Study(
    tables=(Table("stability", StabilityRow, 9),),
    measure=lambda options: [all_rows(options.quick, Workers.of(options), options.kept)],
    pages={"stability.md": page},
    charts=lambda folder, rows: draw(rows, folder),
    report=lambda rows: print(summary(rows)),
    own_arguments=arguments,
)

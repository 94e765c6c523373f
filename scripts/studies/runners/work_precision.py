"""Work-precision diagrams of all methods and models."""

from argparse import ArgumentParser, Namespace
from collections.abc import Sequence

from flexman_gym.common.parallel import Workers
from studies.precision.charts import draw
from studies.precision.measure import Floor, PrecisionRow
from studies.precision.page import compute, page
from studies.study import Study, Table, quick, workers
from studies.verification.motions import REFERENCE


def arguments(parser: ArgumentParser) -> None:
    """Add the small grid and the workers."""
    quick(parser)
    workers(parser)


def measure(options: Namespace) -> tuple[Sequence[PrecisionRow], Sequence[Floor]]:
    """Return the rows of all runs, and the errors of the reference solutions."""
    return compute(REFERENCE, options.quick, Workers.of(options), options.kept)


RUNNER = Study(
    tables=(Table("work_precision", PrecisionRow), Table("work_precision_truths", Floor)),
    measure=measure,
    pages={"work_precision.md": page},
    charts=lambda folder, rows, floors: draw(rows, floors, folder),
    own_arguments=arguments,
)

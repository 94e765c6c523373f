"""Work-precision diagrams of all methods and models."""

from flexman_gym.common.parallel import Workers
from flexman_gym.toolbox.precision.runs import PrecisionRow
from studies.precision.charts import draw
from studies.precision.measure import Floor
from studies.precision.page import compute, page
from studies.study import KEPT, QUICK, Study, Table
from studies.verification.motions import REFERENCE

RUNNER = Study(
    tables=(Table("work_precision", PrecisionRow), Table("work_precision_truths", Floor)),
    measure=lambda options: compute(REFERENCE, options.quick, Workers.of(options), options.kept),
    pages={"work_precision.md": page},
    charts=lambda folder, rows, floors: draw(rows, floors, folder),
    options=QUICK | KEPT,
    parallel=True,
)

"""Time until a new process has used an environment, many arms, a simulation and an evaluation."""

from flexman_gym.common.computer import computer_text
from studies.starts.measure import StartRow, start_rows
from studies.starts.page import page
from studies.study import QUICK, Study, Table

RUNS = 3

RUNNER = Study(
    tables=[Table("starts", StartRow)],
    measure=lambda options: [start_rows(1 if options.quick else RUNS, options.wheel, cold=not options.quick)],
    pages={"starts.md": page},
    options=QUICK | {"--wheel": {"metavar": "PYTHON", "help": "interpreter of an environment with an installed wheel"}},
    comment=lambda _: computer_text(("gymnasium",)),
)

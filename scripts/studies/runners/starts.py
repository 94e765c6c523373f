"""Time until a new process has used an environment, many arms, a simulation and an evaluation."""

from argparse import ArgumentTypeError
from pathlib import Path

from flexman_gym.common.computer import computer_text
from studies.starts.measure import StartRow, start_rows
from studies.starts.page import page
from studies.study import QUICK, Study, Table

RUNS = 3


def interpreter(text: str) -> str:
    """Return the absolute path of an interpreter, with which processes in other folders find it."""
    path = Path(text).absolute()
    if not path.is_file():
        raise ArgumentTypeError(f"{text} does not exist; give the interpreter of an environment with a wheel")
    return str(path)


WHEEL = {"type": interpreter, "metavar": "PYTHON", "help": "interpreter of an environment with an installed wheel"}
RUNNER = Study(
    tables=[Table("starts", StartRow)],
    measure=lambda options: [start_rows(1 if options.quick else RUNS, options.wheel, cold=not options.quick)],
    pages={"starts.md": page},
    options=QUICK | {"--wheel": WHEEL},
    comment=lambda _: computer_text(("gymnasium",)),
)

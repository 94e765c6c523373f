"""Time until a new process has used an environment, many arms, a simulation and an evaluation."""

import subprocess
from argparse import ArgumentTypeError
from pathlib import Path

from flexman_gym import __version__
from flexman_gym.common.computer import computer_text
from studies.starts.measure import StartRow, start_rows
from studies.starts.page import page
from studies.study import QUICK, Study, Table

RUNS = 3


def interpreter(text: str) -> str:
    """Return the absolute path of an interpreter with a wheel of this version, for processes in other folders.

    Raises:
        ArgumentTypeError: for a missing interpreter, and for another version of the wheel.
    """
    path = Path(text).absolute()
    if not path.is_file():
        raise ArgumentTypeError(f"{text} does not exist; give the interpreter of an environment with a wheel")
    words = [str(path), "-c", "from importlib.metadata import version; print(version('flexman_gym'))"]
    done = subprocess.run(words, cwd=path.parent, capture_output=True, text=True)
    if done.stdout.strip() != __version__:
        found = done.stdout.strip() or "none"
        raise ArgumentTypeError(f"{text} has flexman_gym {found}; install the wheel of version {__version__} there")
    return str(path)


WHEEL = {"type": interpreter, "metavar": "PYTHON", "help": "interpreter of an environment with an installed wheel"}
RUNNER = Study(
    tables=[Table("starts", StartRow)],
    measure=lambda options: [start_rows(1 if options.quick else RUNS, options.wheel, cold=not options.quick)],
    pages={"starts.md": page},
    options=QUICK | {"--wheel": WHEEL},
    comment=lambda _: computer_text(("gymnasium",)),
)

"""Our model compared with a real two-link flexible arm."""

from argparse import Namespace
from pathlib import Path

from flexman_gym.common.computer import computer_text
from studies.machine.measure import DATA, FitRow, stage_1, stages
from studies.machine.page import draw, page
from studies.study import Study, Table


def measure(options: Namespace) -> list[list[FitRow]]:
    """Return the rows of the fits, and draw their plots."""
    rows, lines = stage_1(options.data)
    draw(lines, options.folder)
    return [[*rows, *stages(options.stages or options.data / "two_stages.csv")]]


RUNNER = Study(
    tables=(Table("machine", FitRow),),
    measure=measure,
    pages={"machine.md": page},
    options={
        "--data": {"type": Path, "default": DATA, "help": "folder of the single-stage runs and of two_stages.csv"},
        "--stages": {"type": Path, "help": "record of both stages; default: two_stages.csv of the data"},
    },
    comment=lambda _: computer_text(("mujoco",)),
)

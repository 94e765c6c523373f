"""Curves: how a training goes, in progress.csv and as TensorBoard events, without what a killed process wrote twice."""

import csv
from pathlib import Path

from stable_baselines3.common.logger import CSVOutputFormat, Logger, TensorBoardOutputFormat
from torch.utils.tensorboard import SummaryWriter

from flexman_gym.checks import is_count
from flexman_gym.scene.record import table_lines

STEPS = "time/total_timesteps"  # the column that Stable-Baselines3 counts in


class Events(TensorBoardOutputFormat):
    """TensorBoard events of a folder; those from `steps` on that an earlier process wrote are hidden."""

    def __init__(self, folder: Path, steps: int) -> None:
        self.writer = SummaryWriter(str(folder), purge_step=steps)
        self._is_closed = False


def open_curves(folder: Path, before: int, steps: int) -> Logger:
    """Opens the curves of a run that goes on after `steps`, the run in the folder before it having taken `before`.

    They are in progress-N.csv for N = before + steps > 0, else in progress.csv. Rows of the same run from there on,
    which a process wrote that did not keep its steps, are taken out of the earlier files. Events of another run are in
    a folder of their own.
    """
    for path in folder.glob("progress*.csv"):
        first = path.stem.removeprefix("progress").removeprefix("-") or "0"
        if is_count(first) and before <= int(first) < before + steps and not path.is_symlink():
            _cut(path, steps)
    path = folder / (f"progress-{before + steps}.csv" if before + steps else "progress.csv")
    path.unlink(missing_ok=True)  # it may be a link to a file of somebody's
    events = folder / f"after-{before}" if before else folder
    return Logger(str(folder), [CSVOutputFormat(str(path)), Events(events, steps)])


def _cut(path: Path, steps: int) -> None:
    """Takes the rows after so many steps out of a file."""
    names, *rows = [*table_lines(path)] or [[]]
    if STEPS not in names:
        return
    column = names.index(STEPS)
    rows = [row for row in rows if len(row) == len(names) and row[column] and float(row[column]) <= steps]
    with path.open("w", newline="", encoding="utf-8") as file:
        csv.writer(file, lineterminator="\n").writerows([names, *rows])

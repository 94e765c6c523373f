"""One by one: the mover of arms by any method, with a run for each; see `movers`."""

from typing import Any

import numpy as np

from flexman_gym.arrays import Array
from flexman_gym.kernels import layout, tip
from flexman_gym.kernels.arms import PER_ARM
from flexman_gym.kernels.layout import Constants, IntArray
from flexman_gym.scene.drive import drive_table
from flexman_gym.simulation.run import Run

Trail = tuple[Array, Array]  # rows (b, T, 2 d + 2) and outputs (b, T, OUTPUTS) after each of T periods


class OneByOne:
    """A mover with one `Run` for each arm."""

    kept = ("own",)

    def __init__(self, runs: list[Run], period: tuple[float, int]) -> None:
        self._runs = runs
        for run in runs:
            run.constants = run.constants._replace(**own_constants(run.constants))
        self._step, self._substeps = period[0] / period[1], period[1]
        self._period = period[0]
        self._drive = drive_table([None] * (len(runs[0].constants.mass) + 6))

    def vary(self, arms: IntArray, constants: dict[str, Array]) -> None:
        """Gives arms constants of their own."""
        for i, arm in enumerate(arms):
            own = {name: values[i] for name, values in constants.items()}
            self._runs[arm].constants = self._runs[arm].constants._replace(**own)

    def constants(self, arm: int) -> dict[str, Any]:
        """Gives copies of the constants that an arm has of its own."""
        return own_constants(self._runs[arm].constants)

    @property
    def own(self) -> list[dict[str, Array]]:
        """What each arm has of its own: constants, and what its method remembers from step to step."""
        return [
            {name: getattr(run.constants, name) for name in sorted(PER_ARM)}
            | {"pace": run.work.pace, "stages": run.work.stages}
            for run in self._runs
        ]

    def observe(self, arms: IntArray, rows: Array, outputs: Array) -> None:
        """Reads the outputs of some arms."""
        for arm in arms:
            self._runs[arm].start(rows[arm], rows[arm].copy(), outputs[arm])

    def forget(self, arms: IntArray) -> None:
        """Forgets what methods remember from step to step of some arms."""
        for arm in arms:
            self._runs[arm].forget()

    def move(self, drives: Array, periods: Array, rows: Array, outputs: Array, status: IntArray) -> None:
        """Moves the arms whose status is OK."""
        row, result = np.zeros((1, rows.shape[1])), np.zeros((1, layout.OUTPUTS))
        for arm in np.flatnonzero(status == layout.OK):
            self._drive[layout.OFFSET] = drives[arm]
            moment, state = (periods[arm] * self._period, self._step, self._substeps), rows[arm].copy()
            status[arm] = self._runs[arm](self._drive, moment, state, row, result)[0]
            if status[arm] == layout.OK:
                rows[arm], outputs[arm] = state, result[0]

    def roll(self, drives: Array, periods: Array, rows: Array, outputs: Array, status: IntArray, trail: Trail) -> None:
        """Moves the arms whose status is OK through periods of drives (b, T, n + 6)."""
        roll_by_periods(self, drives, periods, (rows, outputs, status), trail)

    def sense(self, drives: Array, rows: Array, result: Array) -> None:
        """Finds the tip accelerations of all arms."""
        d = rows.shape[1] // 2 - 1
        for run, drive, row, out in zip(self._runs, drives, rows, result, strict=True):
            tip.tip_accelerations(run.constants, run.work, row[:d], row[d : 2 * d], drive, out)


def own_constants(constants: Constants) -> dict[str, Any]:
    """Gives copies of the constants that arms may differ in."""
    return {name: getattr(constants, name).copy() for name in PER_ARM}


def roll_by_periods(
    mover: Any, drives: Array, periods: Array, moved: tuple[Array, Array, IntArray], trail: Trail
) -> None:
    """Lets a mover move rows, outputs and status of its arms period by period, and keeps the trail."""
    rows, outputs, status = moved
    for period in range(drives.shape[1]):
        mover.move(drives[:, period], periods + period, rows, outputs, status)
        well = status == layout.OK
        trail[0][well, period], trail[1][well, period] = rows[well], outputs[well]

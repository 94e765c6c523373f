"""Sampled motions of joints: CSV files with units, and JointTrajectory messages of ROS as YAML or JSON."""

import copy
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple, Self

import numpy as np

from flexman_gym.common.arrays import Array
from flexman_gym.common.checks import positive
from flexman_gym.common.errors import value_error
from flexman_gym.common.files import read_data, write_csv, write_data
from flexman_gym.common.tables import is_table, table_name
from flexman_gym.common.time_series import TimeSeries, listed
from flexman_gym.toolbox.controllers.input_shaping.joint_trajectory import read_trajectory, replace_points
from flexman_gym.toolbox.controllers.input_shaping.waypoints import Waypoints

ORDERS = {"rad": 0, "m": 0, "rad/s": 1, "m/s": 1, "rad/s^2": 2, "m/s^2": 2}  # unit -> number of derivatives by time


class Motion(NamedTuple):
    """Positions, and where given velocities and accelerations, of joints in equal steps of time, at rest at both ends.

    Attributes:
        start: first time, s.
        period: step, s.
        values: (T, c) columns in SI units.
        orders: (c,) number of derivatives by time of each column, 0 for positions.
        source: path of the file.
        form: headers and factors of their units of a CSV file, or the content of a YAML or JSON file.
        remarks: how the file was read, and what was changed or left out, of one line each.
    """

    start: float
    period: float
    values: Array
    orders: tuple[int, ...]
    source: Path
    form: Mapping[str, Any]
    remarks: tuple[str, ...] = ()

    @property
    def positions(self) -> Array:
        """Columns (T, n) of positions."""
        return self.values[:, np.array(self.orders) == 0]

    @property
    def duration(self) -> float:
        """Time from the first to the last sample, s."""
        return self.period * (len(self.values) - 1)

    @classmethod
    def read(cls, path: Path, rate: float | None = None, columns: Sequence[str] | None = None) -> Self:
        """Read a motion from a CSV file with units, or from a message of ROS with a JointTrajectory (YAML, JSON).

        Points in unequal steps are resampled along the curve of `Waypoints.curve`.

        Args:
            path: path of the file.
            rate: samples per second, Hz; None for those of the file, at its median step.
            columns: names of the columns of a CSV file; None for all positions, velocities and accelerations.

        Raises:
            FileNotFoundError: if the file does not exist.
            ValueError: as in `read_time_series`, `read_trajectory` and `Waypoints.of`.
        """
        if rate is not None:
            positive("rate", rate, "Hz")
        if is_table(path):
            return cls._of_table(path, rate, columns)
        try:
            form = read_data(path)
            points, orders = read_trajectory(path.name, form)
            period, values, notes = points.sampled(orders, rate)
        except ValueError as error:
            name = path.name
            raise ValueError(str(error) if str(error).startswith(name) else f"{name}: {error}") from None
        joints = values.shape[2]
        table = np.concatenate(list(values), axis=1)
        remarks = tuple(f"{path.name}: {note}" for note in notes)
        return cls(
            float(points.times[0]), period, table, tuple(np.repeat(orders, joints).tolist()), path, form, remarks
        )

    @classmethod
    def _of_table(cls, path: Path, rate: float | None, columns: Sequence[str] | None) -> Self:
        """Read a motion from a CSV file."""
        name, everything = table_name(path), TimeSeries.read(path)
        others = [each for each, (unit, _) in everything.columns.items() if unit and unit not in ORDERS]
        series = everything.select(columns, tuple(ORDERS))
        remarks = series.remarks
        if others and columns is None:
            remarks.append(f"{name}: {', '.join(others)} not read: neither position, velocity nor acceleration")
        orders = np.array([ORDERS[unit] for unit, _ in series.columns.values()])
        n = int((orders == 0).sum())
        if not n:
            raise value_error(f"{name}: the columns", list(series.columns), "at least one position (rad or m)")
        paired = [order for order in set(orders.tolist()) if (orders == order).sum() == n]
        given = np.full((3, len(series.times), n), np.nan)
        for order in paired:
            given[order] = series.table[:, orders == order]
        points = Waypoints.of(name, series.times, given)
        period, sampled, notes = points.sampled(tuple(paired), rate)
        values = np.zeros((sampled.shape[1], len(orders)))
        times = points.times[0] + period * np.arange(len(values))
        for i, column in enumerate(series.table.T):  # those that belong to no position are interpolated linearly
            values[:, i] = np.interp(times, series.times, column)
        for order, columns_ in zip(paired, sampled, strict=True):
            values[:, orders == order] = columns_
        if alone := [each for each, order in zip(series.columns, orders, strict=True) if order not in paired]:
            notes = (*notes, f"{listed(alone)} taken as lines between samples: not one for each position")
        remarks += [f"{name}: {note}" for note in notes]
        return cls(times[0], period, values, tuple(orders.tolist()), path, series.headers, tuple(remarks))

    def write(self, path: Path) -> None:
        """Write the motion with the columns and units, or the fields, of its file."""
        times = np.asarray(self.start + self.period * np.arange(len(self.values)), dtype=np.float64)
        if is_table(self.source):
            table = dict(zip([name for name in self.form if name != "time"], self.values.T, strict=True))
            table["time"] = times
            write_csv(path, {header: table[name] / factor for name, (header, factor) in self.form.items()})
            return
        form = copy.deepcopy(dict(self.form))
        orders = sorted(set(self.orders))
        replace_points(form, times, dict(zip(orders, np.split(self.values, len(orders), axis=1), strict=True)))
        write_data(path, form)

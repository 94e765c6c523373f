"""Sampled motions of joints: CSV files with units, and JointTrajectory messages of ROS 2 as YAML or JSON."""

import copy
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple, Self

import numpy as np

from flexman_gym.common.arrays import Array
from flexman_gym.common.checks import mapping, number_array, sequence, value_error, whole_number
from flexman_gym.common.files import read_data, write_data
from flexman_gym.common.time_series import read_time_series, uniform_period, write_csv

ORDERS = {"rad": 0, "m": 0, "rad/s": 1, "m/s": 1, "rad/s^2": 2, "m/s^2": 2}  # unit -> number of derivatives by time
ROS_FIELDS = {"positions": 0, "velocities": 1, "accelerations": 2}  # field of a point -> number of derivatives by time
REST_RATE = 0.05  # fraction of the largest rate; smaller rates at the ends are rest


class Motion(NamedTuple):
    """Positions, and where given velocities and accelerations, of joints in equal steps of time, at rest at both ends.

    Attributes:
        start: first time, s.
        period: step, s.
        values: (T, c) columns in SI units.
        orders: (c,) number of derivatives by time of each column, 0 for positions.
        source: path of the file.
        form: headers and factors of their units of a CSV file, or the content of a YAML or JSON file.
    """

    start: float
    period: float
    values: Array
    orders: tuple[int, ...]
    source: Path
    form: Mapping[str, Any]

    @property
    def positions(self) -> Array:
        """Columns (T, n) of positions."""
        return self.values[:, np.array(self.orders) == 0]

    @property
    def duration(self) -> float:
        """Time from the first to the last sample, s."""
        return self.period * (len(self.values) - 1)

    @classmethod
    def read(cls, path: Path) -> Self:
        """Read a motion from a CSV file with units in its header, or from a JointTrajectory of ROS 2 (YAML, JSON).

        Raises:
            ValueError: for times in unequal steps, no column of positions, and a motion that starts or ends in motion.
        """
        name = path.name
        if path.suffix == ".csv":
            series = read_time_series(path)
            units = {column: unit for column, (unit, _) in series.columns.items()}
            for column, unit in units.items():
                if unit not in ORDERS:
                    raise value_error(f"{name}: the unit of {column}", unit, f"one of {', '.join(ORDERS)}")
            times, form = series.times, series.headers
            values = np.column_stack([each for _, each in series.columns.values()])
            orders = tuple(ORDERS[unit] for unit in units.values())
        else:
            try:
                form = read_data(path)
                times, values, orders = _read_points(form)
            except ValueError as error:
                raise ValueError(f"{name}: {error}") from None
        result = cls(float(times[0]), uniform_period(name, times), values, orders, path, form)
        if 0 not in orders:
            raise value_error(f"{name}: the columns", list(form), "at least one position (rad or m)")
        result._check_rest(name)
        return result

    def _check_rest(self, name: str) -> None:
        """Raise a ValueError for a motion that starts or ends in motion, by differences and their extrapolation."""
        rates = np.diff(self.positions, axis=0) / self.period
        limit = REST_RATE * np.abs(rates).max()
        if limit == 0.0:
            raise ValueError(f"{name}: a motion at rest is not allowed; give one that moves")
        for place, (outer, inner) in {"start": rates[:2], "end": rates[:-3:-1]}.items():
            speed = np.minimum(np.abs(outer), np.abs(1.5 * outer - 0.5 * inner)).max()
            if speed > limit:
                allowed = "a motion that starts and ends at rest; otherwise its ends set the vibration"
                raise value_error(f"{name}: the speed at the {place}", f"{speed:.3g} rad/s or m/s", allowed)

    def write(self, path: Path) -> None:
        """Write the motion with the columns and units of its file."""
        times = self.start + self.period * np.arange(len(self.values))
        if self.source.suffix == ".csv":
            table = dict(zip([name for name in self.form if name != "time"], self.values.T, strict=True))
            table["time"] = times
            write_csv(path, {header: table[name] / factor for name, (header, factor) in self.form.items()})
            return
        form = copy.deepcopy(dict(self.form))
        message = form.get("joint_trajectory", form)
        fields = [name for name, order in ROS_FIELDS.items() if order in self.orders]
        parts = np.split(self.values, len(fields), axis=1)
        like = message["points"][0]["time_from_start"]
        message["points"] = [
            {name: part[row].tolist() for name, part in zip(fields, parts, strict=True)}
            | {"time_from_start": _duration(float(time), like)}
            for row, time in enumerate(times)
        ]
        write_data(path, form)


def _read_points(data: Mapping[str, Any]) -> tuple[Array, Array, tuple[int, ...]]:
    """Return times (T,), values (T, c) and orders of the columns of a JointTrajectory."""
    message = data.get("joint_trajectory", data)
    if not isinstance(message, Mapping) or not {"joint_names", "points"} <= message.keys():
        raise value_error("the fields", list(data), "joint_names and points of a JointTrajectory")
    points, joints = sequence("points", message["points"]), len(sequence("joint_names", message["joint_names"]))
    known = (*ROS_FIELDS, "effort", "time_from_start")
    checked = [mapping(f"points[{i}]", point, known) for i, point in enumerate(points)]
    if not checked or any(point.get("effort") for point in checked):
        raise value_error("points", "efforts" if checked else "no point", "points with positions and without effort")
    fields = [name for name in ROS_FIELDS if checked[0].get(name)]
    times, rows = [], []
    for i, point in enumerate(checked):
        times.append(_seconds(f"points[{i}].time_from_start", point.get("time_from_start")))
        parts = [
            number_array(f"points[{i}].{name}", point.get(name), (joints,), f"{joints} finite numbers, one a joint")
            for name in fields or ("positions",)
        ]
        rows.append(np.concatenate(parts))
    return np.array(times), np.array(rows), tuple(ROS_FIELDS[name] for name in fields for _ in range(joints))


def _seconds(name: str, value: object) -> float:
    """Return a duration of ROS, seconds and nanoseconds or a number, in s."""
    if isinstance(value, Mapping) and len(value) == 2:
        whole, parts = ("sec", "nanosec") if "sec" in value else ("secs", "nsecs")
        checked = mapping(name, value, (whole, parts))
        seconds, rest = checked.get(whole), checked.get(parts)
        return whole_number(f"{name}.{whole}", seconds, 0, 10**9) + 1e-9 * whole_number(
            f"{name}.{parts}", rest, 0, 10**9
        )
    return float(number_array(name, [value], (1,), "seconds, or sec and nanosec")[0])


def _duration(time: float, like: object) -> Any:
    """Return a time (s) in the form of another duration of ROS."""
    if not isinstance(like, Mapping):
        return round(time, 9)
    names = ("sec", "nanosec") if "sec" in like else ("secs", "nsecs")
    return dict(zip(names, divmod(round(1e9 * time), 10**9), strict=True))

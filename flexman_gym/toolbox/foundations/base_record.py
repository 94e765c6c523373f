"""Recorded motion of the base of an arm, from a CSV file: the bed of a truck, a floor in an earthquake, a deck."""

from dataclasses import dataclass
from functools import cache
from typing import Any, ClassVar

import numpy as np

from flexman_gym.common.arrays import Array
from flexman_gym.common.checks import one_of, set_fields, text
from flexman_gym.common.errors import value_error
from flexman_gym.toolbox.foundations.base_motion import ANGLES, FRAMES, LENGTHS, PrescribedMotion


@dataclass(frozen=True)
class Record(PrescribedMotion):
    """Motion of the base from a record, the same in each episode; an agent does not command it.

    Columns surge, sway, heave (m, mm) and roll, pitch, yaw (rad, deg) of a CSV file over time; missing ones are zero. A
    cubic spline passes through the samples, at rest at both ends; before and after the record the base rests. See
    `base_motion.BaseMotion`.

    Attributes:
        file: path of the CSV file.
        start: time of the record at which an episode starts, s.
        target: frame in which the target of a task rests, "world" or "base".
    """

    kind: ClassVar[str] = "record"
    parameter: ClassVar[str] = "record_start"
    file: str
    start: float = 0.0
    target: str = "world"

    def __post_init__(self) -> None:
        set_fields(self, file=text("Record.file", self.file))
        one_of("Record.target", self.target, FRAMES)
        times, _ = _read(self.file)
        if not times[0] <= self.start <= times[-1]:
            allowed = f"a time of the record, from {times[0]:g} to {times[-1]:g} (s)"
            raise value_error("Record.start", self.start, allowed)

    @property
    def largest(self) -> Array:
        """Bounds (3, 6) of the motions, their rates and their accelerations: twice those at the samples."""
        times, spline = _read(self.file)
        return 2.0 * np.array([np.abs(spline(times, order)).max(axis=0) for order in range(3)])

    def draw(self, random: np.random.Generator) -> Array:
        """Return the start (1,) of an episode in the record, s; options of a reset may replace it."""
        return np.array([self.start])

    def motion(self, drawn: Array, times: Array) -> tuple[Array, Array, Array]:
        """Return motions (r, 6), m and rad, rates and accelerations at times (r,), s, after starts (r, 1), s."""
        (first, *_, last), spline = _read(self.file)
        at = drawn[:, 0] + times
        inside = ((at >= first) & (at <= last))[:, None]
        pose, rate, acceleration = (spline(np.clip(at, first, last), order) for order in range(3))
        return pose, rate * inside, acceleration * inside


@cache
def _read(path: str) -> tuple[Array, Any]:
    """Return the times (T,), s, of a record, and the spline of its motions (6,), m and rad.

    Raises:
        FileNotFoundError: if the file does not exist.
        ValueError: for a file without one of the columns, or with another unit.
    """
    from scipy.interpolate import CubicSpline

    from flexman_gym.common.time_series import TimeSeries

    series = TimeSeries.read(path)
    units = dict.fromkeys(LENGTHS, "m") | dict.fromkeys(ANGLES, "rad")
    found = {name: column for name, column in series.columns.items() if name in units}
    if not found:
        raise value_error("Record.file", path, f"a file with some of the columns {', '.join(units)}")
    values = np.zeros((len(series.times), len(units)))
    for i, (name, unit) in enumerate(units.items()):
        own, column = found.get(name, (unit, values[:, i]))
        if own != unit:
            raise value_error("Record.file", f"{path}: {name} in {own or 'no unit'}", f"{name} in {unit}")
        values[:, i] = column
    if len(series.times) < 2 or not np.isfinite(values).all():
        raise value_error("Record.file", path, "a file with at least two samples, and a number in each of them")
    return series.times, CubicSpline(series.times, values, bc_type="clamped")

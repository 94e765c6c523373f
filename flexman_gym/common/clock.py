"""Times of records: the column of the time, its unit, and steps that are equal, rounded or vary."""

from collections.abc import Mapping, Sequence
from datetime import datetime
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from flexman_gym.common.arrays import Array, Vector
from flexman_gym.common.errors import value_error
from flexman_gym.common.units import UNITS, find_unit, is_counter, name_parts

MIN_SAMPLES = 4  # times of a record in equal steps
MAX_JITTER = 0.5  # fraction of the typical step by which steps may differ from it in a record that is interpolated
MAX_ROUNDING = 0.4  # resolution of rounded times / step, below which a lost sample shows
EQUAL = 1e-3  # fraction of a step; smaller deviations from equal steps are left as they are
TIME_NAMES = frozenset((
    "time", "t", "zeit", "temps", "tiempo", "tempo", "timestamp", "timestamps", "time stamp", "stamp", "elapsed",
    "elapsed time", "seconds elapsed", "clock", "x value", "date", "datetime", "date time",
))  # fmt: skip
TIME_UNITS = ("s", "ms", "us", "ns", "min")
# Unit -> range of typical steps of a time without a unit; between the ranges two units are plausible.
PLAUSIBLE_STEPS = {"s": (1e-6, 0.5), "ms": (2.0, 50.0), "us": (200.0, 5e4), "ns": (2e5, np.inf)}
EPOCHS = {"s": 1e9, "ms": 1e12, "us": 1e15, "ns": 1e18}  # unit -> time since 1970 in the year 2001; four times in 2096
MAX_EPOCH_STEP = 10.0  # s; longest typical step of a record with times since 1970
MAX_SHOWN = 12  # names in an error


class Clock(NamedTuple):
    """Column of the time.

    Attributes:
        column: index of the column.
        times: times (T,), s, NaN where missing.
        unit: its unit.
        notes: assumptions, of one line each.
    """

    column: int
    times: NDArray[np.float64]
    unit: str
    notes: tuple[str, ...]


def find_clock(
    file: str, names: Sequence[tuple[str, str]], values: Array, texts: Mapping[int, list[str]], has_headers: bool
) -> Clock:
    """Find the time among the columns of a table, and its unit.

    The time is the column with such a name whose values increase, or the first column if this increases steadily. A
    time without a unit has that of its name (`micros`), or the one that its size (time since 1970) or step suggests.

    Args:
        file: name of the file, for errors.
        names: name and unit of each column (c,), "" where missing.
        values: numbers (T, c).
        texts: cells (T,) of the columns without numbers.
        has_headers: False if the file has no headers.

    Raises:
        ValueError: for no such column, times that decrease, and an unknown or ambiguous unit.
    """
    named = [i for i, (name, _) in enumerate(names) if is_time(name) and not _is_empty(values, texts, i)]
    errors: list[ValueError] = []
    for i in named:
        try:
            return _named_clock(file, i, *names[i], values[:, i], texts.get(i))
        except ValueError as error:
            errors.append(error)
    if errors:
        raise errors[0]
    first = next((i for i, (name, _) in enumerate(names) if not (has_headers and is_counter(name))), 0)
    if first in texts or not _is_steady(values[:, first]):
        listed = ", ".join(name for name, _ in names[:MAX_SHOWN]) + (", ..." if len(names) > MAX_SHOWN else "")
        raise ValueError(f"{file}: none of {listed} is the time; give a column time (s) of increasing numbers")
    unit, notes = _unit(file, *names[first], values[:, first])
    line = "no headers: the first column is the time" if not has_headers else f"{names[first][0]} is taken as the time"
    return Clock(first, values[:, first] * UNITS[unit][1], unit, (f"{line}, as it increases steadily", *notes))


def join_seconds(names: Sequence[tuple[str, str]], values: Array) -> list[int]:
    """Add columns of nanoseconds to those of their seconds (stamps of ROS); return the indices of the former."""
    joined, split = [], [name_parts(name) for name, _ in names]
    seconds = {(*parts[:-1],): i for i, parts in enumerate(split) if parts and find_unit(parts[-1]) == "s"}
    for i, parts in enumerate(split):
        if parts and find_unit(parts[-1]) == "ns" and (*parts[:-1],) in seconds:
            values[:, seconds[*parts[:-1],]] += 1e-9 * values[:, i]
            joined.append(i)
    return joined


def is_time(name: str) -> bool:
    """Return True for the name of a time, such as "Time Stamp", "t_ms", "micros" or "Latest: Time"."""
    parts = name_parts(name)
    if parts[:1] != ["t"]:  # t_1 may be a temperature
        parts = [part for part in parts if not part.isdigit()]
    while len(parts) > 1 and find_unit(parts[-1]) in TIME_UNITS:
        parts = parts[:-1]
    whole = " ".join(parts)
    return whole in TIME_NAMES or find_unit(whole) in TIME_UNITS or parts[-1:] in (["time"], ["timestamp"], ["stamp"])


def step_text(step: float) -> str:
    """Return a step of time (s) with a suitable unit."""
    unit = next((each for each in ("s", "ms") if step >= 0.9995 * UNITS[each][1]), "us")
    return f"{step / UNITS[unit][1]:.4g} {unit}"


class Sampling(NamedTuple):
    """Steps of increasing times.

    Attributes:
        period: mean step, s.
        is_equal: True if the steps are equal but for the rounding of the times.
        rounding: resolution of rounded times, s; 0 where the times are equal steps, or vary.
        jitter: largest difference between a step and the median step / median step.
    """

    period: float
    is_equal: bool
    rounding: float
    jitter: float

    @classmethod
    def of(cls, times: Vector, tolerance: float = EQUAL) -> "Sampling":
        """Return the sampling of times (T,), T > 1; equal steps deviate by a fraction `tolerance` of a step at most."""
        moments = np.asarray(times, dtype=np.float64)
        count, steps = np.arange(len(moments)), np.diff(moments)
        period, median = float(moments[-1] - moments[0]) / (len(moments) - 1), float(np.median(steps))
        jitter = float(np.abs(steps / median - 1.0).max()) if median > 0.0 else np.inf
        away = moments - moments[0] - period * count
        accuracy = 4.0 * np.spacing(np.abs(moments).max())
        if np.ptp(away) <= tolerance * period + accuracy:
            return cls(period, True, 0.0, jitter)
        slope = float(np.polyfit(count - count.mean(), moments - moments[0], 1)[0])
        away, rounding = moments - moments[0] - slope * count, _resolution(moments - moments[0], accuracy)
        is_rounded = np.ptp(away) <= 1.5 * rounding and (rounding <= MAX_ROUNDING * slope or (steps == 0.0).any())
        return cls(slope if is_rounded else period, bool(is_rounded), rounding if is_rounded else 0.0, jitter)


class EqualTimes(NamedTuple):
    """Times of a record in equal steps.

    Attributes:
        times: times (T,), s, in equal steps.
        is_interpolated: True if the values of the record have to be interpolated at these times.
        note: remark about the change, "" without one.
    """

    times: Array
    is_interpolated: bool
    note: str

    @classmethod
    def of(cls, name: str, times: Vector) -> "EqualTimes":
        """Return equal steps for times (T,), s, whose steps may differ from the median step by MAX_JITTER of it.

        The period is the mean step, so that no drift of a clock accumulates. Times in equal steps that were rounded are
        replaced without interpolation.

        Args:
            name: name of the record, for errors.
            times: (T,) s.

        Raises:
            ValueError: for less than MIN_SAMPLES or decreasing times, and for larger gaps.
        """
        moments = np.asarray(times, dtype=np.float64)
        steps = np.diff(moments)
        if len(moments) < MIN_SAMPLES or (steps < 0.0).any():
            wrong = int(np.argmax(steps < 0.0)) + 1 if len(moments) >= MIN_SAMPLES else 0
            given = f"{moments[wrong]:.10g} after {moments[wrong - 1]:.10g} s" if wrong else f"{len(moments)} times"
            raise value_error(f"{name}: time", given, f"at least {MIN_SAMPLES} increasing times")
        found = Sampling.of(moments)
        even = moments[0] + found.period * np.arange(len(moments))
        if found.rounding:
            line = f"times rounded to {step_text(found.rounding)} are read as equal steps of {step_text(found.period)}"
            return cls(even, False, line)
        if found.is_equal:
            return cls(moments, False, "")
        if found.jitter > MAX_JITTER:
            raise _gap_error(name, moments)
        span = f"{step_text(steps.min())} to {step_text(steps.max())}"
        line = f"steps of {span}, up to {100 * found.jitter:.2g} % from the median, are interpolated to equal ones"
        return cls(np.minimum(even, moments[-1]), True, f"{line} of {step_text(found.period)}")


def _gap_error(name: str, times: Array) -> ValueError:
    """Return the error of times with gaps, with the longest part of the record without any."""
    steps = np.diff(times)
    typical = float(np.median(steps[steps > 0.0]))
    wide = np.flatnonzero(np.abs(steps - typical) > MAX_JITTER * typical)
    worst = int(np.argmax(np.abs(steps - typical)))
    edges = np.concatenate([[-1], wide, [len(steps)]])
    part = int(np.diff(edges).argmax())
    start, stop = times[edges[part] + 1], times[edges[part + 1]]
    given = f"a step of {step_text(float(steps[worst]))} after {times[worst]:.6g} s"
    allowed = (
        f"steps of {step_text(typical)} +- {100 * MAX_JITTER:.0f} %, such as the part from {start:.6g} to {stop:.6g} s"
    )
    return value_error(f"{name}: time", given, allowed)


def _resolution(times: Array, accuracy: float) -> float:
    """Return the largest power of ten (s) of which all times are multiples, 0 without."""
    for digits in range(10):
        scaled = times * 10.0**digits
        if np.abs(scaled - np.round(scaled)).max() <= 1e-3 + accuracy * 10.0**digits < 0.1:
            return float(10.0**-digits)
    return 0.0


def _is_empty(values: Array, texts: Mapping[int, list[str]], i: int) -> bool:
    """Return True for a column without numbers and text."""
    return not any(map(str.strip, texts[i])) if i in texts else bool(np.isnan(values[:, i]).all())


def _named_clock(
    file: str, i: int, name: str, unit: str, column: NDArray[np.float64], cells: Sequence[str] | None
) -> Clock:
    """Return the clock of a column named as a time; raise a ValueError if it is none."""
    if unit and unit not in TIME_UNITS:
        raise value_error(f"{file}: the unit of {name}", unit, f"one of {', '.join(TIME_UNITS)}")
    if cells is not None:
        column, unit, notes = _dates(file, name, cells), "s", [f"{name} is read in s from its first date"]
    else:
        unit, notes = _unit(file, name, unit, column)
    known = column[np.isfinite(column)]
    falls = np.flatnonzero(np.diff(known) < 0.0)
    if len(falls):
        given = f"{known[falls[0] + 1]:.10g} after {known[falls[0]]:.10g}"
        raise value_error(f"{file}: {name}", given, "one record with increasing times")
    if len(known) > 1 and known[0] == known[-1]:
        raise value_error(f"{file}: {name}", f"{known[0]:.10g} in all lines", "increasing times")
    return Clock(i, column * UNITS[unit][1], unit, tuple(notes))


def _is_steady(column: Array) -> bool:
    """Return True for numbers that increase in similar steps."""
    known = column[np.isfinite(column)]
    steps = np.diff(known)
    return len(known) > MIN_SAMPLES - 1 and bool((steps > 0.0).all() and steps.max() <= 4.0 * np.median(steps))


def _unit(file: str, name: str, unit: str, column: Array) -> tuple[str, list[str]]:
    """Return the unit of the time, and the reason if it is not that of the header."""
    parts = name_parts(name)
    of_name = find_unit(parts[-1]) if parts and name.lower() != "min" else None
    if unit or of_name in TIME_UNITS:
        return unit or str(of_name), []
    known = column[np.isfinite(column)]
    start, steps = abs(float(known[0])), np.diff(known)
    step = float(np.median(steps[steps > 0.0])) if (steps > 0.0).any() else 0.0
    for each, least in EPOCHS.items():
        if least <= start < 4.0 * least and step * UNITS[each][1] < MAX_EPOCH_STEP:
            return each, [f"{name} has no unit: taken as {each} since 1970 by its size"]
    for each, (low, high) in PLAUSIBLE_STEPS.items():
        if low <= step <= high:
            return each, [f"{name} has no unit: taken as {each} by its steps of {step:.4g}"] * (each != "s")
    given = f"steps of {step:.4g} without a unit"
    allowed = f"its unit in the headers, such as {name} (ms), one of {', '.join(TIME_UNITS)}"
    raise value_error(f"{file}: {name}", given, allowed)


def _dates(file: str, name: str, cells: Sequence[str]) -> NDArray[np.float64]:
    """Return the seconds (T,) from the first of dates and times such as 2026-03-01 12:00:00.25 or 12:00:00,25."""
    moments = []
    for cell in cells:
        text = cell.strip().replace(",", ".")
        try:
            moments.append(datetime.fromisoformat(text if "-" in text else f"2000-01-01T{text}"))
        except ValueError:
            raise value_error(f"{file}: {name}", cell, "seconds, or dates such as 2026-03-01 12:00:00.25") from None
    return np.array([(each - moments[0]).total_seconds() for each in moments])

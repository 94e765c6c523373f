"""Time series in CSV files, with a name and a unit for each column."""

from collections import Counter
from collections.abc import Collection, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from flexman_gym.common.checks import sequence
from flexman_gym.common.clock import MAX_SHOWN, TIME_UNITS, EqualTimes, find_clock, is_time, join_seconds
from flexman_gym.common.errors import value_error, warn_caller
from flexman_gym.common.tables import Table, read_table, table_name
from flexman_gym.common.units import UNITS, is_command, is_counter, split_header

MAX_MISSING = 0.1  # fraction of the lines without a number in one of the columns; above it, their times differ
Column = tuple[str, NDArray[np.float64]]


class TimeSeries(NamedTuple):
    """Columns of a CSV file over time.

    Attributes:
        path: path of the file.
        times: times (T,), s.
        columns: SI unit, "" for an unknown one, and values (T,) of each column, by its name.
        headers: header and factor of its unit of each column, by its name; "time" among them.
        notes: assumptions, and lines and columns that were not read, of one line each.
    """

    path: Path
    times: NDArray[np.float64]
    columns: Mapping[str, Column]
    headers: Mapping[str, tuple[str, float]]
    notes: tuple[str, ...] = ()

    @classmethod
    def read(cls, path: str | Path) -> "TimeSeries":
        """Read the time and all columns with numbers, NaN where one is missing; see `read_time_series`."""
        table = read_table(path)
        names, notes = _names(table), list(table.notes)
        joined = join_seconds(names, table.values)
        clock = find_clock(table_name(path), names, table.values, table.texts, table.headers is not None)
        columns: dict[str, Column] = {}
        headers: dict[str, tuple[str, float]] = {}
        counts, empty, repeated = Counter({"time": 1}), list[str](), list[str]()
        for i, (name, unit) in enumerate(names):
            header, values = _header(table, i), table.values[:, i]
            has_numbers = bool(np.isfinite(values).any())
            if i == clock.column:
                headers["time"] = header or "time", UNITS[clock.unit][1]
            elif i not in joined and has_numbers:
                label = name
                while label in counts:
                    counts[name] += 1
                    label = f"{name}_{counts[name]}"
                counts[label] = max(counts[label], 1)
                repeated += [label] * (label != name)
                si, factor = UNITS.get(unit, ("", 1.0))
                columns[label], headers[label] = (si, factor * values), (header or label, factor)
            elif i not in joined and (header or i in table.texts):
                empty.append(name)
        notes += [f"{listed(repeated)} read: names that occur again"] * bool(repeated)
        notes += [f"{listed(empty)} not read: no numbers"] * bool(empty)
        if not columns:
            raise value_error(
                f"{table_name(path)}: the columns", [name for name, _ in names], "columns beside the time"
            )
        return cls(Path(path), clock.times, columns, headers, (*notes, *clock.notes))

    @property
    def table(self) -> NDArray[np.float64]:
        """Values (T, c) of all columns."""
        return np.column_stack([values for _, values in self.columns.values()])

    @property
    def remarks(self) -> list[str]:
        """How the file was read, such as "ring.csv: read as time in s, acceleration in g", and its notes."""
        units = {factor: unit for unit in TIME_UNITS for factor in [UNITS[unit][1]]}
        groups: dict[str, list[str]] = {f"in {units[self.headers['time'][1]]}": ["time"]}
        for name in self.columns:
            groups.setdefault(self._in_unit(name), []).append(name)
        parts = [f"{listed(names)} {unit}" for unit, names in groups.items()]
        return [f"{table_name(self.path)}: {line}" for line in (f"read as {', '.join(parts)}", *self.notes)]

    def values(self, units: Sequence[str], columns: Sequence[str] | None = None) -> NDArray[np.float64]:
        """Return the values (T, c) of some columns; see `select`."""
        return self.select(columns, units).table

    def in_equal_steps(self, linear: Collection[str] = ()) -> "TimeSeries":
        """Return the time series in equal steps, by cubic splines where its steps vary; see `EqualTimes`.

        Args:
            linear: columns that may jump, which are interpolated linearly.
        """
        from scipy.interpolate import make_interp_spline

        even = EqualTimes.of(table_name(self.path), self.times)
        columns = dict(self.columns)
        if even.is_interpolated:
            for name, (unit, values) in columns.items():
                order = 1 if name in linear else 3
                columns[name] = unit, make_interp_spline(self.times, values, order)(even.times)
        notes = (*self.notes, even.note) if even.note else self.notes
        return self._replace(times=even.times, columns=columns, notes=notes)

    def warn(self) -> "TimeSeries":
        """Issue a UserWarning for each note; return the time series."""
        for line in self.remarks[1:]:
            warn_caller(line)
        return self

    def select(self, columns: Sequence[str] | None = None, units: Sequence[str] | None = None) -> "TimeSeries":
        """Return the time series of some columns, without the lines in which one of them has no number.

        Args:
            columns: names, with the unit of a column that has none in the file: "q_1" or "q_1 (rad)". None selects all
                columns but counts of lines, other times, and those named as commands, set points or temperatures.
                The latter are selected if there are no others.
            units: SI units of the columns; None for any, even an unknown one.

        Raises:
            ValueError: for an unknown name, another unit, and more than MAX_MISSING of the lines without a number.
        """
        if columns is None:
            return self._readings(units)._complete()
        found: dict[str, Column] = {}
        headers = {**self.headers}
        for i, each in enumerate(sequence("columns", columns, "names")):
            name, unit = self._find(f"columns[{i}]", str(each), units)
            found[name], headers[name] = self.columns[name], self.headers[name]
            if unit:
                si, factor = UNITS[unit]
                found[name], headers[name] = (si, factor * found[name][1]), (f"{headers[name][0]} ({unit})", factor)
            if units is not None and found[name][0] not in units:
                raise self._unit_error([name], units)
        if not found:
            raise value_error(f"{table_name(self.path)}: columns", columns, "at least one name")
        headers = {name: headers[name] for name in ("time", *found)}
        return self._replace(columns=found, headers=headers)._complete()

    def has(self, given: str) -> bool:
        """Return True for the name of a column, perhaps with its unit."""
        try:
            return bool(self._find("", given, None))
        except ValueError:
            return False

    def _find(self, field: str, given: str, units: Sequence[str] | None) -> tuple[str, str]:
        """Return the name of a chosen column, and the given unit if the file has none for it."""
        name, unit = split_header(given)
        of_header = {header: each for each, (header, _) in self.headers.items() if each != "time"}
        of_small = {each.lower(): each for each in self.columns}
        tried = (given, of_header.get(given), of_small.get(given.lower()), name, of_small.get(name.lower()))
        found = next((each for each in tried if each in self.columns), None)
        fitting = [each for each, (known, _) in self.columns.items() if units is None or known in ("", *units)]
        if found not in fitting:
            raise value_error(f"{table_name(self.path)}: {field}", given, f"one of {listed(fitting)}")
        known = self.columns[str(found)][0]
        if name == found and unit and UNITS.get(unit, ("",))[0] != known and (known or unit not in UNITS):
            allowed = f"{found} {self._in_unit(str(found))}, as in the file"
            raise value_error(f"{table_name(self.path)}: {field}", given, allowed)
        return str(found), unit if not known and unit in UNITS else ""

    def _readings(self, units: Sequence[str] | None) -> "TimeSeries":
        """Return the columns of readings in some units."""
        fitting = [name for name, (unit, _) in self.columns.items() if units is None or unit in units]
        if not fitting:
            raise self._unit_error([*self.columns], units or ())
        reasons: dict[str, list[str]] = {}
        without = [] if units is None else [name for name, (unit, _) in self.columns.items() if not unit]
        if without:
            reasons["no known unit"] = without
        for name in fitting:
            values = self.columns[name][1]
            known = values[np.isfinite(values)]
            if is_time(name):
                reasons.setdefault("another time", []).append(name)
            elif is_counter(name) and len(known) > 2 and (np.diff(known) == 1.0).all():
                reasons.setdefault("count of lines", []).append(name)
            elif len(known) < (1.0 - MAX_MISSING) * len(values):
                reasons.setdefault(f"numbers in {100 * len(known) / len(values):.2g} % of the lines", []).append(name)
        kept = [name for name in fitting if not any(name in names for names in reasons.values())]
        commands = [name for name in kept if is_command(name)]
        if commands and len(commands) < len(kept):
            reasons["command, set point or temperature by name"] = commands
            kept = [name for name in kept if name not in commands]
        notes = [f"{listed(names)} not read: {reason}" for reason, names in reasons.items()]
        if not kept:
            raise ValueError(f"{table_name(self.path)}: {'; '.join(notes)}; choose columns (--column, columns=)")
        columns = {name: self.columns[name] for name in kept}
        headers = {name: each for name, each in self.headers.items() if name in kept or name == "time"}
        return self._replace(columns=columns, headers=headers, notes=(*self.notes, *notes))

    def _in_unit(self, name: str) -> str:
        """Return the unit of a column as it is written in the file, with a preposition."""
        unit = split_header(self.headers[name][0])[1]
        return f"in {unit}" if unit else "without a unit"

    def _unit_error(self, names: Sequence[str], units: Sequence[str]) -> ValueError:
        """Return the error of columns without the units that are needed."""
        known = ", ".join(each for each, (si, _) in UNITS.items() if si in units)
        given = listed([f"{name} {self._in_unit(name)}" for name in names])
        allowed = f"columns in one of {known}, in the header or as a chosen column 'NAME (UNIT)'"
        return value_error(f"{table_name(self.path)}: the units", given, allowed)

    def _complete(self) -> "TimeSeries":
        """Return the time series without the lines in which a number is missing."""
        known = np.column_stack([np.isfinite(self.times), np.isfinite(self.table)])
        some, full = known[:, 1:].any(axis=1), known.all(axis=1)
        missing, count = int((some & ~full).sum()), int(some.sum())
        if missing > MAX_MISSING * count:
            given = f"numbers missing in {100 * missing / count:.3g} % of the lines"
            raise value_error(
                f"{table_name(self.path)}: columns",
                given,
                f"at most {100 * MAX_MISSING:.0f} %, or fewer columns (--column, columns=)",
            )
        notes = [f"{len(known) - count} line(s) without numbers in these columns not read"] * (count < len(known))
        if missing:
            first = self.times[int(np.argmax(some & ~full))]
            notes.append(f"{missing} of {count} lines lack a number, the first at {first:.6g} s: not read")
        columns = {name: (unit, values[full]) for name, (unit, values) in self.columns.items()}
        return self._replace(times=self.times[full], columns=columns, notes=(*self.notes, *notes))


def read_time_series(
    path: str | Path, columns: Sequence[str] | None = None, units: Sequence[str] | None = None
) -> TimeSeries:
    """Read columns over time from a CSV file, converted to SI units.

    Separators, decimal commas and comments are found as in `read_table`, the time and its unit as in `find_clock`.
    Units are those of `UNITS`, in the usual spellings, in brackets behind a name, in a line below the headers, or at
    the end of a name such as q_deg. The attribute `notes` lists what was assumed and what was not read.

    Args:
        path: path of the file.
        columns: names of the columns; None for all readings, see `TimeSeries.select`.
        units: SI units that are needed, such as ("rad", "m"); None for any, even an unknown one.

    Raises:
        FileNotFoundError: if the file does not exist.
        ValueError: as in `read_table`, `find_clock` and `TimeSeries.select`, with a one-line message.
    """
    return TimeSeries.read(path).select(columns, units)


def _header(table: Table, i: int) -> str:
    """Return the header of a column with its unit in brackets, "" without."""
    header = table.headers[i] if table.headers else ""
    return f"{header} ({table.units[i]})" if table.units[i] and header else header


def _names(table: Table) -> list[tuple[str, str]]:
    """Return name and unit of each column."""
    pairs = [split_header(_header(table, i)) for i in range(table.values.shape[1])]
    shown = ["".join(sign if sign.isprintable() else "?" for sign in name) for name, _ in pairs]
    return [(name or f"column {i}", unit) for i, (name, (_, unit)) in enumerate(zip(shown, pairs, strict=True), 1)]


def listed(names: Sequence[str]) -> str:
    """Return names as a text, of many the first ones."""
    rest = len(names) - MAX_SHOWN
    return ", ".join(names[:MAX_SHOWN]) + (f" and {rest} more" if rest > 0 else "")

"""Time series in CSV files, with a quantity and a unit for each column."""

import csv
import io
import math
from array import array
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from flexman_gym.common.arrays import Vector
from flexman_gym.common.checks import MAX_ENTRIES, one_of, sequence, short_path, value_error
from flexman_gym.common.files import regular_file, write_file

MAX_CSV_BYTES = 200_000_000  # bytes of a CSV file
MAX_LINE_LENGTH, MAX_HEADER_LENGTH = 100_000, 100  # characters of a line, and of the header of a column
MAX_NAME_LENGTH = 40  # characters of the name of a file in an error
MIN_SAMPLES = 4  # times of a record in equal steps
DEGREE = math.pi / 180.0
# Unit -> SI unit and conversion factor.
UNITS: dict[str, tuple[str, float]] = {
    "s": ("s", 1.0), "ms": ("s", 1e-3), "us": ("s", 1e-6),
    "N m": ("N m", 1.0), "Nm": ("N m", 1.0), "mN m": ("N m", 1e-3), "kN m": ("N m", 1e3),
    "N": ("N", 1.0), "mN": ("N", 1e-3), "kN": ("N", 1e3),
    "rad": ("rad", 1.0), "mrad": ("rad", 1e-3), "deg": ("rad", DEGREE),
    "rad/s": ("rad/s", 1.0), "deg/s": ("rad/s", DEGREE),
    "rad/s^2": ("rad/s^2", 1.0), "deg/s^2": ("rad/s^2", DEGREE),
    "m": ("m", 1.0), "mm": ("m", 1e-3), "m/s": ("m/s", 1.0),
    "m/s^2": ("m/s^2", 1.0), "mm/s^2": ("m/s^2", 1e-3), "g": ("m/s^2", 9.80665),
    "A": ("A", 1.0), "mA": ("A", 1e-3), "J": ("J", 1.0), "1": ("1", 1.0), "um/m": ("1", 1e-6),
}  # fmt: skip


class TimeSeries(NamedTuple):
    """Columns of a CSV file over time.

    Attributes:
        path: path of the file.
        times: times (T,), s.
        columns: SI unit and values (T,) of each column, by its name.
        headers: header and factor of its unit of each column of the file, by its name; "time" among them.
    """

    path: Path
    times: NDArray[np.float64]
    columns: Mapping[str, tuple[str, NDArray[np.float64]]]
    headers: Mapping[str, tuple[str, float]]

    def values(self, units: Sequence[str], names: object = None) -> NDArray[np.float64]:
        """Return the columns `names` (T, c), in units among `units` (SI); for None all columns in these units."""
        available = [name for name, (unit, _) in self.columns.items() if unit in units]
        if not available:
            raise value_error(
                f"{_name(self.path)}: the header", list(self.columns), f"a column in {' or '.join(units)}"
            )
        chosen = available if names is None else sequence("columns", names, "names")
        listed = [one_of(f"{_name(self.path)}: columns[{i}]", name, available) for i, name in enumerate(chosen)]
        return np.column_stack([self.columns[name][1] for name in listed])


def read_time_series(path: str | Path) -> TimeSeries:
    """Read a CSV file with a header such as "time (s),torque_1 (N m)" and one line of numbers per time.

    The column "time" may be at any position. Units must be in `UNITS`; numbers are converted to SI units.

    Args:
        path: path of the file.

    Raises:
        FileNotFoundError: if the file does not exist.
        ValueError: as in `read_csv_rows`, and for a header without a time, with a repeated name or with an unknown
            unit, and for a line without a finite number in each column, with a one-line message: the file, the line
            number and what is allowed. The text of a file without any unit in its header is not shown.
    """
    file, rows, numbers = _name(path), read_csv_rows(path), array("d")
    texts = next(rows, [])
    headers = _headers(file, texts)
    names = [name for name, _, _ in headers]
    if "time" not in names or len(set(names)) < len(names) or len(names) < 2:
        raise value_error(f"{file}: the header", names, "a column time (s) and other columns, each name once")
    for number, row in enumerate(rows, 2):
        if row:
            numbers.extend(numbers_of_line(file, number, row, len(names)))
    count = len(numbers) // len(names)
    if not 0 < count <= MAX_ENTRIES:
        raise value_error(file, f"{count} lines", f"1 to {MAX_ENTRIES} of numbers")
    table = np.array(numbers).reshape(count, -1) * [factor for _, _, factor in headers]
    columns = {name: (unit, table[:, i]) for i, (name, unit, _) in enumerate(headers)}
    unit, times = columns.pop("time")
    one_of(f"{file}: the unit of time", unit, ("s",))
    written = {name: (text.strip(), factor) for text, (name, _, factor) in zip(texts, headers, strict=True)}
    return TimeSeries(Path(path), times, columns, written)


def uniform_period(name: str, times: Vector) -> float:
    """Return the period (s) of times (T,) in equal steps, T > 3, up to rounding by a quarter of a step."""
    moments = np.asarray(times, dtype=np.float64)
    if len(moments) < MIN_SAMPLES or (np.diff(moments) <= 0.0).any():
        wrong = int(np.argmax(np.diff(moments) <= 0.0)) + 1 if len(moments) >= MIN_SAMPLES else 0
        given = f"{moments[wrong]:g} after {moments[wrong - 1]:g} s" if wrong else f"{len(moments)} times"
        raise value_error(f"{name}: time", given, f"at least {MIN_SAMPLES} increasing times")
    period = float(moments[-1] - moments[0]) / (len(moments) - 1)
    if np.abs(moments - moments[0] - period * np.arange(len(moments))).max() > 0.25 * period:
        steps = np.diff(moments)
        raise value_error(f"{name}: time", f"steps of {steps.min():g} to {steps.max():g} s", "equal steps")
    return period


def read_csv_rows(path: str | Path) -> Iterator[list[str]]:
    """Read a CSV file line by line.

    Args:
        path: path of the file.

    Yields:
        list[str]: The entries of a line, the header first.

    Raises:
        FileNotFoundError: if the file does not exist.
        ValueError: for a directory, a device or a pipe, more than 200 MB, more than a million lines (counted before
            parsing), a line of more than 100,000 characters and bytes that are not UTF-8, with a one-line message that
            contains the name of the file but not its text.
    """
    try:
        content = regular_file(path, MAX_CSV_BYTES).read_bytes()
        count = max(content.count(b"\n"), content.count(b"\r"))
        if count > MAX_ENTRIES + 1:
            raise ValueError(f"{count} lines are not allowed; give 1 to {MAX_ENTRIES} of numbers")
        yield from csv.reader(_short_lines(io.TextIOWrapper(io.BytesIO(content), encoding="utf-8-sig", newline="")))
    except (UnicodeDecodeError, csv.Error) as error:
        raise ValueError(f"{_name(path)}: {error}; give UTF-8 text with commas") from None
    except ValueError as error:
        raise ValueError(f"{_name(path)}: {error}") from None


def write_csv(path: str | Path, columns: Mapping[str, Vector]) -> None:
    """Write columns of equal length to a CSV file, with all digits of the numbers.

    Args:
        path: path of the file.
        columns: header, such as "time (s)" -> values (T,).
    """
    table = np.column_stack(list(columns.values()))
    text = io.StringIO(newline="")
    csv.writer(text).writerows([[*columns], *table.tolist()])
    write_file(path, text.getvalue())


def _name(path: str | Path) -> str:
    """Return the name of a file, shortened for an error message."""
    return short_path(Path(path).name, MAX_NAME_LENGTH)


def _short_lines(file: io.TextIOWrapper) -> Iterator[str]:
    """Yield the lines of a file after checking that none is longer than MAX_LINE_LENGTH."""
    while line := file.readline(MAX_LINE_LENGTH + 1):
        if len(line) > MAX_LINE_LENGTH:
            raise ValueError(f"a line of more than {MAX_LINE_LENGTH} characters is not allowed; give shorter lines")
        yield line


def _headers(file: str, headers: Sequence[str]) -> list[tuple[str, str, float]]:
    """Return name, SI unit and conversion factor of each column."""
    pairs = [_split_header(each) for each in headers]
    if not any(unit in UNITS for _, unit in pairs):
        raise ValueError(f"{file}: this is no table; give a header of names and units in brackets, such as time (s)")
    for header, (name, unit) in zip(headers, pairs, strict=True):
        if not name or unit not in UNITS or len(header) > MAX_HEADER_LENGTH:
            allowed = f"a name and a unit in brackets, one of {', '.join(UNITS)}"
            raise value_error(f"{file}: the header", header, allowed)
    return [(name, *UNITS[unit]) for name, unit in pairs]


def _split_header(header: str) -> tuple[str, str]:
    """Return name and unit of a header such as "torque_1 (N m)", "" where missing."""
    whole = header.strip()
    start = max(whole.rfind("("), whole.rfind("["))
    if start < 0 or whole[-1] not in ")]":
        return whole, ""
    unit = whole[start + 1 : -1].replace("*", " ").replace("·", " ").replace("²", "^2")
    return whole[:start].strip(), " ".join(unit.split())


def numbers_of_line(file: str, line: int, row: Sequence[str], count: int) -> list[float]:
    """Return the numbers of a line."""
    try:
        numbers = [float(entry) for entry in row]
    except ValueError:
        numbers = []
    if len(numbers) != count or not all(map(math.isfinite, numbers)):
        raise value_error(f"{file}: line {line}", ",".join(row), f"{count} finite numbers")
    return numbers

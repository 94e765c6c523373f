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
from flexman_gym.common.files import regular_file

MAX_CSV_BYTES = 200_000_000  # of a file
LONGEST_LINE, LONGEST_HEAD = 100_000, 100  # characters of a line, and of the head of a column
LONGEST_NAME = 40  # characters of the name of a file in a refusal
DEGREE = math.pi / 180.0
# What a unit is in SI units, and how many of these.
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
    """Columns against time.

    Attributes:
        path: of the file.
        times: (T,) s.
        columns: name -> its SI unit, and its values (T,) in it.
    """

    path: Path
    times: NDArray[np.float64]
    columns: Mapping[str, tuple[str, NDArray[np.float64]]]

    def values(self, units: Sequence[str], names: object = None) -> NDArray[np.float64]:
        """Gives columns (T, c) whose unit is one of `units`: those with these names, or all for None.

        Raises:
            ValueError: where there are none, and for a name that is not there or has another unit.
        """
        fitting = [name for name, (unit, _) in self.columns.items() if unit in units]
        if not fitting:
            raise value_error(f"{_name(self.path)}: the head", list(self.columns), f"a column in {' or '.join(units)}")
        chosen = fitting if names is None else sequence("columns", names, "names")
        listed = [one_of(f"{_name(self.path)}: columns[{i}]", name, fitting) for i, name in enumerate(chosen)]
        return np.column_stack([self.columns[name][1] for name in listed])


def read_time_series(path: str | Path) -> TimeSeries:
    """Reads a CSV file: a head such as "time (s),torque_1 (N m)", then a line of numbers for each moment.

    The column "time" may stand anywhere. Units are those of `UNITS`; numbers come back in SI units.

    Raises:
        FileNotFoundError: when there is none.
        ValueError: for what `read_csv_rows` refuses, for a head without a time, with a name given twice or with an
            unknown unit, and for a line that has not a finite number in each column; one line names file, line and
            what is allowed. The text of a file in whose head no column has a unit is not shown.
    """
    file, lines, numbers = _name(path), read_csv_rows(path), array("d")
    heads = _heads(file, next(lines, []))
    names = [name for name, _, _ in heads]
    if "time" not in names or len(set(names)) < len(names) or len(names) < 2:
        raise value_error(f"{file}: the head", names, "a column time (s) and others, each name once")
    for number, row in enumerate(lines, 2):
        if row:
            numbers.extend(_numbers(file, number, row, len(names)))
    count = len(numbers) // len(names)
    if not 0 < count <= MAX_ENTRIES:
        raise value_error(file, f"{count} lines", f"1 to {MAX_ENTRIES} of numbers")
    table = np.array(numbers).reshape(count, -1) * [factor for _, _, factor in heads]
    columns = {name: (unit, table[:, i]) for i, (name, unit, _) in enumerate(heads)}
    unit, times = columns.pop("time")
    one_of(f"{file}: the unit of time", unit, ("s",))
    return TimeSeries(Path(path), times, columns)


def read_csv_rows(path: str | Path) -> Iterator[list[str]]:
    """Yield the lines of a CSV file, the head first, as lists of texts.

    Raises:
        FileNotFoundError: when there is none.
        ValueError: for a directory, a device or a pipe, for more than 200 MB, for more than a million lines (which are
            counted before one is parsed), for a line of more than 100,000 characters, and for bytes that are not UTF-8;
            one line with the name of the file and without its text.
    """
    try:
        content = regular_file(path, MAX_CSV_BYTES).read_bytes()
        count = max(content.count(b"\n"), content.count(b"\r"))
        if count > MAX_ENTRIES + 1:
            raise ValueError(f"{count} lines are not allowed; give 1 to {MAX_ENTRIES} of numbers")
        yield from csv.reader(_short(io.TextIOWrapper(io.BytesIO(content), encoding="utf-8-sig", newline="")))
    except (UnicodeDecodeError, csv.Error) as error:
        raise ValueError(f"{_name(path)}: {error}; give UTF-8 text with commas") from None
    except ValueError as error:
        raise ValueError(f"{_name(path)}: {error}") from None


def write_csv(path: str | Path, columns: Mapping[str, Vector]) -> None:
    """Write columns of the same length under their heads, such as "time (s)", with all digits of their numbers.

    Raises:
        OSError: where the file cannot be written.
    """
    table = np.column_stack(list(columns.values()))
    with Path(path).open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(columns)
        writer.writerows(table.tolist())


def _name(path: str | Path) -> str:
    """Return the name of a file, short enough to be followed by a field of it in a refusal."""
    return short_path(Path(path).name, LONGEST_NAME)


def _short(file: io.TextIOWrapper) -> Iterator[str]:
    """Yield the lines of a file, none of which may be longer than LONGEST_LINE."""
    while line := file.readline(LONGEST_LINE + 1):
        if len(line) > LONGEST_LINE:
            raise ValueError(f"a line of more than {LONGEST_LINE} characters is not allowed; give shorter ones")
        yield line


def _heads(file: str, heads: Sequence[str]) -> list[tuple[str, str, float]]:
    """Return name, SI unit and factor of each column."""
    parted = [_parted(each) for each in heads]
    if not any(unit in UNITS for _, unit in parted):
        raise ValueError(f"{file}: this is no table; give a head of names and units in brackets, such as time (s)")
    for head, (name, unit) in zip(heads, parted, strict=True):
        if not name or unit not in UNITS or len(head) > LONGEST_HEAD:
            allowed = f"a name and a unit in brackets, one of {', '.join(UNITS)}"
            raise value_error(f"{file}: the head", head, allowed)
    return [(name, *UNITS[unit]) for name, unit in parted]


def _parted(head: str) -> tuple[str, str]:
    """Return name and unit of a head such as "torque_1 (N m)", "" for what it does not have."""
    whole = head.strip()
    start = max(whole.rfind("("), whole.rfind("["))
    if start < 0 or whole[-1] not in ")]":
        return whole, ""
    unit = whole[start + 1 : -1].replace("*", " ").replace("·", " ").replace("²", "^2")
    return whole[:start].strip(), " ".join(unit.split())


def _numbers(file: str, line: int, row: Sequence[str], count: int) -> list[float]:
    """The numbers of a line."""
    try:
        numbers = [float(entry) for entry in row]
    except ValueError:
        numbers = []
    if len(numbers) != count or not all(map(math.isfinite, numbers)):
        raise value_error(f"{file}: line {line}", ",".join(row), f"{count} finite numbers")
    return numbers

"""Record: numbers against time in a CSV file, whose head names a quantity and its unit for each column."""

import csv
import math
import os
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from flexman_gym.arrays import Vector
from flexman_gym.checks import MOST_ENTRIES, one_of, refusal, sequence, text

HEAD = re.compile(r"\s*(.+?)\s*[(\[]\s*([^()\[\]]+?)\s*[)\]]\s*")  # "torque_1 (N m)"
MOST_BYTES = 200_000_000
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


class Record(NamedTuple):
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
            raise refusal(f"{self.path.name}: the head", list(self.columns), f"a column in {' or '.join(units)}")
        chosen = fitting if names is None else sequence("columns", names, "names")
        listed = [one_of(f"{self.path.name}: columns[{i}]", name, fitting) for i, name in enumerate(chosen)]
        return np.column_stack([self.columns[name][1] for name in listed])


def read_record(path: str | Path) -> Record:
    """Reads a CSV file: a head such as "time (s),torque_1 (N m)", then a line of numbers for each moment.

    The column "time" may stand anywhere. Units are those of `UNITS`; numbers come back in SI units.

    Raises:
        FileNotFoundError: when there is none.
        ValueError: for a head without a time, with a name given twice or with an unknown unit, and for a line that has
            not a finite number in each column; one line names file, line and what is allowed.
    """
    file = Path(path)
    if not os.path.isfile(file):  # whatever the name is
        raise FileNotFoundError(f"{file}: there is no such file")
    if file.stat().st_size > MOST_BYTES:
        raise refusal(file.name, f"{file.stat().st_size} bytes", f"at most {MOST_BYTES}")
    try:
        head, *rows = csv.reader(file.read_text(encoding="utf-8-sig").splitlines() or [""])
    except (UnicodeDecodeError, csv.Error) as error:
        raise ValueError(f"{file.name}: {error}; give UTF-8 text with commas") from None
    heads = [_head(file.name, each) for each in head]
    names = [name for name, _, _ in heads]
    if "time" not in names or len(set(names)) < len(names) or len(names) < 2:
        raise refusal(f"{file.name}: the head", names, "a column time (s) and others, each name once")
    numbers = [_numbers(file.name, number, row, len(names)) for number, row in enumerate(rows, 2) if row]
    if not 0 < len(numbers) <= MOST_ENTRIES:
        raise refusal(f"{file.name}", f"{len(numbers)} lines", f"1 to {MOST_ENTRIES} of numbers")
    table = np.array(numbers) * [factor for _, _, factor in heads]
    columns = {name: (unit, table[:, i]) for i, (name, unit, _) in enumerate(heads)}
    unit, times = columns.pop("time")
    one_of(f"{file.name}: the unit of time", unit, ("s",))
    return Record(file, times, columns)


def write_record(path: str | Path, times: Vector, columns: Mapping[str, Vector]) -> None:
    """Writes times (s) and columns, by heads such as "torque_1 (N m)", with all digits of their numbers."""
    write_columns(path, {"time (s)": times, **columns})


def write_columns(path: str | Path, columns: Mapping[str, Vector]) -> None:
    """Writes columns of the same length under their heads, with all digits: reading them gives the same numbers.

    Raises:
        OSError: where the file cannot be written.
    """
    table = np.column_stack(list(columns.values()))
    with Path(path).open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(columns)
        writer.writerows(table.tolist())


def _head(file: str, head: str) -> tuple[str, str, float]:
    """Name, SI unit and factor of a column."""
    parts = HEAD.fullmatch(text("head", head))
    unit = " ".join(parts[2].replace("*", " ").replace("·", " ").replace("²", "^2").split()) if parts else None
    if parts is None or unit not in UNITS:
        allowed = f"a name and a unit in brackets, one of {', '.join(UNITS)}"
        raise refusal(f"{file}: the head", head, allowed)
    return (parts[1], *UNITS[unit])


def _numbers(file: str, line: int, row: Sequence[str], count: int) -> list[float]:
    """The numbers of a line."""
    try:
        numbers = [float(entry) for entry in row]
    except ValueError:
        numbers = []
    if len(numbers) != count or not all(map(math.isfinite, numbers)):
        raise refusal(f"{file}: line {line}", ",".join(row), f"{count} finite numbers")
    return numbers

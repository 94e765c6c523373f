"""Verification: rows of expected and computed values, their verdicts, and the table that holds them."""

import json
import math
import platform
import re
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path

COLUMNS = ("case", "source", "expected", "computed", "error", "tolerance", "verdict")
PASS, FAIL, SHOWN = "pass", "fail", "shown"
RULE = (
    "The error is relative to the expected value, and absolute where that is 0. "
    'A row without a tolerance is shown and not judged. "Closed form" is solved by the command itself.'
)


@dataclass(frozen=True)
class Row:
    """One number that is known from elsewhere, and what this package computes.

    case       what the number is, with its unit
    source     who says what is expected
    expected   the number
    computed   by this package
    tolerance  the largest error that passes; None for a row that is shown and not judged
    """

    case: str
    source: str
    expected: float
    computed: float
    tolerance: float | None

    @property
    def error(self) -> float:
        """Relative to the expected value, absolute where that is 0."""
        return abs(self.computed - self.expected) / (abs(self.expected) or 1.0)

    @property
    def verdict(self) -> str:
        """Pass, fail or shown; an error that is not a number fails."""
        if self.tolerance is None:
            return SHOWN
        return PASS if self.error <= self.tolerance else FAIL

    def values(self) -> dict[str, str | float | None]:
        """The row by column."""
        return {name: getattr(self, name) for name in COLUMNS}

    def cells(self) -> list[str]:
        """The row as texts, a number with the digits that matter."""
        tolerance = "" if self.tolerance is None else f"{self.tolerance:.1e}"
        numbers = [f"{self.expected:.9g}", f"{self.computed:.9g}", f"{self.error:.1e}", tolerance]
        return [self.case, self.source, *numbers, self.verdict]


def series(case: str, source: str, expected: Iterable[float], computed: Iterable[float], tolerance: float) -> list[Row]:
    """Rows of numbers that belong together; a {} in the case becomes 1, 2, 3 ..."""
    pairs = enumerate(zip(expected, computed, strict=True), start=1)
    return [Row(case.format(i), source, float(e), float(c), tolerance) for i, (e, c) in pairs]


def printed(case: str, source: str, text: str, computed: float) -> Row:
    """A row whose expected value was printed with a few digits: the tolerance is half a unit of the last one."""
    expected, unit = float(text), 10.0 ** -len(text.partition(".")[2])
    return Row(case, source, expected, float(computed), 0.5001 * unit / abs(expected))


def exit_code(rows: Sequence[Row]) -> int:
    """1 when a row fails, or when there is none; else 0."""
    return int(not rows or any(row.verdict == FAIL for row in rows))


def summary(rows: Sequence[Row]) -> str:
    """How many rows pass, fail and are only shown."""
    count = Counter(row.verdict for row in rows)
    judged = count[PASS] + count[FAIL]
    return f"{count[PASS]} of {judged} rows pass, {count[FAIL]} fail; {count[SHOWN]} more are shown without a verdict."


def table(rows: Sequence[Row]) -> str:
    """The rows for a terminal."""
    lines = [list(COLUMNS), *(row.cells() for row in rows)]
    widths = [max(len(line[i]) for line in lines) for i in range(len(COLUMNS))]
    texts = ["  ".join(cell.ljust(width) for cell, width in zip(line, widths, strict=True)) for line in lines]
    return "\n".join([*(text.rstrip() for text in texts), summary(rows)])


def machine() -> dict[str, str]:
    """Processor and versions that computed the rows."""
    information = Path("/proc/cpuinfo")
    found = re.search(r"model name\s*: (.*)", information.read_text() if information.exists() else "")
    names = ("flexman_gym", "numba", "numpy", "scipy")
    processor = found[1] if found else platform.processor() or platform.machine()
    return {"processor": processor, "python": platform.python_version()} | {name: version(name) for name in names}


def markdown(rows: Sequence[Row]) -> str:
    """A page with all rows, without a date, so that it changes only when a number does."""
    lines = ["# Verification", "", f"{summary(rows)} `make verify` writes this page anew.", "", RULE, ""]
    lines += [f"Computed with {machine_text()}.", ""]
    lines += [table_line(COLUMNS), table_line("---" for _ in COLUMNS), *(table_line(row.cells()) for row in rows)]
    return "\n".join(lines) + "\n"


def as_json(rows: Sequence[Row]) -> str:
    """All rows with machine and versions; a number that is not finite is null."""
    clean = [{name: _finite(value) for name, value in row.values().items()} for row in rows]
    return json.dumps({"machine": machine(), "rule": RULE, "rows": clean}, indent=1, allow_nan=False) + "\n"


def machine_text(**more: str) -> str:
    """The same, with more versions, as names and values in a row."""
    return ", ".join(f"{name} {value}" for name, value in (machine() | more).items())


def table_line(cells: Iterable[object]) -> str:
    """One line of a Markdown table."""
    return "| " + " | ".join(str(cell).replace("|", "\\|") for cell in cells) + " |"


def _finite(value: str | float | None) -> str | float | None:
    return None if isinstance(value, float) and not math.isfinite(value) else value

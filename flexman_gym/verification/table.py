"""Verification table: rows of expected and computed values, their verdicts, and the table as text and JSON."""

import json
import math
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from flexman_gym.common.computer import computer_info

COLUMNS = ("case", "source", "expected", "computed", "error", "tolerance", "verdict")
PASS, FAIL, SHOWN = "pass", "fail", "shown"


@dataclass(frozen=True)
class VerificationRow:
    """An expected value from an independent source, and the value that this package computes.

    Attributes:
        case: the quantity, with its unit.
        source: origin of the expected value.
        expected: value from the source.
        computed: value from this package.
        tolerance: the largest error that passes; None for a row that is shown without a verdict.
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


def series_rows(
    case: str, source: str, expected: Iterable[float], computed: Iterable[float], tolerance: float
) -> list[VerificationRow]:
    """Rows of numbers that belong together; a {} in the case becomes 1, 2, 3 ..."""
    pairs = enumerate(zip(expected, computed, strict=True), start=1)
    return [VerificationRow(case.format(i), source, float(e), float(c), tolerance) for i, (e, c) in pairs]


def exit_code(rows: Sequence[VerificationRow]) -> int:
    """Return 1 when a row fails, or when there is no row; else 0."""
    return int(not rows or any(row.verdict == FAIL for row in rows))


RULE = (
    "The error is relative to the expected value, and absolute where that is 0. "
    'A row without a tolerance is shown and not judged. "Closed form" is solved by the command itself.'
)
SUMMARY = "{passed} of {judged} rows pass, {failed} fail. Another {shown} are shown without a verdict."


def summary(rows: Sequence[VerificationRow]) -> str:
    """Return one line with the numbers of rows that pass, fail, and are only shown."""
    count = Counter(row.verdict for row in rows)
    passed, failed = count[PASS], count[FAIL]
    return SUMMARY.format(passed=passed, judged=passed + failed, failed=failed, shown=count[SHOWN])


def format_table(rows: Sequence[VerificationRow]) -> str:
    """Return the rows as a table for a terminal."""
    lines = [list(COLUMNS), *(row.cells() for row in rows)]
    widths = [max(len(line[i]) for line in lines) for i in range(len(COLUMNS))]
    texts = ["  ".join(cell.ljust(width) for cell, width in zip(line, widths, strict=True)) for line in lines]
    return "\n".join([*(text.rstrip() for text in texts), summary(rows)])


def format_json(rows: Sequence[VerificationRow]) -> str:
    """Return all rows with computer and versions as JSON; a number that is not finite is null."""
    clean = [{name: _finite(value) for name, value in row.values().items()} for row in rows]
    return json.dumps({"machine": computer_info(), "rule": RULE, "rows": clean}, indent=1, allow_nan=False) + "\n"


def _finite(value: str | float | None) -> str | float | None:
    return None if isinstance(value, float) and not math.isfinite(value) else value

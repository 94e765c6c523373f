"""Verification: rows of expected and computed values, and their verdicts."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

COLUMNS = ("case", "source", "expected", "computed", "error", "tolerance", "verdict")
PASS, FAIL, SHOWN = "pass", "fail", "shown"


@dataclass(frozen=True)
class Row:
    """One number that is known from elsewhere, and what this package computes.

    Attributes:
        case: what the number is, with its unit.
        source: who says what is expected.
        expected: the number.
        computed: by this package.
        tolerance: the largest error that passes; None for a row that is shown and not judged.
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

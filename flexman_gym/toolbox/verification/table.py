"""Verification table: rows of expected and computed values with a verdict, as text and JSON."""

from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass
from itertools import groupby
from textwrap import wrap
from typing import Self

from flexman_gym.common.computer import computer_info
from flexman_gym.common.formatting import WIDTH, json_text

COLUMNS = ("case", "source", "expected", "computed", "error", "tolerance", "verdict")
PASS, FAIL, SHOWN = "pass", "fail", "shown"


@dataclass(frozen=True)
class VerificationRow:
    """Expected value from an independent source, and the value computed by this package.

    Attributes:
        case: description of the quantity, with its unit.
        source: source of the expected value.
        expected: value from the source.
        computed: value from this package.
        tolerance: largest accepted `error`, 1 or the unit of the case; None for a row without a verdict.
    """

    case: str
    source: str
    expected: float
    computed: float
    tolerance: float | None

    @property
    def error(self) -> float:
        """Error relative to the expected value, or absolute if the expected value is 0."""
        return abs(self.computed - self.expected) / (abs(self.expected) or 1.0)

    @property
    def verdict(self) -> str:
        """Verdict: "pass", "fail" or, without a tolerance, "shown"; an error of NaN fails."""
        if self.tolerance is None:
            return SHOWN
        return PASS if self.error <= self.tolerance else FAIL

    @classmethod
    def printed(cls, case: str, source: str, text: str, computed: float) -> Self:
        """Return a row with a printed expected value; the tolerance is half a unit of its last digit."""
        expected, unit = float(text), 10.0 ** -len(text.partition(".")[2])
        return cls(case, source, expected, float(computed), 0.5001 * unit / abs(expected))

    @classmethod
    def series(
        cls, case: str, source: str, expected: Iterable[float], computed: Iterable[float], tolerance: float
    ) -> list[Self]:
        """Return the rows of a series of values, such as successive frequencies.

        Args:
            case: description of the quantity with its unit; {} is replaced by 1, 2, 3, ...
            source: source of the expected values.
            expected: expected values.
            computed: computed values, of the same number.
            tolerance: largest accepted relative error, 1.
        """
        pairs = enumerate(zip(expected, computed, strict=True), start=1)
        return [cls(case.format(i), source, float(e), float(c), tolerance) for i, (e, c) in pairs]

    def values(self) -> dict[str, str | float | None]:
        """Return column name -> entry of the row, see COLUMNS."""
        return {name: getattr(self, name) for name in COLUMNS}

    def cells(self) -> list[str]:
        """Return the entries of the row as text."""
        tolerance = "" if self.tolerance is None else f"{self.tolerance:.1e}"
        numbers = [f"{self.expected:.9g}", f"{self.computed:.9g}", f"{self.error:.1e}", tolerance]
        return [self.case, self.source, *numbers, self.verdict]


RULE = (
    "Errors are relative to the expected value, or absolute if it is 0. A row without a tolerance has no verdict. "
    'The command computes the values of the source "closed form" itself.'
)
SUMMARY = "{passed} of {evaluated} rows pass, {failed} fail; another {shown} rows have no tolerance."


class VerificationTable(list[VerificationRow]):
    """Rows of a verification, as text and JSON."""

    @property
    def exit_code(self) -> int:
        """Exit status of a command: 1 if a row fails or there is no row, else 0."""
        return int(not self or any(row.verdict == FAIL for row in self))

    def __str__(self) -> str:
        """Return a table for the terminal, and the numbers of rows that pass, that fail, and without a tolerance.

        Cases stand below their source; a case that is too long for a line of 100 characters has several.
        """
        numbers = [COLUMNS[2:], *(row.cells()[2:] for row in self)]
        widths = [max(map(len, column)) for column in zip(*numbers, strict=True)]
        room = WIDTH - sum(width + 2 for width in widths)
        ends = ["".join(f"  {cell:>{width}}" for cell, width in zip(line, widths, strict=True)) for line in numbers]
        texts = [f"{'case':<{room}}{ends[0]}"]
        for source, rows in groupby(zip(self, ends[1:], strict=True), lambda each: each[0].source):
            texts.append(f"{source}:")
            for row, end in rows:
                *first, last = wrap(row.case, room, initial_indent="  ", subsequent_indent="  ")
                texts += [*first, f"{last:<{room}}{end}"]
        count = Counter(row.verdict for row in self)
        passed, failed = count[PASS], count[FAIL]
        summary = SUMMARY.format(passed=passed, evaluated=passed + failed, failed=failed, shown=count[SHOWN])
        return "\n".join([*texts, summary])

    def to_json(self) -> str:
        """Return rows, computer and versions of the software as JSON; infinite numbers and NaN become null."""
        return json_text({"machine": computer_info(), "rule": RULE, "rows": [row.values() for row in self]}) + "\n"

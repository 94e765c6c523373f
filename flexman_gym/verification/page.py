"""Verification, page: its rows for a terminal, as a page in Markdown and as JSON."""

import json
import math
from collections import Counter
from collections.abc import Sequence

from flexman_gym.verification.machine import machine, machine_text
from flexman_gym.verification.markdown import markdown_table
from flexman_gym.verification.rows import COLUMNS, FAIL, PASS, SHOWN, Row

RULE = (
    "The error is relative to the expected value, and absolute where that is 0. "
    'A row without a tolerance is shown and not judged. "Closed form" is solved by the command itself.'
)
SUMMARY = "{passed} of {judged} rows pass, {failed} fail. Another {shown} are shown without a verdict."
PAGE = """# Verification

{summary} What is known from elsewhere stands beside what this package computes: closed forms, published values and
independent codes. A row that fails makes `make verify` fail, which writes this page anew.

{rule}

Computed with {machine}.

{table}
"""


def summary(rows: Sequence[Row]) -> str:
    """How many rows pass, fail and are only shown."""
    count = Counter(row.verdict for row in rows)
    passed, failed = count[PASS], count[FAIL]
    return SUMMARY.format(passed=passed, judged=passed + failed, failed=failed, shown=count[SHOWN])


def table(rows: Sequence[Row]) -> str:
    """The rows for a terminal."""
    lines = [list(COLUMNS), *(row.cells() for row in rows)]
    widths = [max(len(line[i]) for line in lines) for i in range(len(COLUMNS))]
    texts = ["  ".join(cell.ljust(width) for cell, width in zip(line, widths, strict=True)) for line in lines]
    return "\n".join([*(text.rstrip() for text in texts), summary(rows)])


def page(rows: Sequence[Row]) -> str:
    """A page with all rows, without a date, so that it changes only when a number does."""
    lines = markdown_table(COLUMNS, (row.cells() for row in rows))
    return PAGE.format(summary=summary(rows), rule=RULE, machine=machine_text(), table="\n".join(lines))


def as_json(rows: Sequence[Row]) -> str:
    """All rows with machine and versions; a number that is not finite is null."""
    clean = [{name: _finite(value) for name, value in row.values().items()} for row in rows]
    return json.dumps({"machine": machine(), "rule": RULE, "rows": clean}, indent=1, allow_nan=False) + "\n"


def _finite(value: str | float | None) -> str | float | None:
    return None if isinstance(value, float) and not math.isfinite(value) else value

"""Text of numbers, lengths, fields with names and tables, for `print` and for pages, and JSON for other programs."""

import json
from collections.abc import Iterable, Mapping, Sequence
from math import isfinite
from textwrap import wrap
from typing import Any

WIDTH = 100  # characters of a line of `print`, also of a table
MAX_LINES = 3  # lines of a value of `print`


def text_fields(entries: Iterable[tuple[str, object]]) -> list[str]:
    """Return the lines of names and values; a value longer than MAX_LINES lines is cut."""
    named = [(name, str(value)) for name, value in entries]
    width = max((len(name) for name, _ in named), default=0) + 2
    result = []
    for name, text in named:
        lines = wrap(text[: (MAX_LINES + 1) * WIDTH], WIDTH - width, max_lines=MAX_LINES, placeholder=" ...") or [""]
        result += [head.ljust(width) + line for head, line in zip([name, *[""] * (len(lines) - 1)], lines, strict=True)]
    return result


def text_table(heads: Sequence[str], rows: Iterable[Sequence[str]], width: int = WIDTH) -> list[str]:
    """Return the lines of a table, with the first column aligned to the left and the others to the right.

    A table wider than `width` characters is continued below, with the first column again.
    """
    columns = list(zip(heads, *rows, strict=True))
    widths = [max(map(len, column)) for column in columns]
    parts, used = [[0]], widths[0]
    for i in range(1, len(columns)):
        if len(parts[-1]) > 1 and used + 2 + widths[i] > width:
            parts.append([0])
            used = widths[0]
        parts[-1].append(i)
        used += 2 + widths[i]
    lines: list[str] = []
    for part in parts:
        lines += [""] * bool(lines)
        for name, *cells in zip(*(columns[i] for i in part), strict=True):
            texts = [name.ljust(widths[0]), *(cell.rjust(widths[i]) for cell, i in zip(cells, part[1:], strict=True))]
            lines.append("  ".join(texts).rstrip())
    return lines


def json_text(data: Any) -> str:
    """Return data as strict JSON: mappings, sequences and arrays, with null for NaN and infinite numbers."""
    return json.dumps(_json_data(data), indent=1, allow_nan=False)


def _json_data(value: Any) -> Any:
    """Return a value as dicts, lists, strings, finite numbers, booleans and None."""
    if isinstance(value, Mapping):
        return {str(name): _json_data(each) for name, each in value.items()}
    if hasattr(value, "tolist"):  # an array or a number of NumPy
        return _json_data(value.tolist())
    if isinstance(value, list | tuple):
        return [_json_data(each) for each in value]
    if isinstance(value, float):
        return value if isfinite(value) else None
    return value if value is None or isinstance(value, bool | int) else str(value)


def number_text(value: float, digits: int = 3) -> str:
    """Return a number with some digits, three by default and at least those of its integer part from 100 on.

    The text has at most three decimals, and is "-" if the number is not finite.
    """
    if not isfinite(value):
        return "-"
    return f"{value:.0f}" if abs(value) >= 100.0 else f"{round(value, 3) + 0.0:.{digits}g}"


def millimetres(length: float) -> str:
    """Return a length, m, in mm with its unit; "below 0.01 mm" for small ones."""
    if length < 1e-5:
        return "below 0.01 mm"
    return f"{1e3 * length:.0f} mm" if length >= 0.0995 else f"{1e3 * length:.2g} mm"


def percent(share: float, *interval: float) -> str:
    """Return a share in percent, with the bounds (low, high) of its interval in brackets if they are given."""
    bounds = " to ".join(map(percent_number, interval))
    return f"{percent_number(share)} %" + f" ({bounds})" * bool(interval)


def percent_number(share: float) -> str:
    """Return a share in percent without sign; 0 and 100 are exact, other shares close to them have a decimal."""
    text = f"{100.0 * share:.0f}"
    return f"{100.0 * share:.1f}" if text in ("0", "100") and share not in (0.0, 1.0) else text

"""Text of numbers, lengths, and fields with names, for `print` and for pages."""

from collections.abc import Iterable
from math import isfinite
from textwrap import wrap

WIDTH = 100  # characters of a line of `print`
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


def number_text(value: float) -> str:
    """Return a number with three digits, "-" if it is not finite."""
    if not isfinite(value):
        return "-"
    return f"{value:.0f}" if abs(value) >= 100.0 else f"{round(value, 3) + 0.0:.3g}"


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

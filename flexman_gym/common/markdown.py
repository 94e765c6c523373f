"""Tables as text: Markdown tables of generated pages, and tables of `print` with aligned columns."""

from collections.abc import Iterable, Sequence
from math import isfinite
from textwrap import wrap

WIDTH = 100  # characters of a line of `print`
MAX_LINES = 3  # lines of a value of `print`


def markdown_table(heads: Sequence[object], rows: Iterable[Iterable[object]]) -> list[str]:
    """Return the lines of a table with a header for each column."""
    return [_line(heads), _line("---" for _ in heads), *map(_line, rows)]


def _line(cells: Iterable[object]) -> str:
    return "| " + " | ".join(str(cell).replace("|", "\\|") for cell in cells) + " |"


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

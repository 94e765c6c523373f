"""Markdown tables of generated pages."""

from collections.abc import Iterable, Sequence


def markdown_table(heads: Sequence[object], rows: Iterable[Iterable[object]]) -> list[str]:
    """Return the lines of a table with a header for each column."""
    return [_line(heads), _line("---" for _ in heads), *map(_line, rows)]


def _line(cells: Iterable[object]) -> str:
    return "| " + " | ".join(str(cell).replace("|", "\\|") for cell in cells) + " |"

"""Markdown: tables and lists of generated pages."""

from collections.abc import Iterable, Sequence


def markdown_table(heads: Sequence[object], rows: Iterable[Iterable[object]]) -> list[str]:
    """The lines of a table with a head for each column."""
    return [_line(heads), _line("---" for _ in heads), *map(_line, rows)]


def introduced_table(text: str, heads: Sequence[object], rows: Iterable[Iterable[object]]) -> list[str]:
    """The same below a text, and an empty line at the end."""
    return [text, "", *markdown_table(heads, rows), ""]


def bullets(texts: Iterable[str]) -> list[str]:
    """The lines of a list."""
    return [f"- {text}" for text in texts]


def _line(cells: Iterable[object]) -> str:
    return "| " + " | ".join(str(cell).replace("|", "\\|") for cell in cells) + " |"

"""Markdown of the pages of studies: tables below a paragraph, and lists."""

from collections.abc import Iterable, Sequence

from flexman_gym.common.markdown import markdown_table


def introduced_table(text: str, heads: Sequence[object], rows: Iterable[Iterable[object]]) -> list[str]:
    """Return the lines of a paragraph and of the table below it, followed by an empty line."""
    return [text, "", *markdown_table(heads, rows), ""]


def bullets(texts: Iterable[str]) -> list[str]:
    """Return the lines of a bulleted list."""
    return [f"- {text}" for text in texts]

"""Markdown of the pages of studies: lists."""

from collections.abc import Iterable


def bullets(texts: Iterable[str]) -> list[str]:
    """Return the lines of a bulleted list."""
    return [f"- {text}" for text in texts]

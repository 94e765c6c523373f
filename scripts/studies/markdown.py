"""Markdown of the pages of studies: lists, numbers in words."""

from collections.abc import Iterable

WORDS = ("zero", "one", "two", "three", "four", "five", "six", "seven", "eight", "nine", "ten", "eleven", "twelve")


def number_word(number: int) -> str:
    """Return a number up to twelve in words, larger ones in digits."""
    return WORDS[number] if number < len(WORDS) else str(number)


def bullets(texts: Iterable[str]) -> list[str]:
    """Return the lines of a bulleted list."""
    return [f"- {text}" for text in texts]

"""Markdown of the pages of studies: lists, numbers in words, generated parts."""

from collections.abc import Iterable

WORDS = ("zero", "one", "two", "three", "four", "five", "six", "seven", "eight", "nine", "ten", "eleven", "twelve")
MARKERS = "<!-- {name} -->", "<!-- end of {name} -->"  # lines above and below a generated part


def number_word(number: int) -> str:
    """Return a number up to twelve in words, larger ones in digits."""
    return WORDS[number] if number < len(WORDS) else str(number)


def bullets(texts: Iterable[str]) -> list[str]:
    """Return the lines of a bulleted list."""
    return [f"- {text}" for text in texts]


def replaced_part(text: str, name: str, lines: Iterable[str]) -> str:
    """Return a page with new lines between the markers of a generated part; ValueError without these markers."""
    above, below = (marker.format(name=name) for marker in MARKERS)
    head, first, rest = text.partition(above)
    _, last, tail = rest.partition(below)
    if not (first and last):
        raise ValueError(f"no lines {above} and {below}")
    return "\n".join([head + above, *lines, below + tail])

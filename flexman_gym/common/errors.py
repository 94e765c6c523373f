"""Errors and warnings of one line: the field, its value, the allowed values, and the nearest name."""

import os
import sys
import warnings
from collections.abc import Collection, Iterable
from difflib import get_close_matches
from typing import Any

LIBRARIES = ("flexman_gym", "flexman_agents", "gymnasium")  # packages skipped in the search for the caller of a warning
MAX_FIELD_LENGTH = 60  # characters of the name of a field in an error
MAX_PATH_LENGTH = 160  # characters of a path in an error
MAX_REASON = 300  # characters of the message of an error of other code
MAX_VALUE_LENGTH = 80  # characters of a value in an error; no more entries of a list are formatted
SIMILARITY = 0.6  # dimensionless; similarity of two names (difflib) above which an error suggests one for the other
MIN_PREFIX = 3  # letters; shortest abbreviation of a name for which an error suggests the name


def short_repr(value: object) -> str:
    """Return the `repr` of any value on one line of at most 80 characters."""
    try:
        text = " ".join(repr(_shortened(value)).split())
    except Exception:  # an integer of thousands of digits, endless nesting, or a faulty user-defined repr
        text = f"this {type(value).__name__}"
    return text if len(text) <= MAX_VALUE_LENGTH else text[: MAX_VALUE_LENGTH - 3] + "..."


def short_path(path: object, most: int = MAX_PATH_LENGTH) -> str:
    """Return a path on one line of at most `most` characters; a longer path is cut in the middle."""
    text = str(path) if str(path).isprintable() else repr(str(path))
    half = (most - 3) // 2
    return text if len(text) <= most else f"{text[:half]}...{text[-half:]}"


def value_error(name: str, value: object, allowed: str) -> ValueError:
    """Return a one-line error for a value of a field, with the allowed values."""
    field = name if name.isprintable() else repr(name)  # a name may contain a key of an untrusted file
    return ValueError(f"{field[:MAX_FIELD_LENGTH]}: {short_repr(value)} is not allowed; give {allowed}")


def error_text(error: BaseException) -> str:
    """Return the message of any error on one line of at most 300 characters, with its type unless it is refused input.

    Refused input is a ValueError or an OSError, whose message names the field or the file.
    """
    text = " ".join(str(error).split())[:MAX_REASON]
    known = text and isinstance(error, ValueError | OSError)
    return text if known else ": ".join(filter(None, (type(error).__name__, text)))


class KeywordError(TypeError, ValueError):
    """Unknown keyword argument: a TypeError, as of any function, and a ValueError, as for any value not allowed."""


class MappingKeyError(ValueError):
    """Unknown or missing key of a mapping; the readers of files add how a file with old keys is converted."""


def key_error(name: str, value: object, allowed: str) -> MappingKeyError:
    """Return a one-line error for a key of a mapping: its field, its value and the allowed keys."""
    return MappingKeyError(str(value_error(name, value, allowed)))


def keyword_error(name: str, value: object, allowed: str, keyword: str) -> KeywordError:
    """Return a one-line error for an unknown keyword argument.

    The message contains Python's words for it, by which programs that try optional keywords recognise them.

    Args:
        name: field, such as "Joint.kind".
        value: value of the argument.
        allowed: allowed values.
        keyword: name of the argument.
    """
    words = f"unexpected keyword argument {keyword[:MAX_FIELD_LENGTH]!r}"
    return KeywordError(f"{value_error(name, value, allowed)} ({words})")


def nearest(name: object, names: Iterable[str]) -> str:
    """Return the name for which another one is probably a misspelling or an abbreviation; "" if none is similar."""
    if not isinstance(name, str) or len(name) > MAX_VALUE_LENGTH:
        return ""
    folded, typed = {each.casefold(): each for each in names}, name.casefold()
    longer = [each for each in folded if len(typed) >= MIN_PREFIX and each.startswith(typed)]
    similar = get_close_matches(typed, folded, 1, SIMILARITY) or longer
    return folded[similar[0]] if similar else ""


def suggestion(name: object, names: Iterable[str]) -> str:
    """Return the end of an error message that suggests the nearest name; "" if none is similar."""
    near = nearest(name, names)
    return f"; the nearest is {near}" if near else ""


def unknown_name(
    field: str, name: str, names: Collection[str], file: str, others: Iterable[str] = ()
) -> ValueError | FileNotFoundError:
    """Return a one-line error for a text that is neither an allowed name nor a path that exists.

    Args:
        field: field, for the message.
        name: the text.
        names: allowed names.
        file: description of the file or folder that is allowed instead.
        others: further names that the message may suggest.

    Returns:
        A FileNotFoundError for a text with the separator or the suffix of a path, else a ValueError.
    """
    error = FileNotFoundError if "/" in name or os.sep in name or "." in name else ValueError
    near = suggestion(name, (*names, *others))
    return error(f"{field}: {short_path(name)} does not exist; give {file}, or one of {', '.join(names)}{near}")


def _shortened(value: Any) -> Any:
    """Return the part of a list, tuple or string that an error shows, and any other value unchanged."""
    if type(value) in (list, tuple):
        return type(value)(_shortened(entry) for entry in value[:MAX_VALUE_LENGTH])
    return value[:MAX_VALUE_LENGTH] if type(value) in (str, bytes) else value


def warn_caller(message: str, category: type[Warning] = UserWarning) -> None:
    """Issue a warning at the source line of the first caller outside LIBRARIES."""
    frame, depth = sys._getframe(1), 2
    while frame.f_back and frame.f_globals.get("__name__", "").partition(".")[0] in LIBRARIES:
        frame, depth = frame.f_back, depth + 1
    warnings.warn(message, category, stacklevel=depth)

"""Checks of arguments: each returns the value in its stored form or raises a ValueError, whose message is one line."""

import math
import numbers
import os
import sys
import warnings
from collections.abc import Collection, Iterable, Iterator, Sequence
from contextlib import contextmanager
from difflib import get_close_matches
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

Kind = TypeVar("Kind")
LIBRARIES = ("flexman_gym", "flexman_agents", "gymnasium")  # packages skipped in the search for the caller of a warning
UNIT_TOLERANCE = 1e-9  # dimensionless; largest error of the length of a unit vector, and of R R^T of a rotation R
MIN_SIZE, MAX_SIZE = 1e-30, 1e30  # SI units; range of a physical quantity > 0
MAX_FIELD_LENGTH = 60  # characters of the name of a field in an error
MAX_PATH_LENGTH = 160  # characters of a path in an error
MAX_REASON = 300  # characters of the message of an error of other code
MAX_VALUE_LENGTH = 80  # characters of a value in an error; no more entries of a list are formatted
MAX_ENTRIES = 10**6  # entries of a list
SIMILARITY = 0.6  # dimensionless; similarity of two names (difflib) above which an error suggests one for the other
MIN_PREFIX = 3  # letters; shortest abbreviation of a name for which an error suggests the name
MIN_SIMILARITY = 0.75  # dimensionless; similarity of two names (difflib) above which a name is probably a misspelling
MAX_DIGITS = 18  # digits of a whole number within a name; larger numbers exceed 64 bits
RATIO_TOLERANCE = 1e-9  # largest relative difference of a ratio of two times from a whole number


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


def is_decimal_integer(text: str) -> bool:
    """Return True if a string is a whole number of 1 to 18 digits 0 to 9; `str.isdigit` also accepts superscripts."""
    return text.isascii() and text.isdecimal() and len(text) <= MAX_DIGITS


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


def _real(value: object) -> float:
    """Return a real number as float, and NaN for anything else (a bool, a string, an overflow)."""
    if isinstance(value, bool) or not isinstance(value, numbers.Real):
        return math.nan
    try:
        return float(value)
    except OverflowError:
        return math.nan


def finite(name: str, value: object, unit: str = "") -> float:
    """Return a value as a finite float."""
    number = _real(value)
    if not math.isfinite(number):
        raise value_error(name, value, "a finite number" + _in(unit))
    return number


def positive(name: str, value: object, unit: str = "") -> float:
    """Return a value as a finite float > 0."""
    number = _real(value)
    if not 0.0 < number < math.inf:
        raise value_error(name, value, "a finite number > 0" + _in(unit))
    return number


def non_negative(name: str, value: object, unit: str = "") -> float:
    """Return a value as a finite float >= 0."""
    number = _real(value)
    if not 0.0 <= number < math.inf:
        raise value_error(name, value, "a finite number >= 0" + _in(unit))
    return number + 0.0  # -0.0 is 0


def physical(name: str, value: object, unit: str = "", zero: bool = False) -> float:
    """Return a physical quantity as a float from 1e-30 to 1e30; if `zero` is True, 0 is allowed too."""
    number = non_negative(name, value, unit) if zero else positive(name, value, unit)
    if number != 0.0 and not MIN_SIZE <= number <= MAX_SIZE:
        raise value_error(
            name, value, f"{'0, or ' if zero else ''}a number from {MIN_SIZE:g} to {MAX_SIZE:g}" + _in(unit)
        )
    return number


def whole_number(name: str, value: object, low: int, high: int) -> int:
    """Return a value as an int from `low` to `high`; 2.0 and True are refused."""
    if isinstance(value, bool) or not isinstance(value, numbers.Integral) or not low <= int(value) <= high:
        raise value_error(name, value, f"a whole number from {low} to {high}")
    return int(value)


def check_magnitudes(name: str, values: Iterable[float], most: float, unit: str = "") -> None:
    """Check that no number exceeds `most` in magnitude."""
    for i, value in enumerate(values):
        if not abs(value) <= most:
            raise value_error(f"{name}[{i}]", value, f"a number from {-most:g} to {most:g}" + _in(unit))


def whole_ratio(name: str, part: float, total: float, allowed: str, most: int = 10**9) -> int:
    """Return the number of times that `part` (s) fits into `total` (s), if it is a whole number from 1 to `most`.

    The error lists the `allowed` values.
    """
    ratio = total / positive(name, part, "s")
    if not ratio < most + 0.5:
        raise value_error(name, part, f"at least {total / most:g} (s), at most {most} times in {total} s")
    count = round(ratio)
    if count < 1 or abs(ratio - count) > RATIO_TOLERANCE * ratio:
        raise value_error(name, part, f"{allowed}, {total} s")
    return count


def sample_count(name: str, period: float, duration: float, most: int = MAX_ENTRIES) -> int:
    """Return the number of periods `period` (s) that cover a duration (s), after a check that it is at most `most`."""
    if not duration <= most * positive(name, period, "s"):
        raise value_error(name, period, f"at least {duration / most:.3g} (s), at most {most} times in {duration:.3g} s")
    return math.ceil(duration / period)


def flag(name: str, value: object) -> bool:
    """Return a value as a bool; 0 and 1 are refused."""
    if not isinstance(value, bool | np.bool_):
        raise value_error(name, value, "true or false")
    return bool(value)


def text(name: str, value: object) -> str:
    """Check that a value is a string, and return it."""
    if not isinstance(value, str):
        raise value_error(name, value, "a string")
    return value


def one_of(name: str, value: object, allowed: Collection[str]) -> str:
    """Check that a value is one of the `allowed` strings, and return it."""
    if not isinstance(value, str) or value not in allowed:
        raise value_error(name, value, "one of " + ", ".join(allowed) + suggestion(value, allowed))
    return value


def mapping(name: str, value: object, keys: Collection[str]) -> dict[str, Any]:
    """Return a dict whose keys are among `keys`."""
    if not isinstance(value, dict):
        raise value_error(name, value, f"a mapping with some of {', '.join(keys)}")
    for key in value:
        try:
            one_of(name, key, keys)
        except ValueError as error:
            raise MappingKeyError(str(error)) from None
    return value


def sequence(name: str, value: object, items: str = "values") -> Sequence[Any]:
    """Check a list, a tuple or an array; an array is returned as a list.

    Args:
        name: field, for errors.
        value: the value.
        items: description of the entries, for errors.
    """
    if isinstance(value, np.ndarray) and value.ndim > 0 and value.size <= MAX_ENTRIES:
        return list(value.tolist())
    if not isinstance(value, list | tuple) or len(value) > MAX_ENTRIES:
        raise value_error(name, value, f"a list of {items}")
    return value


def number_array(name: str, value: object, shape: tuple[int, ...], allowed: str) -> NDArray[np.float64]:
    """Return an array-like of finite numbers as a float array; its length is checked before it is converted.

    Args:
        name: field, for errors.
        value: the array-like.
        shape: required shape.
        allowed: allowed values, for errors.
    """
    try:
        values = np.asarray(value) if len(value) == shape[0] else None  # type: ignore[arg-type]
    except Exception:  # no list, or lists of different lengths
        values = None
    if values is None or values.shape != shape or values.dtype.kind not in "fiu" or not np.isfinite(values).all():
        raise value_error(name, value, allowed)
    return values.astype(np.float64, copy=False)


def instance(name: str, value: object, kind: type[Kind], allowed: str) -> Kind:
    """Return an instance of `kind` unchanged; the error lists the `allowed` values."""
    if not isinstance(value, kind):
        raise value_error(name, value, allowed)
    return value


def instances(name: str, value: object, *kinds: type) -> tuple[Any, ...]:
    """Return a non-empty list of instances of any of the `kinds` as a tuple."""
    names = " or ".join(kind.__name__ for kind in kinds)
    items = sequence(name, value, f"at least one {names}")
    if not items:
        raise value_error(name, value, f"at least one {names}")
    for i, item in enumerate(items):
        if not isinstance(item, kinds):
            raise value_error(f"{name}[{i}]", item, f"a {names}")
    return tuple(items)


def vector(name: str, value: object, length: int | None = None, unit: str = "") -> tuple[float, ...]:
    """Return an array-like of finite numbers as a tuple of floats, (length,)."""
    entries = sequence(name, value, "numbers")
    if not entries or (length is not None and len(entries) != length):
        raise value_error(name, value, f"{length or 'at least 1'} numbers" + _in(unit))
    return tuple(finite(f"{name}[{i}]", entry, unit) for i, entry in enumerate(entries))


def check_member_names(field: str, value: object, optional: Collection[str], others: Collection[str]) -> None:
    """Raise a ValueError for a probably misspelt optional member, which would silently be ignored.

    Args:
        field: field of the object, for errors.
        value: the object.
        optional: names of optional members.
        others: names of further permitted members.
    """
    for name in sorted({*dir(value)} - {*optional, *others}):
        similar = [] if name.startswith("_") else get_close_matches(name, optional, 1, MIN_SIMILARITY)
        if similar:
            allowed = f"{similar[0]}, if it is meant, or another name"
            raise value_error(f"{field}.{name}", getattr(value, name), allowed)


def set_fields(instance: object, **values: object) -> None:
    """Set fields of a frozen dataclass in its `__post_init__`."""
    for name, value in values.items():
        object.__setattr__(instance, name, value)


def warn_caller(message: str, category: type[Warning] = UserWarning) -> None:
    """Issue a warning at the source line of the first caller outside LIBRARIES."""
    frame, depth = sys._getframe(1), 2
    while frame.f_back and frame.f_globals.get("__name__", "").partition(".")[0] in LIBRARIES:
        frame, depth = frame.f_back, depth + 1
    warnings.warn(message, category, stacklevel=depth)


def _in(unit: str) -> str:
    return f" ({unit})" if unit else ""


@contextmanager
def check_solvable(what: str) -> Iterator[None]:
    """Context manager: convert floating-point errors in its block to a ValueError about the parameters of the arm.

    `what` names the computed quantity.
    """
    try:
        with np.errstate(divide="raise", over="raise", invalid="raise"):
            yield
    except (FloatingPointError, ValueError):
        allowed = f"one with computable {what}: masses, stiffness and torques of compatible magnitudes"
        raise value_error("arm", "this one", allowed) from None

"""Checks of arguments: each returns the value in its stored form or raises a ValueError, whose message is one line."""

import math
import numbers
from collections.abc import Collection, Iterable, Iterator, Sequence
from contextlib import contextmanager
from difflib import get_close_matches
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from flexman_gym.common.errors import MappingKeyError, suggestion, value_error

Kind = TypeVar("Kind")
UNIT_TOLERANCE = 1e-9  # dimensionless; largest error of the length of a unit vector, and of R R^T of a rotation R
MIN_SIZE, MAX_SIZE = 1e-30, 1e30  # SI units; range of a physical quantity > 0
MAX_ENTRIES = 10**6  # entries of a list
MIN_SIMILARITY = 0.75  # dimensionless; similarity of two names (difflib) above which a name is probably a misspelling
MAX_DIGITS = 18  # digits of a whole number within a name; larger numbers exceed 64 bits
RATIO_TOLERANCE = 1e-9  # largest relative difference of a ratio of two times from a whole number


def is_decimal_integer(text: str) -> bool:
    """Return True if a string is a whole number of 1 to 18 digits 0 to 9; `str.isdigit` also accepts superscripts."""
    return text.isascii() and text.isdecimal() and len(text) <= MAX_DIGITS


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

"""Checks of arguments: each returns the value in its stored form or raises a ValueError of one line."""

import math
import numbers
from collections.abc import Collection, Iterable, Iterator, Sequence
from contextlib import contextmanager
from difflib import get_close_matches
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

Kind = TypeVar("Kind")
UNIT_TOLERANCE = 1e-9  # how far a unit vector or a rotation may be from exact
MIN_SIZE, MAX_SIZE = 1e-30, 1e30  # of the size of anything, in SI units
MAX_FIELD_LENGTH = 60  # characters of a field in an error
MAX_PATH_LENGTH = 160  # characters of a path in an error
MAX_VALUE_LENGTH = 80  # characters of a value in an error, and so entries of a list
MAX_ENTRIES = 10**6  # of any list
MIN_SIMILARITY = 0.75  # likeness of a name to that of a member, from which on it is taken for a slip
MAX_DIGITS = 18  # of a whole number in a name
RATIO_TOLERANCE = 1e-9  # how far a ratio of two times may be from a whole number, relative to itself


def short_repr(value: object) -> str:
    """Gives a value as at most 80 characters on one line, whatever it is."""
    try:
        text = " ".join(repr(_shortened(value)).split())
    except Exception:  # an integer of thousands of digits, a list nested without end, a repr of somebody's own
        text = f"this {type(value).__name__}"
    return text if len(text) <= MAX_VALUE_LENGTH else text[: MAX_VALUE_LENGTH - 3] + "..."


def short_path(path: object, most: int = MAX_PATH_LENGTH) -> str:
    """Return a path on one line of at most `most` characters; a longer one is cut in its middle."""
    text = str(path) if str(path).isprintable() else repr(str(path))
    half = (most - 3) // 2
    return text if len(text) <= most else f"{text[:half]}...{text[-half:]}"


def is_decimal_integer(text: str) -> bool:
    """Return whether a text is a whole number of 1 to 18 digits 0 to 9; `str.isdigit` is true of superscripts too."""
    return text.isascii() and text.isdecimal() and len(text) <= MAX_DIGITS


def value_error(name: str, value: object, allowed: str) -> ValueError:
    """Builds the error that says on one line that the field `name` may not be `value`, and what is `allowed`."""
    field = name if name.isprintable() else repr(name)  # a key of somebody's file may be in it
    return ValueError(f"{field[:MAX_FIELD_LENGTH]}: {short_repr(value)} is not allowed; give {allowed}")


def _shortened(value: Any) -> Any:
    """Gives a long list, tuple or text without its end, which nobody would see, and everything else as it is."""
    if type(value) in (list, tuple):
        return type(value)(_shortened(entry) for entry in value[:MAX_VALUE_LENGTH])
    return value[:MAX_VALUE_LENGTH] if type(value) in (str, bytes) else value


def _real(value: object) -> float:
    """Gives a real number as float, and NaN for everything else (a bool, a string, an overflow)."""
    if isinstance(value, bool) or not isinstance(value, numbers.Real):
        return math.nan
    try:
        return float(value)
    except OverflowError:
        return math.nan


def finite(name: str, value: object, unit: str = "") -> float:
    """Gives a value as a finite float.

    Raises:
        ValueError: for anything else.
    """
    number = _real(value)
    if not math.isfinite(number):
        raise value_error(name, value, "a finite number" + _in(unit))
    return number


def positive(name: str, value: object, unit: str = "") -> float:
    """Gives a value as a finite float > 0.

    Raises:
        ValueError: for anything else.
    """
    number = _real(value)
    if not 0.0 < number < math.inf:
        raise value_error(name, value, "a finite number > 0" + _in(unit))
    return number


def non_negative(name: str, value: object, unit: str = "") -> float:
    """Gives a value as a finite float >= 0.

    Raises:
        ValueError: for anything else.
    """
    number = _real(value)
    if not 0.0 <= number < math.inf:
        raise value_error(name, value, "a finite number >= 0" + _in(unit))
    return number + 0.0  # -0.0 is 0


def physical(name: str, value: object, unit: str = "", zero: bool = False) -> float:
    """Gives the size of something as a float from 1e-30 to 1e30, or 0 where `zero` has a meaning.

    Raises:
        ValueError: for anything else.
    """
    number = non_negative(name, value, unit) if zero else positive(name, value, unit)
    if number != 0.0 and not MIN_SIZE <= number <= MAX_SIZE:
        raise value_error(
            name, value, f"{'0, or ' if zero else ''}a number from {MIN_SIZE:g} to {MAX_SIZE:g}" + _in(unit)
        )
    return number


def whole_number(name: str, value: object, low: int, high: int) -> int:
    """Gives a value as an int from `low` to `high`.

    Raises:
        ValueError: for anything else, 2.0 and True included.
    """
    if isinstance(value, bool) or not isinstance(value, numbers.Integral) or not low <= int(value) <= high:
        raise value_error(name, value, f"a whole number from {low} to {high}")
    return int(value)


def check_magnitudes(name: str, values: Iterable[float], most: float, unit: str = "") -> None:
    """Refuses numbers of which a magnitude is larger than `most`.

    Raises:
        ValueError: it names the first of them.
    """
    for i, value in enumerate(values):
        if not abs(value) <= most:
            raise value_error(f"{name}[{i}]", value, f"a number from {-most:g} to {most:g}" + _in(unit))


def whole_ratio(name: str, part: float, total: float, allowed: str, most: int = 10**9) -> int:
    """Gives the whole number of times, at most `most`, that the time `part` (s) goes into `total` (s).

    Raises:
        ValueError: where that is no whole number, or a larger one; it says what is `allowed`.
    """
    ratio = total / positive(name, part, "s")
    if not ratio < most + 0.5:
        raise value_error(name, part, f"at least {total / most:g} (s): at most {most} go into {total} s")
    count = round(ratio)
    if count < 1 or abs(ratio - count) > RATIO_TOLERANCE * ratio:
        raise value_error(name, part, f"{allowed}, {total} s")
    return count


def flag(name: str, value: object) -> bool:
    """Gives a value as a bool.

    Raises:
        ValueError: for anything else, 0 and 1 included.
    """
    if not isinstance(value, bool | np.bool_):
        raise value_error(name, value, "true or false")
    return bool(value)


def text(name: str, value: object) -> str:
    """Gives a value that is a string.

    Raises:
        ValueError: for anything else.
    """
    if not isinstance(value, str):
        raise value_error(name, value, "a text")
    return value


def one_of(name: str, value: object, allowed: Collection[str]) -> str:
    """Gives a value that is one of the `allowed` strings.

    Raises:
        ValueError: for anything else.
    """
    if not isinstance(value, str) or value not in allowed:
        raise value_error(name, value, "one of " + ", ".join(allowed))
    return value


def mapping(name: str, value: object, keys: Collection[str]) -> dict[str, Any]:
    """Gives a dict whose keys are some of `keys`.

    Raises:
        ValueError: for anything else.
    """
    if not isinstance(value, dict):
        raise value_error(name, value, f"a mapping with some of {', '.join(keys)}")
    for key in value:
        one_of(name, key, keys)
    return value


def sequence(name: str, value: object, items: str = "values") -> Sequence[Any]:
    """Gives a value that is a list, a tuple or an array; an array comes back as a list.

    Raises:
        ValueError: for anything else; it says which `items` the list has.
    """
    if isinstance(value, np.ndarray) and value.ndim > 0 and value.size <= MAX_ENTRIES:
        return list(value.tolist())
    if not isinstance(value, list | tuple) or len(value) > MAX_ENTRIES:
        raise value_error(name, value, f"a list of {items}")
    return value


def number_array(name: str, value: object, shape: tuple[int, ...], allowed: str) -> NDArray[np.float64]:
    """Gives an array-like of finite numbers as an array of that shape; its length is looked at first.

    Raises:
        ValueError: for anything else; it says what is `allowed`.
    """
    try:
        values = np.asarray(value) if len(value) == shape[0] else None  # type: ignore[arg-type]
    except Exception:  # no list, or lists of different length
        values = None
    if values is None or values.shape != shape or values.dtype.kind not in "fiu" or not np.isfinite(values).all():
        raise value_error(name, value, allowed)
    return values.astype(np.float64, copy=False)


def instance(name: str, value: object, kind: type[Kind], allowed: str) -> Kind:
    """Gives a value of a kind.

    Raises:
        ValueError: for anything else; it says what is `allowed`.
    """
    if not isinstance(value, kind):
        raise value_error(name, value, allowed)
    return value


def instances(name: str, value: object, *kinds: type) -> tuple[Any, ...]:
    """Return a list of at least one item, each of one of the `kinds`, as a tuple.

    Raises:
        ValueError: for anything else.
    """
    names = " or ".join(kind.__name__ for kind in kinds)
    items = sequence(name, value, f"at least one {names}")
    if not items:
        raise value_error(name, value, f"at least one {names}")
    for i, item in enumerate(items):
        if not isinstance(item, kinds):
            raise value_error(f"{name}[{i}]", item, f"a {names}")
    return tuple(items)


def vector(name: str, value: object, length: int | None = None, unit: str = "") -> tuple[float, ...]:
    """Gives an array-like of finite numbers as a tuple of floats, (length,).

    Raises:
        ValueError: for anything else.
    """
    entries = sequence(name, value, "numbers")
    if not entries or (length is not None and len(entries) != length):
        raise value_error(name, value, f"{length or 'at least 1'} numbers" + _in(unit))
    return tuple(finite(f"{name}[{i}]", entry, unit) for i, entry in enumerate(entries))


def rotation(name: str, value: object) -> tuple[tuple[float, ...], ...]:
    """Gives a (3, 3) proper rotation, orthonormal within 1e-9, as a tuple of rows.

    Raises:
        ValueError: for anything else.
    """
    rows = sequence(name, value, "3 rows of 3 numbers")
    if len(rows) != 3:
        raise value_error(name, value, "3 rows of 3 numbers")
    rows = tuple(vector(f"{name}[{i}]", row, 3) for i, row in enumerate(rows))
    matrix = np.array(rows)
    with np.errstate(over="ignore", invalid="ignore"):
        error = np.abs(matrix @ matrix.T - np.eye(3)).max()
    # Of the orthonormal matrices the reflections have a determinant of -1.
    if not error <= UNIT_TOLERANCE or np.linalg.det(matrix) < 0.0:
        raise value_error(name, value, "a rotation matrix: orthonormal within 1e-9, determinant +1")
    return rows


def check_member_names(field: str, value: object, optional: Collection[str], others: Collection[str]) -> None:
    """Refuses an object one of whose members is nearly named as an optional one; it would never be used.

    Raises:
        ValueError: one line with field, member and the name that may be meant.
    """
    for name in sorted({*dir(value)} - {*optional, *others}):
        near = [] if name.startswith("_") else get_close_matches(name, optional, 1, MIN_SIMILARITY)
        if near:
            raise value_error(f"{field}.{name}", getattr(value, name), f"{near[0]}, if it is meant, or another name")


def set_fields(instance: object, **values: object) -> None:
    """Writes checked values over the fields of a frozen dataclass that is being created."""
    for name, value in values.items():
        object.__setattr__(instance, name, value)


def _in(unit: str) -> str:
    return f" ({unit})" if unit else ""


@contextmanager
def check_solvable(what: str) -> Iterator[None]:
    """Refuses an arm for which rounding leaves no solution of `what` is calculated within.

    Raises:
        ValueError: in place of the errors of linear algebra, and of numbers that are not finite.
    """
    try:
        with np.errstate(divide="raise", over="raise", invalid="raise"):
            yield
    except (FloatingPointError, ValueError):
        allowed = f"one for which there are {what}: masses, stiffness and torques of sizes that go together"
        raise value_error("arm", "this one", allowed) from None

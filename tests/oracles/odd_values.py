"""Odd argument values that a user may pass by mistake, and the required form of the error message."""

import array
import re
from decimal import Decimal
from fractions import Fraction

import numpy as np

LINE = re.compile(r"([\w.,\[\]'\"(){}:/+\-\\ ]|[^\x00-\x7f])+: (missing|.+ (is|are) not allowed); give .+")
LONGEST = 440  # characters of such a line


class Rude:
    """Object that cannot be printed, counted or converted to an array."""

    def __repr__(self):
        raise KeyError("no name")

    def __len__(self):
        raise RuntimeError("no length")

    def __array__(self, *arguments, **more):
        raise OSError("no array")


class Number(float):
    """User-defined number."""


class Whole(int):
    """User-defined integer."""


class Row(list):
    """User-defined list."""


class Table(np.ndarray):
    """User-defined array."""


# No number: where one is wanted, nothing of this may be taken.
NO_NUMBERS = [
    "x", "", b"12", 1j, np.nan, np.inf, -np.inf, {}, {"a": 1}, [["a"]], ["a", "b"], [np.nan, 0.0], [None, None],
    np.array("x"), np.array([1, "a"], dtype=object), {1, 2}, Rude(), [Rude(), Rude()], int, lambda: None,
    np.datetime64("2020-01-01"), np.array([1j, 2j]), np.array([np.nan, 1.0]), slice(3), Ellipsis,
]  # fmt: skip
NUMBERS = [
    True, -1.0, -0.0, 0, 1, 2, 3, 0.5, 1e300, -1e300, 1e-300, 5e-324, 10**400, -(10**400), 2**63, -(2**63), 2**128,
    np.float16(1.5), np.longdouble(0.5), np.float32(1e30), np.int8(1), np.uint64(2**63), np.bool_(True), Number(0.5),
    Whole(1), Fraction(1, 2), Decimal("0.5"), np.array(0.5), np.array(1), [], [[]], [1.0], [1.0, 2.0], (1, 2),
    [[1.0], [1.0, 2.0]], [1e300, 1e300], [True, False], [0.0] * 100_001, np.zeros((2, 2, 2)), np.zeros(10**6 + 1),
    np.zeros(0), range(2), range(10**9), Row([0.1, 0.2]), array.array("d", [0.1, 0.2]), np.ma.masked_array([1.0, 2.0]),
    np.zeros(2).view(Table), memoryview(np.zeros(2)), np.array([0.1, 0.2], dtype=">f8"), np.array([1, 2], np.int8),
    np.array([0.1, 0.2, 0.3, 0.4])[::2], np.array([True, False]), np.array([0.1, 0.2], dtype=object),
    np.array([2**63, 1], dtype=np.uint64), np.array([1e4, 6e4], dtype=np.float16),
]  # fmt: skip
OTHERS = [None, False, "auto", "N", "slew"]
BAD = [*NO_NUMBERS, *NUMBERS, *OTHERS]
KEYS = (None, 3, "\n", "x" * 1000, ("a",))
DTYPES = ("f8", "f4", "f2", ">f8", "i8", "i1", "u8", "?", "c16", "O", "S3", "U3", "longdouble")


def number(random):
    """Return a number of any size and sign, sometimes NaN."""
    kind = random.integers(8)
    if kind == 0:
        return NO_NUMBERS[random.integers(len(NO_NUMBERS))]
    if kind == 1:
        return int(random.integers(-5, 6))
    if kind == 2:
        return float(random.choice([np.nan, np.inf, -np.inf, 0.0, -0.0, 1e6, 1e30, 1e-30, 2.2e-308, 1.7e308]))
    low, high = ((-3, 3), (-3, 3), (-30, 30), (-320, 308))[kind % 4]
    return float(random.choice([-1.0, 1.0]) * 10.0 ** random.uniform(low, high))


def table(random):
    """Return an array of any shape and type."""
    shape = tuple(random.integers(0, 5, random.integers(0, 4)))
    values = 10.0 ** random.uniform(-3, 3) * random.normal(size=shape)
    if values.size and random.random() < 0.3:
        values.flat[random.integers(values.size)] = number_only(random)
    with np.errstate(all="ignore"):
        values = np.asarray(values.astype(random.choice(DTYPES)))
    ways = values, values.T, values[::-1] if shape else values, np.asfortranarray(values), values.tolist()
    return ways[random.integers(5)]


def number_only(random):
    """Return a float of any size, including NaN and infinity."""
    result = number(random)
    return result if isinstance(result, float) else np.nan


def odd(random, good):
    """Return an odd replacement of a valid value: a listed value, an array, a number, or the value with a change."""
    kind = random.integers(10)
    if kind < 3:
        return BAD[random.integers(len(BAD))]
    if kind == 3:
        return table(random)
    return number(random) if kind < 6 else changed(random, good)


def changed(random, good):
    """Return a valid value with a wrong entry, length, size or type."""
    if isinstance(good, dict) and good:
        return changed_mapping(random, good)
    if isinstance(good, np.ndarray) and good.dtype != object and good.size:
        with np.errstate(all="ignore"):
            return (good.astype(random.choice(DTYPES)), good[..., :-1], good[None], number_only(random) * good,
                    good.tolist(), np.repeat(good, 2, axis=0))[random.integers(6)]  # fmt: skip
    if isinstance(good, list | tuple) and good:
        place, some = random.integers(len(good)), list(good)
        kind = random.integers(5)
        if kind == 0:
            del some[place]
        elif kind == 1:
            some.insert(place, some[place])
        elif kind < 4:
            some[place] = odd(random, some[place])
        return some if kind < 4 else [some]
    if isinstance(good, float | int) and not isinstance(good, bool):
        return good * float(10.0 ** random.uniform(-6, 6))
    if isinstance(good, str):
        return good[: len(good) // 2] + "\n\x00é" * int(random.integers(2)) + good[len(good) // 2 + 1 :]
    return BAD[random.integers(len(BAD))]


def changed_mapping(random, good):
    """Return a mapping with an entry changed, removed, misspelt or added."""
    some, name = dict(good), list(good)[random.integers(len(good))]
    kind = random.integers(6)
    if kind == 0:
        del some[name]
    elif kind == 1:
        some[f"{name}x"] = some.pop(name)
    elif kind == 2:
        some[KEYS[random.integers(len(KEYS))]] = 1.0
    else:
        some[name] = odd(random, some[name])
    return some


def fits(line):
    """Return whether a message is one short line with field, value and allowed values."""
    return bool(LINE.fullmatch(line)) and len(line) < LONGEST

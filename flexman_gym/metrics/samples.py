"""Samples: the checks of the arrays that metrics are taken of, and the part of them that is looked at."""

import numpy as np

from flexman_gym.arrays import Array
from flexman_gym.checks import MOST, physical, positive, refusal


def samples(name: str, values: object, *axes: int) -> Array:
    """Gives values as an array of numbers (T, ...) with one of the allowed numbers of axes.

    Raises:
        ValueError: for other arrays, for one without a sample, and for finite numbers beyond 1e30, whose squares are
            none.
    """
    allowed = f"an array of {' or '.join(map(str, axes))} axes with at least one sample"
    known = isinstance(values, list | tuple) or hasattr(type(values), "__array__")  # a range may be of any length
    try:
        array = np.asarray(values) if known else np.zeros(0)
    except Exception:  # lists of different length, an object of somebody's own
        array = np.zeros(0)
    if array.ndim not in axes or array.size == 0 or array.dtype.kind not in "fiub":
        raise refusal(name, values, allowed)
    size = np.abs(array.astype(np.longdouble))
    if (np.isfinite(size) & (size > MOST)).any():
        raise refusal(name, values, f"numbers of at most {MOST:g}")
    return array.astype(np.float64)


def finite_samples(name: str, values: object, *axes: int, least: int = 1) -> Array:
    """Gives samples, of which there are at least so many and none is infinite or no number.

    Raises:
        ValueError: for other arrays.
    """
    array = samples(name, values, *axes)
    if len(array) < least:
        raise refusal(name, values, f"at least {least} samples")
    if not np.isfinite(array).all():
        raise refusal(name, values, "finite numbers")
    return array


def lengths(array: Array) -> Array:
    """Gives the lengths (T,) of vectors (T, k); numbers (T,) stay as they are."""
    return array if array.ndim == 1 else np.linalg.norm(array, axis=1)


def last(array: Array, period: float, window: float) -> Array:
    """Gives the samples of the last `window` seconds, both ends included, cut to what there is.

    Raises:
        ValueError: for a window or a period that is not > 0.
    """
    count = positive("window", window, "s") / physical("period", period, "s")
    return array if count >= len(array) else array[-round(count) - 1 :]

"""Derivatives from differences extrapolated to zero, and orders of the Taylor remainder."""

from collections.abc import Callable

import numpy as np

from flexman_gym.common.arrays import Array

ROUNDING = 1e-14  # rounding error of an output, relative to its largest value
STEPS = np.array([4e-3, 5e-4, 6e-5])  # steps of the differences, relative to the size of the parameter
DECADES = np.array([1e-1, 1e-2, 1e-3, 1e-4, 1e-5, 1e-6])  # changes for the Taylor remainder, relative to the size
LARGEST, ESTIMATES = 1e-8, 3.0  # largest relative deviation, or the largest in error estimates of the differences
Motions = Callable[[Array], Array]  # changes (c,) of a parameter -> outputs (c, T, m)


def extrapolated(motions: Motions, size: float) -> tuple[Array, Array]:
    """Return derivatives (3, T, m) from central differences extrapolated to order six, and error estimates (3, m).

    A spring with knees has a second derivative that jumps: large steps cross knees. There is one result for each of
    the three largest steps STEPS.
    """
    steps = size * STEPS[:, None] * np.array([1.0, 0.5, 0.25])
    every = motions(np.concatenate([steps.ravel(), -steps.ravel()]))
    plus, minus = every.reshape(2, *steps.shape, *every.shape[1:])
    first, second, third = ((plus - minus) / (2.0 * steps[:, :, None, None])).swapaxes(0, 1)
    finer, coarser = (4.0 * third - second) / 3.0, (4.0 * second - first) / 3.0
    best = (16.0 * finer - coarser) / 15.0
    rounding = ROUNDING * np.abs(every).max(axis=(0, 1)) / steps[:, 2:]
    return best, np.abs(best - finer).max(axis=1) + rounding


def deviations(exact: Array, motions: Motions, size: float) -> tuple[Array, Array]:
    """Return deviations (m,) of derivatives (T, m) from differences, and error estimates (m,) of the differences.

    Both are relative to the largest derivative of the output, or to 1e-6 of that of all outputs. They are those of the
    largest step at which the deviation in units of the allowed one is smallest.
    """
    best, error = extrapolated(motions, size)
    largest = np.abs(exact).max(axis=0)
    scale = largest + 1e-6 * largest.max() + (largest.max() == 0.0)
    found, error = np.abs(exact - best).max(axis=1) / scale, error / scale
    chosen = np.argmin(found / allowed(error), axis=0), np.arange(len(scale))
    return found[chosen], error[chosen]


def allowed(error: Array) -> Array:
    """Return the largest relative deviation for an error estimate of the differences."""
    return np.maximum(LARGEST, ESTIMATES * error)


def remainder_orders(values: Array, exact: Array, motions: Motions, size: float, decades: Array = DECADES) -> Array:
    """Return the orders (2,) of the Taylor remainder over two decades, those nearest to 2 of all decades.

    Args:
        values: (T, m) outputs.
        exact: (T, m) derivatives.
        motions: outputs of motions with a changed parameter.
        size: size of the parameter.
        decades: changes relative to the size, each a tenth of the one before.
    """
    steps = size * decades[:, None, None]
    remainders = np.abs(motions(size * decades) - values - steps * exact).max(axis=(1, 2))
    orders = np.diff(-np.log10(remainders + np.finfo(float).tiny))
    pairs = np.column_stack([orders[:-1], orders[1:]])
    result: Array = pairs[np.abs(pairs - 2.0).max(axis=1).argmin()]
    return result

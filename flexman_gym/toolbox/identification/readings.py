"""Readings that are no samples of a vibration: repeated ones, those at a limit of the sensor, and rounded ones."""

import numpy as np

from flexman_gym.common.arrays import Array

EQUAL = 1e-9  # fraction of the range of the readings; smaller differences are rounding
STEP_ERROR = 0.05  # largest deviation of a rounded reading from a multiple of the step, in steps
STEEP = 4.0  # steps of rounding; a signal that changes by more within a sample has few equal readings
CHANGE = 1e-4  # fraction of the range; the same without rounding
MOST_REPEATED = 10  # readings of a log for one of the sensor
REGULAR = 0.2, 0.8  # shares of equal readings among the fresh ones, and among the old ones
FEWEST = 3  # equal readings that are no chance
BLURS = (0.0, 0.002, 0.005, 0.01, 0.02, 0.04)  # fraction of the range; widths of a limit blurred by noise
CROWDED = 2.5  # readings at a limit / readings in the next interval; at the peaks of a sinusoid at most 2.4


def rounding_step(values: Array) -> float:
    """Return the step of which all differences of readings (T,) are multiples; 0 without one."""
    levels = np.unique(values)
    gaps = np.diff(levels)
    gaps = gaps[gaps > EQUAL * np.ptp(values)]
    if not len(gaps):
        return 0.0
    multiples = (levels - levels[0]) / gaps.min()
    return float(gaps.min()) if np.abs(multiples - np.round(multiples)).max() < STEP_ERROR else 0.0


def repeated_readings(values: Array) -> Array:
    """Return True (T,) for readings that repeat the one before, as of a sensor slower than its log.

    Rounding alone makes equal readings, too: where a signal changes by many steps within a sample, about as many as
    changes by one step in each direction. Only a surplus is repeated.
    """
    changes, step = np.abs(np.diff(values)), rounding_step(values)
    equal = np.append(False, changes <= EQUAL * np.ptp(values))
    starts = np.flatnonzero(~equal)
    jumps = np.concatenate([[0.0], changes[starts[1:] - 1], [0.0]])  # before each run of equal readings, and after
    before, after = jumps[:-1], jumps[1:]
    inside = (values[starts] < values.max()) & (values[starts] > values.min())
    steep = (np.maximum(before, after) >= max(STEEP * step, CHANGE * np.ptp(values))) & inside
    steep = steep[np.cumsum(~equal) - 1]
    repeated = np.asarray(equal & steep)
    for every in range(2, MOST_REPEATED + 1):  # then readings are old also where the signal is slow
        shares = np.array([repeated[first::every].sum() / max(steep[first::every].sum(), 1) for first in range(every)])
        fresh = int(shares.argmin())
        if shares[fresh] < REGULAR[0] and np.delete(shares, fresh).min() > REGULAR[1]:
            return np.asarray(equal & (np.arange(len(values)) % every != fresh))
    single = np.abs(after[:-1] - step) < STEP_ERROR * step
    chance = int((single & (np.maximum(before[:-1], after[1:]) >= STEEP * step)).sum())
    return repeated if repeated.sum() > 2 * chance + FEWEST else np.zeros(len(values), dtype=bool)


def crowded_extremes(values: Array) -> Array:
    """Return 1 (T,) for readings at the largest value, -1 for those at the smallest one, if these are crowded.

    A vibration that a sensor or an amplifier clips has many readings within the noise of its extreme values.
    """
    found = np.zeros(len(values))
    for sign in (1.0, -1.0):
        below = np.max(sign * values) - sign * values
        widths = np.array(BLURS) * np.ptp(values) + EQUAL * np.ptp(values)
        near, wide = (below[:, None] <= factor * widths for factor in (1.0, 2.0))
        crowds = (near.sum(axis=0) - FEWEST) / np.maximum((wide & ~near).sum(axis=0), 1)
        if crowds.max() > CROWDED:
            found[near[:, int(crowds.argmax())]] = sign
    return found

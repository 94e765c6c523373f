"""Metrics: how well an arm slewed, settled and stopped vibrating, from plain arrays sampled at equal intervals.

Times begin with the first sample, which is that of the reset. Errors are distances of tip and target.
"""

import numpy as np

from flexman_gym.arrays import Array
from flexman_gym.checks import positive, refusal

BAND = 0.02 / 8.5  # of the reach, in which a tip has settled: 20 mm for 8.5 m
STAY = 1.0  # s, for which it must have stayed there at least
VIBRATING = 3.0  # s at the end, in which the vibration that is left is measured


def stabilisation_time(errors: Array, band: float, period: float) -> float:
    """Gives the time (s) from which the tip stays within a band of the target to the end.

    Position stabilisation time after ISO 9283, clause 7.4. It is infinite where the tip has not stayed within the band
    for at least the last second.

    Args:
        errors: (T,) m.
        band: m.
        period: between samples, s.

    Raises:
        ValueError: for errors without a sample, and a band or period that is not > 0.
    """
    positive("band", band, "m")
    outside = np.flatnonzero(~(_samples("errors", errors, 1) <= band))
    entered = 0 if outside.size == 0 else int(outside[-1]) + 1
    stayed = (len(errors) - 1 - entered) * positive("period", period, "s")
    return entered * period if stayed >= STAY - 1e-9 else np.inf


def peak_to_peak(tips: Array, period: float, window: float = VIBRATING) -> float:
    """Gives the largest peak-to-peak motion (m) of the tip along an axis in the last seconds.

    Args:
        tips: (T, 3) m.
        period: between samples, s.
        window: s, cut to what there is.
    """
    last = _last(_samples("tips", tips, 2), period, window)
    return float((last.max(axis=0) - last.min(axis=0)).max())


def final_error(errors: Array, period: float) -> float:
    """Gives the median error (m) over the last second of errors (T,) m sampled with a period (s)."""
    return float(np.median(_last(_samples("errors", errors, 1), period, STAY)))


def effort(actions: Array) -> float:
    """Gives the mean square of actions (T, n), parts of the torque limits."""
    return float(np.mean(np.square(_samples("actions", actions, 2))))


def median_interval(values: Array, level: float = 0.95, draws: int = 2000) -> tuple[float, float, float]:
    """Gives the median of values (N,), which may be infinite, and its bootstrap interval (low, high).

    The interval holds the given share of the medians of samples drawn with replacement (Efron and Tibshirani, An
    Introduction to the Bootstrap, chapter 13); the draws are the same every time.
    """
    found = _samples("values", values, 1)
    picked = np.random.default_rng(0).integers(len(found), size=(draws, len(found)))
    medians = np.sort(_medians(found[picked]))
    cut = round((1.0 - level) / 2.0 * (draws - 1))
    return float(_medians(found[None])[0]), float(medians[cut]), float(medians[-1 - cut])


def _medians(rows: Array) -> Array:
    """Medians (r,) of rows; between infinity and a number the upper one, where a mean would say too much or nothing."""
    return np.sort(rows, axis=1)[:, rows.shape[1] // 2]


def _last(samples: Array, period: float, window: float) -> Array:
    count = round(positive("window", window, "s") / positive("period", period, "s")) + 1
    return samples[-count:]


def _samples(name: str, values: Array, axes: int) -> Array:
    array = np.asarray(values, dtype=np.float64)
    if array.ndim != axes or len(array) == 0:
        raise refusal(name, values, f"an array of {axes} axes with at least one sample")
    return array

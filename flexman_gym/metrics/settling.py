"""Settling: when a tip has come to rest within a band of its target, and how far it went beyond."""

import numpy as np

from flexman_gym.arrays import Array
from flexman_gym.checks import one_of, physical, positive, refusal
from flexman_gym.metrics.samples import finite_samples, last, samples

BAND = 0.02 / 8.5
"""Part of the reach in which a tip has settled: 20 mm for 8.5 m."""
MOVE_BANDS = (0.01, 0.05)
"""Parts of the distance of a move, the usual bands of settling times."""
STAY = 1.0
"""Time for which a tip must have stayed in its band at least, s."""
START, ENTRY = "start", "entry"


def settling_time(errors: Array, band: float, period: float, since: str = START) -> float:
    """Gives the time (s) after which the tip stays within a band of the target to the end.

    It is infinite where the tip has not stayed within the band for at least the last second.

    Args:
        errors: (T,) m.
        band: m.
        period: between samples, s.
        since: "start" counts from the first sample, so that the time of the move is in it: the settling time of control
            engineering. "entry" counts from the first sample within the band: the position stabilisation time of ISO
            9283, clause 7.4, which is 0 for a tip that enters the band once and for all.

    Raises:
        ValueError: for errors without a sample, a band or period that is not > 0, and another `since`.
    """
    inside, period = _inside(errors, band), physical("period", period, "s")
    outside = np.flatnonzero(~inside)
    settled = 0 if outside.size == 0 else int(outside[-1]) + 1
    stayed = (len(inside) - 1 - settled) * period
    if one_of("since", since, (START, ENTRY)) == ENTRY and inside.any():
        settled -= int(np.flatnonzero(inside)[0])
    return settled * period if stayed >= STAY - 1e-9 else np.inf


def overshoot(errors: Array, band: float) -> float:
    """Gives the largest distance (m) from the attained position after the tip first entered a band around it.

    It is 0 where the tip does not leave the band again, and infinite where it never enters it. Position overshoot after
    ISO 9283, clause 7.5.

    Args:
        errors: (T,) m, distances from the attained position (see `attained_distances`); those from the target, where
            the tip comes to rest on it. What is no number counts as infinite.
        band: m.

    Raises:
        ValueError: for errors without a sample, and a band that is not > 0.
    """
    inside = _inside(errors, band)
    entered = np.flatnonzero(inside)
    if entered.size == 0:
        return np.inf
    first = int(entered[0])
    if inside[first:].all():
        return 0.0
    result = np.asarray(errors, dtype=np.float64)[first:]
    return float(np.where(np.isnan(result), np.inf, result).max())


def attained_distances(tips: Array, period: float) -> Array:
    """Gives the distances (T,) m of tips (T, 3) m from the attained position, their mean over the last second.

    Args:
        tips: (T, 3) m.
        period: between samples, s.

    Raises:
        ValueError: for tips that are no such array of finite numbers, and a period that is not > 0.
    """
    result = finite_samples("tips", tips, 2)
    return np.linalg.norm(result - last(result, period, STAY).mean(axis=0), axis=1)


def band_of_move(errors: Array, part: float) -> float:
    """Gives the band (m) that is a part of a move, as of `MOVE_BANDS`: of the distance of tip and target at its start.

    Args:
        errors: (T,) m; the first one is the distance of the move.
        part: of it, above 0 and below 1.

    Raises:
        ValueError: for errors without a sample, a move of no distance, and another part.
    """
    distance = positive("errors[0]", float(samples("errors", errors, 1)[0]), "m")
    if not positive("part", part) < 1.0:
        raise refusal("part", part, "a number > 0 and < 1")
    return float(part) * distance


def final_error(errors: Array, period: float) -> float:
    """Gives the median error (m) over the last second of errors (T,) m sampled with a period (s)."""
    return float(np.median(last(samples("errors", errors, 1), period, STAY)))


def _inside(errors: Array, band: float) -> np.ndarray:
    """Whether each of the errors (T,) is within the band; what is no number is not."""
    positive("band", band, "m")
    return samples("errors", errors, 1) <= float(band)

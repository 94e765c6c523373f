"""Vibration: what is left of it after a move, and how quickly it dies away."""

import numpy as np

from flexman_gym.arrays import Array
from flexman_gym.checks import non_negative, one_of, physical, refusal
from flexman_gym.metrics.samples import finite_samples, last, samples

VIBRATING = 3.0
"""Time at the end in which the vibration that is left is measured, s."""
LEAST_SWING = 0.05  # of the largest swing of a decay; smaller ones are left out, with the noise and ripple in them


def peak_to_peak(tips: Array, period: float, window: float = VIBRATING) -> float:
    """Gives the largest peak-to-peak motion (m) of the tip along an axis in the last seconds.

    Args:
        tips: (T, 3) m.
        period: between samples, s.
        window: s, cut to what there is.
    """
    return _range(last(samples("tips", tips, 2), period, window))


def residual_vibration(
    tips: Array, unshaped: Array, period: float, end: float, unshaped_end: float | None = None
) -> float:
    """Gives the vibration after the end of a command in percent of that after another one, the unshaped command.

    The vibration is the largest peak-to-peak motion of the tip along an axis, from the end of its command on and for
    the same time in both runs, which should hold a cycle of the slowest vibration. Residual vibration percentage after
    Singer and Seering, Preshaping command inputs to reduce system vibration, Journal of Dynamic Systems, Measurement,
    and Control 1990.

    Args:
        tips: (T, 3) m, of the run that is judged.
        unshaped: (S, 3) m, of the other run.
        period: between samples of both, s.
        end: of the command, s after the first sample.
        unshaped_end: of the other command, s; None for the same end. A shaped command lasts longer.

    Raises:
        ValueError: for tips that are no such arrays of finite numbers, a period that is not > 0, an end that leaves
            fewer than two samples, and another run that does not vibrate.
    """
    judged = _after("tips", tips, period, "end", end)
    other = _after("unshaped", unshaped, period, "unshaped_end", end if unshaped_end is None else unshaped_end)
    count = min(len(judged), len(other))
    size = _range(other[:count])
    if size == 0.0:
        raise refusal("unshaped", unshaped, "a run that vibrates after the end of its command")
    return 100.0 * _range(judged[:count]) / size


def damping_ratio(signal: Array) -> float:
    """Gives the equivalent damping ratio of a free decay, by the logarithmic decrement.

    The swings from each turning point to the next one fall by the same factor exp(-d / 2) in a decay of one mode; d is
    fitted by least squares to the logarithms of all swings, and the ratio is d / sqrt(4 pi^2 + d^2) (Inman, Engineering
    Vibration, section 1.6). Swings need no place of rest. Each weighs as much as it is large, since noise changes the
    logarithm of a small one more. A motion counts as a swing where it turns back by more than 0.05 of the range of the
    signal, so that noise and small vibrations of other modes are not counted, nor the end of a decay that is lost in
    them. Of several modes the ratio is that of the one that makes the turning points; where two of like size decay
    together, it is that of a single mode whose swings die away as quickly on the whole.

    It is NaN for a signal with fewer than three turning points, which does not vibrate, and negative where swings grow.
    Turning points are those of parabolas through three samples: with 20 of them in a cycle a ratio up to 0.1 is right
    to 1e-4, with 10 to 1e-3.

    Args:
        signal: (T,) at equal intervals, such as a deflection along an axis after the end of the command.

    Raises:
        ValueError: for fewer than three samples, and numbers that are not finite.
    """
    result = finite_samples("signal", signal, 1, least=3)
    result = np.ldexp(result, -np.frexp(np.abs(result).max())[1])  # of the size of 1, where nothing underflows
    turns = _turning_points(result, LEAST_SWING * float(np.ptp(result)))
    if len(turns) < 3:
        return np.nan
    swings = np.abs(np.diff([_vertex(result[place - 1 : place + 2]) for place in turns]))
    decrement = -2.0 * float(np.polyfit(np.arange(len(swings)), np.log(swings), 1, w=swings)[0])
    return decrement / float(np.hypot(2.0 * np.pi, decrement))


def energy_left(energies: Array, of: str = "largest") -> float:
    """Gives the part of an energy that is left at the end, such as of the elastic energy.

    Args:
        energies: (T,) J.
        of: "largest" for a part of the largest energy, "first" for one of the first.

    Raises:
        ValueError: for energies that are no such array of finite numbers >= 0, where the largest or first one is 0, and
            for another `of`.
    """
    result = finite_samples("energies", energies, 1)
    whole = result.max() if one_of("of", of, ("largest", "first")) == "largest" else result[0]
    if not (result >= 0.0).all() or whole == 0.0:
        raise refusal("energies", energies, f"numbers >= 0 (J), of which the {of} is > 0")
    return float(result[-1] / whole)


def _range(tips: Array) -> float:
    return float((tips.max(axis=0) - tips.min(axis=0)).max())


def _after(name: str, tips: Array, period: float, field: str, end: float) -> Array:
    """The samples (T, 3) of tips from an end on."""
    result = finite_samples(name, tips, 2, least=2)
    period = physical("period", period, "s")
    first = np.ceil(non_negative(field, end, "s") / period - 1e-9)
    if first > len(result) - 2:
        raise refusal(field, end, f"a time (s) of at most {(len(result) - 2) * period:.6g}, two samples before the end")
    return result[int(first) :]


def _turning_points(signal: Array, least: float) -> list[int]:
    """The inner samples at which a signal turns back, by more than `least` before it turns again."""
    turns: list[int] = []
    low = high = 0  # the extremes since the last turning point
    rising = 0  # 1 and -1 once it is known
    for i, value in enumerate(signal):
        low, high = (i if value < signal[low] else low), (i if value > signal[high] else high)
        if rising >= 0 and signal[high] - value > least:
            turns += [high] if high > 0 else []
            rising, low = -1, i
        elif rising <= 0 and value - signal[low] > least:
            turns += [low] if low > 0 else []
            rising, high = 1, i
    return turns


def _vertex(three: Array) -> float:
    """The value at the vertex of the parabola through three samples, of which the middle one is the extreme."""
    before, middle, after = three
    bend = before - 2.0 * middle + after
    return float(middle if bend == 0.0 else middle - (after - before) ** 2 / (8.0 * bend))

"""Metrics of the sampled signals of one run: settling, residual vibration, root mean squares and control effort."""

import numpy as np

from flexman_gym.common.arrays import Array
from flexman_gym.common.checks import MAX_SIZE, non_negative, one_of, physical, positive, value_error


def check_samples(name: str, values: object, *axes: int) -> Array:
    """Return values as an array of numbers (T, ...) after checking its number of axes.

    Args:
        name: name of the values in an error message.
        values: array or nested list with at least one sample; finite numbers up to 1e30, so that squares stay finite.
        *axes: allowed numbers of axes.
    """
    allowed = f"an array of {' or '.join(map(str, axes))} axes with at least one sample"
    # excludes a range, which may have any length
    is_array = isinstance(values, list | tuple) or hasattr(type(values), "__array__")
    try:
        array = np.asarray(values) if is_array else np.zeros(0)
    except Exception:  # ragged lists, or an object without numbers
        array = np.zeros(0)
    if array.ndim not in axes or array.size == 0 or array.dtype.kind not in "fiub":
        raise value_error(name, values, allowed)
    size = np.abs(array.astype(np.longdouble))
    if (np.isfinite(size) & (size > MAX_SIZE)).any():
        raise value_error(name, values, f"numbers of at most {MAX_SIZE:g}")
    return array.astype(np.float64)


def _finite_samples(name: str, values: object, *axes: int, least: int = 1) -> Array:
    """Return samples after checking that they are finite and that there are at least `least` of them."""
    array = check_samples(name, values, *axes)
    if len(array) < least:
        raise value_error(name, values, f"at least {least} samples")
    if not np.isfinite(array).all():
        raise value_error(name, values, "finite numbers")
    return array


def _lengths(array: Array) -> Array:
    """Return the lengths (T,) of vectors (T, k), or numbers (T,) unchanged."""
    return array if array.ndim == 1 else np.linalg.norm(array, axis=1)


def _last_samples(array: Array, period: float, window: float) -> Array:
    """Return the samples of the last `window` seconds, both ends included, or all samples of a shorter record."""
    count = positive("window", window, "s") / physical("period", period, "s")
    return array if count >= len(array) else array[-round(count) - 1 :]


BAND = 0.02 / 8.5
"""Settling band as a fraction of the reach: 20 mm for 8.5 m."""
MOVE_BANDS = (0.01, 0.05)
"""Usual settling bands as fractions of the distance of a move."""
SETTLING_WINDOW = 1.0
"""Time at the end of a record for which a settled tip stays in its band, s."""
START, ENTRY = "start", "entry"


def settling_time(errors: Array, band: float, period: float, since: str = START) -> float:
    """Return the time (s) after which the tip stays within a band around the target until the end.

    It is infinite unless the tip stays within the band for at least the last second.

    Args:
        errors: (T,) m.
        band: m.
        period: sampling period, s.
        since: "start" counts from the first sample and thus includes the time of the move: the settling time of control
            engineering. "entry" counts from the first sample within the band: the position stabilisation time of ISO
            9283, clause 7.4, which is 0 for a tip that enters the band and never leaves it again.
    """
    inside, period = _inside(errors, band), physical("period", period, "s")
    outside = np.flatnonzero(~inside)
    settled = 0 if outside.size == 0 else int(outside[-1]) + 1
    stayed = (len(inside) - 1 - settled) * period
    if one_of("since", since, (START, ENTRY)) == ENTRY and inside.any():
        settled -= int(np.flatnonzero(inside)[0])
    return settled * period if stayed >= SETTLING_WINDOW - 1e-9 else np.inf


def overshoot(errors: Array, band: float) -> float:
    """Return the largest distance (m) from the attained position after the tip first entered a band around it.

    It is 0 if the tip does not leave the band again, and infinite if it never enters it. This is the position overshoot
    of ISO 9283, clause 7.5.

    Args:
        errors: (T,) m, distances from the attained position (see `attained_distances`), or from the target if the tip
            comes to rest there. NaN counts as infinite.
        band: m.
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
    """Return the distances (T,) in m of the tip from its attained position, its mean position over the last second.

    Args:
        tips: (T, 3) m.
        period: sampling period, s.
    """
    result = _finite_samples("tips", tips, 2)
    return np.linalg.norm(result - _last_samples(result, period, SETTLING_WINDOW).mean(axis=0), axis=1)


def move_band(errors: Array, part: float) -> float:
    """Return the band (m) that is a given fraction of the distance between tip and target at the start of a move.

    Args:
        errors: (T,) m; the first one is the distance of the move.
        part: the fraction, such as those of `MOVE_BANDS`; above 0 and below 1.
    """
    distance = positive("errors[0]", float(check_samples("errors", errors, 1)[0]), "m")
    if not positive("part", part) < 1.0:
        raise value_error("part", part, "a number > 0 and < 1")
    return float(part) * distance


def final_error(errors: Array, period: float) -> float:
    """Return the median error (m) over the last second.

    Args:
        errors: (T,) m.
        period: sampling period, s.
    """
    return float(np.median(_last_samples(check_samples("errors", errors, 1), period, SETTLING_WINDOW)))


def _inside(errors: Array, band: float) -> np.ndarray:
    """Return whether each of the errors (T,) is within the band; NaN is not."""
    positive("band", band, "m")
    return check_samples("errors", errors, 1) <= float(band)


VIBRATION_WINDOW = 3.0
"""Time at the end of a record over which the residual vibration is measured, s."""
MIN_SWING = 0.05  # of the range of a signal; smaller swings count as noise


def peak_to_peak(tips: Array, period: float, window: float = VIBRATION_WINDOW) -> float:
    """Return the largest peak-to-peak motion (m) of the tip along a base axis in the last seconds.

    Args:
        tips: (T, 3) m.
        period: sampling period, s.
        window: duration at the end, s, limited to the length of the record.
    """
    return _range(_last_samples(check_samples("tips", tips, 2), period, window))


def residual_vibration(
    tips: Array, unshaped: Array, period: float, end: float, unshaped_end: float | None = None
) -> float:
    """Return the vibration after a command in percent of the vibration after the unshaped command.

    The vibration is the largest peak-to-peak motion of the tip along a base axis after the end of the command. It is
    measured over the same duration in both runs, which should contain a cycle of the slowest vibration. This is the
    residual vibration percentage of Singer and Seering, Preshaping command inputs to reduce system vibration, Journal
    of Dynamic Systems, Measurement, and Control 1990.

    Args:
        tips: (T, 3) m, of the run to be evaluated; at least two samples after its end.
        unshaped: (S, 3) m, of the run with the unshaped command, which must vibrate.
        period: sampling period of both runs, s.
        end: end of the command, s after the first sample.
        unshaped_end: end of the unshaped command, s; None for the same end. A shaped command ends later.
    """
    evaluated = _after("tips", tips, period, "end", end)
    reference = _after("unshaped", unshaped, period, "unshaped_end", end if unshaped_end is None else unshaped_end)
    count = min(len(evaluated), len(reference))
    reference_range = _range(reference[:count])
    if reference_range == 0.0:
        raise value_error("unshaped", unshaped, "a run that vibrates after the end of its command")
    return 100.0 * _range(evaluated[:count]) / reference_range


def damping_ratio(signal: Array) -> float:
    """Return the equivalent damping ratio of a free decay by the logarithmic decrement.

    In the decay of one mode the swings between successive turning points decrease by a constant factor exp(-d / 2). The
    decrement d is fitted by least squares to the logarithms of all swings, and the ratio is d / sqrt(4 pi^2 + d^2)
    (Inman, Engineering Vibration, section 1.6). Swings need no equilibrium position. Each is weighted by its size,
    because noise changes the logarithm of a small swing more. A motion counts as a swing if it turns back by more than
    0.05 of the range of the signal, which excludes noise, small vibrations of other modes, and the end of a decay that
    is lost in them. With several modes, the result is the ratio of the mode that causes the turning points; for two
    modes of similar size it is the ratio of a single mode whose swings decay equally fast overall.

    The result is NaN for a signal with fewer than three turning points, which does not vibrate, and negative for
    growing swings. Turning points are the vertices of parabolas through three samples: with 20 samples per cycle a
    ratio up to 0.1 is accurate to 1e-4, with 10 samples to 1e-3.

    Args:
        signal: (T,) at equal intervals, at least three samples, such as a deflection along an axis after the end of the
            command.
    """
    result = _finite_samples("signal", signal, 1, least=3)
    result = np.ldexp(result, -np.frexp(np.abs(result).max())[1])  # scale to about 1, so that nothing underflows
    turns = _turning_points(result, MIN_SWING * float(np.ptp(result)))
    if len(turns) < 3:
        return np.nan
    swings = np.abs(np.diff([_vertex(result[turn - 1 : turn + 2]) for turn in turns]))
    decrement = -2.0 * float(np.polyfit(np.arange(len(swings)), np.log(swings), 1, w=swings)[0])
    return decrement / float(np.hypot(2.0 * np.pi, decrement))


def remaining_energy(energies: Array, of: str = "largest") -> float:
    """Return the fraction of an energy, such as the elastic energy, that remains at the end.

    Args:
        energies: (T,) J, >= 0.
        of: "largest" for a fraction of the largest energy, "first" for a fraction of the first.
    """
    result = _finite_samples("energies", energies, 1)
    reference = result.max() if one_of("of", of, ("largest", "first")) == "largest" else result[0]
    if not (result >= 0.0).all() or reference == 0.0:
        raise value_error("energies", energies, f"numbers >= 0 (J), of which the {of} is > 0")
    return float(result[-1] / reference)


def _range(tips: Array) -> float:
    """Return the largest peak-to-peak motion of tips (T, 3) along an axis."""
    return float((tips.max(axis=0) - tips.min(axis=0)).max())


def _after(name: str, tips: Array, period: float, field: str, end: float) -> Array:
    """Return the tips (T, 3) sampled from the end of a command on."""
    result = _finite_samples(name, tips, 2, least=2)
    period = physical("period", period, "s")
    first = np.ceil(non_negative(field, end, "s") / period - 1e-9)
    if first > len(result) - 2:
        raise value_error(
            field, end, f"a time (s) of at most {(len(result) - 2) * period:.6g}, two samples before the end"
        )
    return result[int(first) :]


def _turning_points(signal: Array, least: float) -> list[int]:
    """Return the inner samples at which a signal turns back by more than `least` before it turns again."""
    turns: list[int] = []
    low = high = 0  # extremes since the last turning point
    rising = 0  # 0 until the direction is known, then 1 or -1
    for i, value in enumerate(signal):
        low, high = (i if value < signal[low] else low), (i if value > signal[high] else high)
        if rising >= 0 and signal[high] - value > least:
            turns += [high] if high > 0 else []
            rising, low = -1, i
        elif rising <= 0 and value - signal[low] > least:
            turns += [low] if low > 0 else []
            rising, high = 1, i
    return turns


def _vertex(samples: Array) -> float:
    """Return the value at the vertex of the parabola through three samples with the extreme in the middle."""
    before, middle, after = samples
    second_difference = before - 2.0 * middle + after
    return float(middle if second_difference == 0.0 else middle - (after - before) ** 2 / (8.0 * second_difference))


def rms(values: Array) -> float:
    """Return the root mean square of numbers (T,), or of the lengths of vectors (T, k), in their unit.

    Applied to errors it is the RMS tracking error, applied to deflections (T, 3) the RMS deflection.

    Args:
        values: (T,) or (T, k).
    """
    return float(np.sqrt(np.mean(np.square(_lengths(_finite_samples("values", values, 1, 2))))))


def squared_acceleration(accelerations: Array, period: float) -> float:
    """Return the time integral of the squared acceleration of the tip, m^2/s^3, by the trapezoidal rule.

    It is the cost of minimum-acceleration motion (Ben-Itzhak and Karniel, Minimum acceleration criterion with
    constraints, Neural Computation 2008).

    Args:
        accelerations: (T, 3) m/s^2, or (T,) along one axis; at least two samples.
        period: sampling period, s.
    """
    result = np.square(_lengths(_finite_samples("accelerations", accelerations, 1, 2, least=2)))
    return float(np.trapezoid(result, dx=physical("period", period, "s")))


CYCLES = 4  # of the frequency in a record at least; lower frequencies are not resolved from a constant
ROUNDING = 1e-24  # of the mean square; a smaller variance is rounding


def effort(actions: Array) -> float:
    """Return the mean square of actions (T, n), which are fractions of the torque limits.

    Args:
        actions: (T, n).
    """
    return float(np.mean(np.square(check_samples("actions", actions, 2))))


def roughness(actions: Array) -> float:
    """Return the root mean square of the change of actions per period, as fractions of the torque limits.

    Args:
        actions: (T, n); the roughness of a single action is 0.
    """
    result = check_samples("actions", actions, 2)
    return float(np.sqrt(np.mean(np.square(np.diff(result, axis=0))))) if len(result) > 1 else 0.0


def high_frequency_power(actions: Array, period: float, frequency: float) -> float:
    """Return the fraction of the variance of actions at frequencies above a limit, from 0 to 1.

    Above the first natural frequency of the arm it measures how strongly the actions excite or suppress vibration. The
    variance of each motor about its mean is summed over a periodogram with a Hann window (Harris, On the use of windows
    for harmonic analysis, Proceedings of the IEEE 1978). Its frequency resolution is 2 / (T period). The result is 0
    for constant actions.

    Args:
        actions: (T, n), fractions of the torque limits, over at least four cycles of the frequency.
        period: sampling period, s.
        frequency: the limit, Hz, below half the sampling rate.
    """
    result = _finite_samples("actions", actions, 2, least=CYCLES)
    period, frequency = physical("period", period, "s"), positive("frequency", frequency, "Hz")
    nyquist = 0.5 / period
    if not frequency < nyquist:
        raise value_error("frequency", frequency, f"a number > 0 and < {nyquist:.6g} (Hz), half the sampling rate")
    if len(result) * period * frequency < CYCLES * (1.0 - 1e-9):
        raise value_error("actions", actions, f"at least {CYCLES / frequency:.6g} s: {CYCLES} cycles of the frequency")
    window = np.sin(np.pi * np.arange(len(result)) / len(result))[:, None] ** 2
    windowed = window * (result - result.mean(axis=0))
    power = np.square(np.abs(np.fft.rfft(windowed, axis=0)))
    power[1 : (len(result) + 1) // 2] *= 2.0  # include the negative frequency
    if power.sum() <= ROUNDING * len(result) * np.square(result).sum():
        return 0.0
    return float(power[np.fft.rfftfreq(len(result), period) > frequency].sum() / power.sum())

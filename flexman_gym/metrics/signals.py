"""Metrics of the sampled signals of one motion: settling, residual vibration, root mean squares and control effort."""

import numpy as np

from flexman_gym.common.arrays import Array
from flexman_gym.common.checks import MAX_SIZE, non_negative, one_of, physical, positive
from flexman_gym.common.errors import value_error


def check_samples(name: str, values: object, *axes: int) -> Array:
    """Return values as an array of floats (T, ...) after a check of its number of axes.

    Args:
        name: name of the values in the error message.
        values: array or nested list with at least one sample. Finite numbers must not exceed 1e30, so that squares are
            finite.
        *axes: allowed numbers of axes.
    """
    allowed = f"an array of {' or '.join(map(str, axes))} axes with at least one sample"
    # a range is not accepted, because it may have any length
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
    """Return samples after a check: all finite, and at least `least` samples."""
    array = check_samples(name, values, *axes)
    if len(array) < least:
        raise value_error(name, values, f"at least {least} samples")
    if not np.isfinite(array).all():
        raise value_error(name, values, "finite numbers")
    return array


def _lengths(array: Array) -> Array:
    """Return the Euclidean norms (T,) of vectors (T, k); numbers (T,) are returned unchanged."""
    return array if array.ndim == 1 else np.linalg.norm(array, axis=1)


def _last_samples(array: Array, period: float, window: float) -> Array:
    """Return the samples of the last `window` seconds, both ends included, or all of a shorter record."""
    count = positive("window", window, "s") / physical("period", period, "s")
    return array if count >= len(array) else array[-round(count) - 1 :]


BAND = 0.02 / 8.5
"""Settling band as a fraction of the reach: 20 mm for 8.5 m."""
MOVE_BANDS = (0.01, 0.05)
"""Usual settling bands as fractions of the initial distance between tip and target."""
SETTLING_WINDOW = 1.0
"""Time at the end of a record during which a settled tip stays in its band, s."""
START, ENTRY = "start", "entry"  # values of the argument `since` of `settling_time`


def settling_time(errors: Array, band: float, period: float, since: str = START) -> float:
    """Return the settling time, s, after which the tip stays within a band around the target.

    The settling time is infinite unless the tip stays within the band for at least the last second of the record.

    Args:
        errors: (T,) distances between tip and target, m.
        band: largest distance of a settled tip from the target, m.
        period: sampling period, s.
        since: "start" for the time since the first sample, the settling time of control engineering, which includes the
            duration of the motion. "entry" for the time since the first sample within the band, the position
            stabilisation time of ISO 9283, clause 7.4; it is 0 for a tip that enters the band and stays in it.
    """
    inside, period = _inside(errors, band), physical("period", period, "s")
    outside = np.flatnonzero(~inside)
    settled = 0 if outside.size == 0 else int(outside[-1]) + 1
    stayed = (len(inside) - 1 - settled) * period
    if one_of("since", since, (START, ENTRY)) == ENTRY and inside.any():
        settled -= int(np.flatnonzero(inside)[0])
    return settled * period if stayed >= SETTLING_WINDOW - 1e-9 else np.inf


def overshoot(errors: Array, band: float) -> float:
    """Return the overshoot, m: the largest distance from the attained position after the first entry into a band.

    The overshoot is 0 if the tip does not leave the band again, and infinite if it never enters the band. It is the
    position overshoot of ISO 9283, clause 7.5.

    Args:
        errors: (T,) distances of the tip from its attained position (see `attained_distances`), or from the target if
            the tip comes to rest there, m. NaN stands for infinity.
        band: radius of the band around the attained position, m.
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
    """Return the distances (T,), m, of the tip from its attained position: the mean position over the last second.

    Args:
        tips: (T, 3) positions of the tip, m.
        period: sampling period, s.
    """
    result = _finite_samples("tips", tips, 2)
    return np.linalg.norm(result - _last_samples(result, period, SETTLING_WINDOW).mean(axis=0), axis=1)


def move_band(errors: Array, fraction: float) -> float:
    """Return a settling band, m, as a fraction of the initial distance between tip and target.

    Args:
        errors: (T,) distances between tip and target, m; only the first is used.
        fraction: number above 0 and below 1, such as a value in `MOVE_BANDS`.
    """
    distance = positive("errors[0]", float(check_samples("errors", errors, 1)[0]), "m")
    if not positive("fraction", fraction) < 1.0:
        raise value_error("fraction", fraction, "a number > 0 and < 1")
    return float(fraction) * distance


def final_error(errors: Array, period: float) -> float:
    """Return the median error, m, over the last second.

    Args:
        errors: (T,) distances between tip and target, m.
        period: sampling period, s.
    """
    return float(np.median(_last_samples(check_samples("errors", errors, 1), period, SETTLING_WINDOW)))


def _inside(errors: Array, band: float) -> np.ndarray:
    """Return True for each of the errors (T,) within the band; False for NaN."""
    positive("band", band, "m")
    return check_samples("errors", errors, 1) <= float(band)


VIBRATION_WINDOW = 3.0
"""Time at the end of a record over which vibration is measured, s."""
MIN_SWING = 0.05  # fraction of the range of a signal; smaller swings are regarded as noise


def peak_to_peak(tips: Array, period: float, window: float = VIBRATION_WINDOW) -> float:
    """Return the largest peak-to-peak motion, m, of the tip along a base axis at the end of a record.

    Args:
        tips: (T, 3) positions of the tip in the base frame, m.
        period: sampling period, s.
        window: duration of the end of the record, s; at most the whole record is used.
    """
    return _range(_last_samples(check_samples("tips", tips, 2), period, window))


def residual_vibration(
    tips: Array, unshaped: Array, period: float, end: float, unshaped_end: float | None = None
) -> float:
    """Return the residual vibration after a shaped command in percent of the value after the unshaped command.

    The residual vibration is the largest peak-to-peak motion of the tip along a base axis after the end of the command.
    It is measured over equal durations in both motions, which should contain a cycle of the slowest vibration. The
    result is the residual vibration percentage of Singer and Seering, Preshaping command inputs to reduce system
    vibration, Journal of Dynamic Systems, Measurement, and Control 1990.

    Args:
        tips: (T, 3) positions of the tip with the shaped command, m; at least two samples after the end of the command.
        unshaped: (S, 3) positions of the tip with the unshaped command, m; they must vibrate after its end.
        period: sampling period of both motions, s.
        end: time at the end of the shaped command, s after the first sample.
        unshaped_end: time at the end of the unshaped command, s after the first sample; None for `end`.
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

    A swing is the change of the signal between successive turning points. In the decay of one mode the swings decrease
    by a constant factor exp(-d / 2). The logarithmic decrement d is fitted by least squares to the logarithms of the
    swings, and the damping ratio is d / sqrt(4 pi^2 + d^2) (Inman, Engineering Vibration, section 1.6). The equilibrium
    position is not needed. Each swing is weighted by its size, because noise changes the logarithm of a small swing
    more. Swings below 0.05 of the range of the signal are ignored, which excludes noise and small vibrations of further
    modes. With several modes, the result is the damping ratio of the mode that causes the turning points; with two
    modes of similar amplitude it is the ratio of a single mode whose swings decay equally fast overall.

    The result is NaN for a signal with fewer than three turning points, which does not vibrate, and negative for
    growing swings. Turning points are the vertices of parabolas through three samples: with 20 samples per cycle a
    damping ratio up to 0.1 is accurate to 1e-4, with 10 samples to 1e-3.

    Args:
        signal: (T,) samples at equal intervals, at least three, such as a deflection along an axis after the end of the
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


def remaining_energy(energies: Array, reference: str = "largest") -> float:
    """Return the last energy as a fraction of a reference energy.

    Args:
        energies: (T,) energies, such as the elastic energy, J, >= 0.
        reference: "largest" or "first", the energy in the denominator.
    """
    result = _finite_samples("energies", energies, 1)
    largest = one_of("reference", reference, ("largest", "first")) == "largest"
    denominator = result.max() if largest else result[0]
    if not (result >= 0.0).all() or denominator == 0.0:
        raise value_error("energies", energies, f"numbers >= 0 (J), of which the {reference} is > 0")
    return float(result[-1] / denominator)


def _range(tips: Array) -> float:
    """Return the largest peak-to-peak motion of tips (T, 3) along an axis."""
    return float((tips.max(axis=0) - tips.min(axis=0)).max())


def _after(name: str, tips: Array, period: float, field: str, end: float) -> Array:
    """Return the tips (T, 3) from the end of a command, a time in s, on."""
    result = _finite_samples(name, tips, 2, least=2)
    period = physical("period", period, "s")
    first = np.ceil(non_negative(field, end, "s") / period - 1e-9)
    if first > len(result) - 2:
        raise value_error(
            field, end, f"a time (s) of at most {(len(result) - 2) * period:.6g}, two samples before the end"
        )
    return result[int(first) :]


def _turning_points(signal: Array, least: float) -> list[int]:
    """Return the indices of the turning points of a signal (T,) between swings larger than `least`."""
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
    """Return the value at the vertex of the parabola through three samples, of which the middle one is an extremum."""
    before, middle, after = samples
    second_difference = before - 2.0 * middle + after
    return float(middle if second_difference == 0.0 else middle - (after - before) ** 2 / (8.0 * second_difference))


def rms(values: Array) -> float:
    """Return the root mean square of numbers (T,), or of the Euclidean norms of vectors (T, k), in their unit.

    For errors the result is the RMS tracking error, for deflections (T, 3) the RMS deflection.

    Args:
        values: (T,) numbers or (T, k) vectors.
    """
    return float(np.sqrt(np.mean(np.square(_lengths(_finite_samples("values", values, 1, 2))))))


def squared_acceleration(accelerations: Array, period: float) -> float:
    """Return the time integral of the squared acceleration of the tip, m^2/s^3, by the trapezoidal rule.

    The integral is the cost of minimum-acceleration motion (Ben-Itzhak and Karniel, Minimum acceleration criterion with
    constraints, Neural Computation 2008).

    Args:
        accelerations: (T, 3) accelerations of the tip, or (T,) along one axis, m/s^2; at least two samples.
        period: sampling period, s.
    """
    result = np.square(_lengths(_finite_samples("accelerations", accelerations, 1, 2, least=2)))
    return float(np.trapezoid(result, dx=physical("period", period, "s")))


CYCLES = 4  # smallest number of cycles of the frequency in a record; fewer cycles are not resolved from a constant
ROUNDING = 1e-24  # fraction of the mean square; a smaller variance is rounding


def effort(actions: Array) -> float:
    """Return the mean square of actions, which are fractions of the torque limits.

    Args:
        actions: (T, n) commanded torques, 1.
    """
    return float(np.mean(np.square(check_samples("actions", actions, 2))))


def roughness(actions: Array) -> float:
    """Return the root mean square of the change of actions per period, as fractions of the torque limits.

    Args:
        actions: (T, n) commanded torques, 1; the roughness of a single action is 0.
    """
    result = check_samples("actions", actions, 2)
    return float(np.sqrt(np.mean(np.square(np.diff(result, axis=0))))) if len(result) > 1 else 0.0


def high_frequency_power(actions: Array, period: float, frequency: float) -> float:
    """Return the fraction of the variance of actions above a frequency, from 0 to 1.

    With the first natural frequency of the arm, the result measures how strongly the actions excite or suppress
    vibration. The variance of the actions of each motor is computed from a periodogram with a Hann window (Harris, On
    the use of windows for harmonic analysis, Proceedings of the IEEE 1978), whose frequency resolution is
    2 / (T period). The result is 0 for constant actions.

    Args:
        actions: (T, n) commanded torques, 1, during at least four cycles of the frequency.
        period: sampling period, s.
        frequency: the frequency, Hz, below half the sampling rate.
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

"""Metrics of the sampled signals of one run: settling, residual vibration, root mean squares and control effort."""

import numpy as np

from flexman_gym.common.arrays import Array
from flexman_gym.common.checks import MAX_SIZE, non_negative, one_of, physical, positive, value_error


def check_samples(name: str, values: object, *axes: int) -> Array:
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
        raise value_error(name, values, allowed)
    size = np.abs(array.astype(np.longdouble))
    if (np.isfinite(size) & (size > MAX_SIZE)).any():
        raise value_error(name, values, f"numbers of at most {MAX_SIZE:g}")
    return array.astype(np.float64)


def _finite_samples(name: str, values: object, *axes: int, least: int = 1) -> Array:
    """Gives samples, of which there are at least so many and none is infinite or no number.

    Raises:
        ValueError: for other arrays.
    """
    array = check_samples(name, values, *axes)
    if len(array) < least:
        raise value_error(name, values, f"at least {least} samples")
    if not np.isfinite(array).all():
        raise value_error(name, values, "finite numbers")
    return array


def _lengths(array: Array) -> Array:
    """Gives the lengths (T,) of vectors (T, k); numbers (T,) stay as they are."""
    return array if array.ndim == 1 else np.linalg.norm(array, axis=1)


def _last_samples(array: Array, period: float, window: float) -> Array:
    """Gives the samples of the last `window` seconds, both ends included, cut to what there is.

    Raises:
        ValueError: for a window or a period that is not > 0.
    """
    count = positive("window", window, "s") / physical("period", period, "s")
    return array if count >= len(array) else array[-round(count) - 1 :]


BAND = 0.02 / 8.5
"""Part of the reach in which a tip has settled: 20 mm for 8.5 m."""
MOVE_BANDS = (0.01, 0.05)
"""Parts of the distance of a move, the usual bands of settling times."""
SETTLING_WINDOW = 1.0
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
    return settled * period if stayed >= SETTLING_WINDOW - 1e-9 else np.inf


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
    result = _finite_samples("tips", tips, 2)
    return np.linalg.norm(result - _last_samples(result, period, SETTLING_WINDOW).mean(axis=0), axis=1)


def move_band(errors: Array, part: float) -> float:
    """Gives the band (m) that is a part of a move, as of `MOVE_BANDS`: of the distance of tip and target at its start.

    Args:
        errors: (T,) m; the first one is the distance of the move.
        part: of it, above 0 and below 1.

    Raises:
        ValueError: for errors without a sample, a move of no distance, and another part.
    """
    distance = positive("errors[0]", float(check_samples("errors", errors, 1)[0]), "m")
    if not positive("part", part) < 1.0:
        raise value_error("part", part, "a number > 0 and < 1")
    return float(part) * distance


def final_error(errors: Array, period: float) -> float:
    """Gives the median error (m) over the last second of errors (T,) m sampled with a period (s)."""
    return float(np.median(_last_samples(check_samples("errors", errors, 1), period, SETTLING_WINDOW)))


def _inside(errors: Array, band: float) -> np.ndarray:
    """Whether each of the errors (T,) is within the band; what is no number is not."""
    positive("band", band, "m")
    return check_samples("errors", errors, 1) <= float(band)


VIBRATION_WINDOW = 3.0
"""Time at the end in which the vibration that is left is measured, s."""
MIN_SWING = 0.05  # of the largest swing of a decay; smaller ones are left out, with the noise and ripple in them


def peak_to_peak(tips: Array, period: float, window: float = VIBRATION_WINDOW) -> float:
    """Gives the largest peak-to-peak motion (m) of the tip along an axis in the last seconds.

    Args:
        tips: (T, 3) m.
        period: between samples, s.
        window: s, cut to what there is.
    """
    return _range(_last_samples(check_samples("tips", tips, 2), period, window))


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
        raise value_error("unshaped", unshaped, "a run that vibrates after the end of its command")
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
    result = _finite_samples("signal", signal, 1, least=3)
    result = np.ldexp(result, -np.frexp(np.abs(result).max())[1])  # of the size of 1, where nothing underflows
    turns = _turning_points(result, MIN_SWING * float(np.ptp(result)))
    if len(turns) < 3:
        return np.nan
    swings = np.abs(np.diff([_vertex(result[place - 1 : place + 2]) for place in turns]))
    decrement = -2.0 * float(np.polyfit(np.arange(len(swings)), np.log(swings), 1, w=swings)[0])
    return decrement / float(np.hypot(2.0 * np.pi, decrement))


def remaining_energy(energies: Array, of: str = "largest") -> float:
    """Gives the part of an energy that is left at the end, such as of the elastic energy.

    Args:
        energies: (T,) J.
        of: "largest" for a part of the largest energy, "first" for one of the first.

    Raises:
        ValueError: for energies that are no such array of finite numbers >= 0, where the largest or first one is 0, and
            for another `of`.
    """
    result = _finite_samples("energies", energies, 1)
    whole = result.max() if one_of("of", of, ("largest", "first")) == "largest" else result[0]
    if not (result >= 0.0).all() or whole == 0.0:
        raise value_error("energies", energies, f"numbers >= 0 (J), of which the {of} is > 0")
    return float(result[-1] / whole)


def _range(tips: Array) -> float:
    return float((tips.max(axis=0) - tips.min(axis=0)).max())


def _after(name: str, tips: Array, period: float, field: str, end: float) -> Array:
    """The samples (T, 3) of tips from an end on."""
    result = _finite_samples(name, tips, 2, least=2)
    period = physical("period", period, "s")
    first = np.ceil(non_negative(field, end, "s") / period - 1e-9)
    if first > len(result) - 2:
        raise value_error(
            field, end, f"a time (s) of at most {(len(result) - 2) * period:.6g}, two samples before the end"
        )
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


def rms(values: Array) -> float:
    """Gives the root mean square of numbers (T,), or of the lengths of vectors (T, k), in their unit.

    Of errors it is the RMS tracking error, of deflections (T, 3) the RMS deflection.

    Raises:
        ValueError: for other arrays, and for numbers that are not finite.
    """
    return float(np.sqrt(np.mean(np.square(_lengths(_finite_samples("values", values, 1, 2))))))


def squared_acceleration(accelerations: Array, period: float) -> float:
    """Gives the integral over time of the squared acceleration of the tip, m^2/s^3.

    It is the cost that a minimum-acceleration motion makes least (Ben-Itzhak and Karniel, Minimum acceleration
    criterion with constraints, Neural Computation 2008). The integral is that of the trapezoidal rule.

    Args:
        accelerations: (T, 3) m/s^2, or (T,) along one axis.
        period: between samples, s.

    Raises:
        ValueError: for fewer than two samples, numbers that are not finite, and a period that is not > 0.
    """
    result = np.square(_lengths(_finite_samples("accelerations", accelerations, 1, 2, least=2)))
    return float(np.trapezoid(result, dx=physical("period", period, "s")))


CYCLES = 4  # of the frequency that a record must hold: the window tells no closer frequencies from a constant
ROUNDING = 1e-24  # of the mean square: a variance below is that of rounding


def effort(actions: Array) -> float:
    """Gives the mean square of actions (T, n), parts of the torque limits."""
    return float(np.mean(np.square(check_samples("actions", actions, 2))))


def roughness(actions: Array) -> float:
    """Gives the root mean square of the change of actions (T, n), parts of the torque limits, from period to period.

    A single action has none.
    """
    result = check_samples("actions", actions, 2)
    return float(np.sqrt(np.mean(np.square(np.diff(result, axis=0))))) if len(result) > 1 else 0.0


def high_frequency_power(actions: Array, period: float, frequency: float) -> float:
    """Gives the part of the variance of actions that lies above a frequency, from 0 to 1.

    Above the first natural frequency of the arm it is what the controller does to the vibrations, or what excites them.
    It is summed over the periodogram of all motors, with a Hann window (Harris, On the use of windows for harmonic
    analysis, Proceedings of the IEEE 1978), about the mean of each. A frequency is told from another one where they are
    2 / (T period) apart. Actions that stay constant have no variance, and none of it above.

    Args:
        actions: (T, n), parts of the torque limits.
        period: between samples, s.
        frequency: Hz, below half the rate of the samples.

    Raises:
        ValueError: for actions that are no such array of finite numbers or are shorter than 4 / frequency, a period
            that is not > 0, and a frequency that cannot be seen.
    """
    result = _finite_samples("actions", actions, 2, least=CYCLES)
    period, frequency = physical("period", period, "s"), positive("frequency", frequency, "Hz")
    fastest = 0.5 / period
    if not frequency < fastest:
        raise value_error(
            "frequency", frequency, f"a number > 0 and < {fastest:.6g} (Hz), half the rate of the samples"
        )
    if len(result) * period * frequency < CYCLES * (1.0 - 1e-9):
        raise value_error("actions", actions, f"at least {CYCLES / frequency:.6g} s: {CYCLES} cycles of the frequency")
    window = np.sin(np.pi * np.arange(len(result)) / len(result))[:, None] ** 2
    swing = window * (result - result.mean(axis=0))
    power = np.square(np.abs(np.fft.rfft(swing, axis=0)))
    power[1 : (len(result) + 1) // 2] *= 2.0  # each stands for its negative frequency too
    if power.sum() <= ROUNDING * len(result) * np.square(result).sum():
        return 0.0
    return float(power[np.fft.rfftfreq(len(result), period) > frequency].sum() / power.sum())

"""Modes of a record of free vibration: a least-squares fit of damped sinusoids, an offset and a drift."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from flexman_gym.common.arrays import Array, Vector
from flexman_gym.common.clock import Sampling
from flexman_gym.common.errors import value_error
from flexman_gym.toolbox.identification.readings import crowded_extremes, repeated_readings, rounding_step

MIN_CYCLES = 2.0  # cycles of a mode in the record
MIN_SAMPLES = 16  # readings in a fit
PROOF = 4.0  # damping ratio of a mode / its standard deviation
MIN_DECAY = 0.1  # decay rate x length of the record; the amplitude of a tone may vary by as much
SEPARATION = 0.75  # cycles over the record by which two modes differ, at least; also by more than a bandwidth
MAX_GROWTH = 0.3  # growth rate x length of the record
MIN_AMPLITUDE = 0.01  # fraction of the root mean square of the record; smaller second modes are noise
MIN_EXPLAINED = 0.5  # fraction of the variance that damped sinusoids explain
MAX_DAMPING = 0.5  # damping ratio; a larger one is no vibration
TRANSIENT_DAMPING = 0.2  # damping ratio; beside a mode with less, a larger one is a transient of a servo or a filter
START_RATIOS = (0.001, 0.004, 0.015, 0.05, 0.15, 0.4)  # damping ratios from which the fit starts
MOST_TERMS, MOST_MODES = 6, 2  # damped sinusoids in the fit, tones and transients among them, and modes in a result
EVALUATIONS = 100  # evaluations of the residuals in a fit
EXACT = 1e-20  # fraction of the sum of squares; smaller residuals are rounding
BLOCKS = 25  # blocks of residuals
SLOWEST = 1e-3  # rad; phase over the record of two exponentials that differ
PADDING = 4  # length of the padded spectrum / length of the record
JITTER = 0.02  # largest difference between a step and the median step / median step, without a note
CLIPPED = 1.0, 0.75, 0.01  # deviations, steps of rounding, and fraction, by which a vibration exceeds a limit
MARGIN = 2.0  # standard deviations below a limit from which readings are left out
COARSE = 0.6  # noise / step of rounding, below which readings smaller than a step are left out
DISAGREEMENT = 3.0, 1e-3  # standard deviations, and fraction, by which the frequency of a column differs
SAME_MODE = 0.2  # fraction; the frequencies of one mode differ by less in two columns


class DampedSinusoids(NamedTuple):
    """Damped sinusoids fitted to readings.

    A term is the solution of x'' + 2 a x' + (a^2 + w) x = 0 with the decay rate a and the squared angular frequency w,
    which is negative for the sum of two exponentials.

    Attributes:
        terms: decay rates, 1/s, and squared angular frequencies, rad^2/s^2 (k, 2), the largest term first.
        times: (T,) times from 0, s.
        signals: (T, c) readings, divided by their standard deviations.
        residuals: (T, c) readings less their fit.
    """

    terms: Array
    times: Array
    signals: Array
    residuals: Array

    @classmethod
    def of(cls, terms: Array, times: Array, signals: Array) -> "DampedSinusoids":
        """Return the fit of given terms: amplitudes, phases, offset and drift are free in each column."""
        basis = np.linalg.qr(_basis(terms, times, times[-1]))[0]
        return cls(terms, times, signals, signals - basis @ (basis.T @ signals))

    @classmethod
    def find(cls, times: Array, signals: Array) -> "DampedSinusoids":
        """Return the fit of as many terms as the Bayesian information criterion accepts, each of some size."""
        fit = last = cls.of(np.zeros((0, 2)), times, signals)
        total, count = fit.squares, signals.size
        while len(last.terms) < MOST_TERMS and last.squares > EXACT * total:
            found = last.with_term()
            gain = count * np.log(last.squares / max(found.squares, EXACT * total))
            significant = gain > (2 + 2 * signals.shape[1]) * np.log(count)
            if len(last.terms) and not (significant and last.squares - found.squares > MIN_AMPLITUDE**2 * total):
                break
            last = found  # terms may be implausible until the others are found
            fit = last if last._is_plausible() or not len(fit.terms) else fit
        return fit

    @property
    def poles(self) -> Array:
        """Damped frequencies, Hz, and damping ratios (k, 2)."""
        rates, squares = self.terms.T
        ratios = rates / np.sqrt(np.maximum(rates**2 + np.maximum(squares, 0.0), 1e-300))
        return np.column_stack([np.sqrt(np.maximum(squares, 0.0)) / (2.0 * np.pi), ratios])

    @property
    def decays(self) -> Array:
        """Decay rates of the terms x length of the record (k,)."""
        return np.asarray(self.terms[:, 0] * self.times[-1])

    @property
    def squares(self) -> float:
        """Sum of the squared residuals."""
        return float((self.residuals**2).sum())

    @property
    def explained(self) -> float:
        """Fraction of the variance that the damped sinusoids explain."""
        return 1.0 - self.squares / self.of(self.terms[:0], self.times, self.signals).squares

    @property
    def noise(self) -> Array:
        """Standard deviations (c,) of the residuals."""
        return np.asarray(np.sqrt((self.residuals**2).mean(axis=0)))

    def predict(self, times: Array) -> Array:
        """Return the fitted readings (S, c) at other times (S,), s."""
        return self._parts(times, slice(None))

    def vibration(self) -> Array:
        """Return the fitted readings (T, c) without offset and drift."""
        return self._parts(self.times, slice(2 * len(self.terms)))

    def _parts(self, times: Array, columns: slice) -> Array:
        basis = _basis(self.terms, self.times, self.times[-1])
        coefficients = np.linalg.lstsq(basis, self.signals - self.residuals, rcond=None)[0]
        return np.asarray(_basis(self.terms, times, self.times[-1])[:, columns] @ coefficients[columns])

    def _is_plausible(self) -> bool:
        """Return True if no vibration grows, and all frequencies are apart and below half the sampling rate."""
        ringing = (self.poles[:, 0] * self.times[-1] >= MIN_CYCLES) & (self.poles[:, 1] <= TRANSIENT_DAMPING)
        frequencies, ratios = self.poles[ringing].T
        highest = 0.5 * (len(self.times) - 1) / self.times[-1]
        widths = np.maximum(SEPARATION / self.times[-1], frequencies * np.abs(ratios))
        distances = np.abs(frequencies - frequencies[:, None]) + np.diag(np.full(len(widths), np.inf))
        valid = (frequencies < highest) & (self.decays[ringing] > -MAX_GROWTH) & (distances > widths).all(axis=1)
        return bool(valid.all())

    def with_term(self) -> "DampedSinusoids":
        """Return the fit with one more term, which starts at the peak of the spectrum of the residuals."""
        from scipy.optimize import least_squares

        times, length = self.times, self.times[-1]
        grid = np.linspace(0.0, length, len(times))
        even = np.column_stack([np.interp(grid, times, each) for each in self.residuals.T])
        spectrum = (np.abs(np.fft.rfft(even, PADDING * len(times), axis=0)) ** 2).sum(axis=1)
        spectrum[: int(1.5 * PADDING)] = 0.0
        rate = 2.0 * np.pi * float(spectrum.argmax()) / (PADDING * len(times) * grid[1])
        new = [(rate * ratio / np.sqrt(1.0 - ratio**2), rate**2) for ratio in START_RATIOS]
        starts = [self.of(np.vstack([self.terms, each]), times, self.signals) for each in new]
        start = min(starts, key=lambda each: each.squares).terms
        scales = _scales(start, length)

        def fit(steps: Array) -> DampedSinusoids:
            return self.of(start + scales * steps.reshape(-1, 2), times, self.signals)

        def residuals(steps: Array) -> Array:
            return fit(steps).residuals.ravel()

        def jacobian(steps: Array) -> Array:
            return np.asarray(fit(steps).jacobian().reshape(-1, start.size) * scales.ravel())

        return fit(least_squares(residuals, np.zeros(start.size), jacobian, method="lm", max_nfev=EVALUATIONS).x)

    def jacobian(self) -> Array:
        """Return the Jacobian (T, c, 2 k) of the residuals by the terms (Kaufman, BIT 15, 1975)."""
        times, basis = self.times[:, None], _basis(self.terms, self.times, self.times[-1])
        q, r = np.linalg.qr(basis)
        amplitudes = np.linalg.lstsq(r, q.T @ self.signals, rcond=1e-12)[0]
        columns = []
        for i, square in enumerate(self.terms[:, 1].tolist()):
            first, second = np.split(basis[:, 2 * i : 2 * i + 2], 2, axis=1)
            by_first, by_second = amplitudes[2 * i], amplitudes[2 * i + 1]
            slope = 0.5 / max(float(np.sqrt(abs(square))), SLOWEST / self.times[-1])
            turned = (second, -first) if square > 0.0 else (first, -second)
            columns += [first * by_first + second * by_second, slope * (turned[0] * by_first + turned[1] * by_second)]
        result = np.stack([times * each for each in columns], axis=-1)
        return np.asarray(result - np.einsum("tm,mcp->tcp", q, np.einsum("tm,tcp->mcp", q, result)))

    def deviations(self) -> Array:
        """Return the standard deviations (k, 2) of the poles.

        These are the larger ones of those of white noise and those of blocks of the residuals, which may be correlated.
        """
        steps = _scales(self.terms, self.times[-1])
        jacobian = np.moveaxis(self.jacobian() * steps.ravel(), -1, 0)  # (2 k, T, c)
        inverse = np.linalg.pinv(np.einsum("atc,btc->ab", jacobian, jacobian), hermitian=True)
        scores = np.einsum("atc,tc->at", jacobian, self.residuals)
        blocks = np.stack([each.sum(axis=1) for each in np.array_split(scores, BLOCKS, axis=1)])
        white = self.squares / max(self.residuals.size - 5 * steps.size, 1) * inverse
        robust = inverse @ blocks.T @ blocks @ inverse
        result = []
        for i, (rate, square) in enumerate(self.terms):
            own, size = slice(2 * i, 2 * i + 2), rate**2 + max(square, 0.0)
            omega = np.sqrt(max(square, 1e-300))
            slopes = np.array([[0.0, 0.25 / (np.pi * omega)], [square / size**1.5, -0.5 * rate / size**1.5]]) * steps[i]
            result.append([np.diag(slopes @ each[own, own] @ slopes.T) for each in (white, robust)])
        return np.asarray(np.sqrt(np.max(result, axis=1)))


class RingDown(NamedTuple):
    """Modes of a record of free vibration.

    Attributes:
        poles: damped frequencies, Hz, and damping ratios (k, 2), the largest mode first.
        deviations: their standard deviations (k, 2).
        notes: remarks of one line each on what was left out.
    """

    poles: Array
    deviations: Array
    notes: tuple[str, ...]

    @classmethod
    def of(cls, times: Vector, values: Array, names: Sequence[str] | None = None) -> "RingDown":
        """Return the proven modes of a record; arguments and errors as in `Ringing.estimate`."""
        moments, signals = np.asarray(times, dtype=np.float64), np.atleast_2d(np.asarray(values, dtype=np.float64).T).T
        labels = list(names) if names is not None else [f"column {i}" for i in range(signals.shape[1])]
        _check_record(moments, signals, labels)
        varying = (np.ptp(signals, axis=0) > 0.0).tolist()
        if not any(varying):
            raise ValueError("ringing: constant values are not allowed; give a record of a vibration")
        notes = [f"{labels[i]}: constant readings are left out" for i, varies in enumerate(varying) if not varies]
        labels = [name for name, varies in zip(labels, varying, strict=True) if varies]
        signals = signals[:, varying] / signals[:, varying].std(axis=0)
        moments, signals = _from_start(moments - moments[0], signals)
        jitter, count = Sampling.of(moments), np.arange(len(moments))
        even = float(np.polyfit(count - count.mean(), moments, 1)[0]) * count.astype(np.float64)
        fits = [_fit_samples(moments, signals, labels)]
        if not jitter.is_equal and jitter.jitter > JITTER:  # time stamps may vary more than the sampling
            fits.append(_fit_samples(even, signals, labels))
        best = min(fits, key=lambda each: each[0].squares / each[0].residuals.size)
        if best is not fits[0]:
            notes.append(f"steps up to {100 * jitter.jitter:.2g} % from the median are read as equal ones")
        fit, used, remarks = best
        found = _modes(fit, [labels[i] for i in used])
        return found._replace(notes=(*notes, *remarks, *found.notes))


def _check_record(times: Array, values: Array, names: Sequence[str]) -> None:
    """Raise a ValueError for times that do not increase, and for readings that do not belong to them."""
    if times.ndim != 1 or len(times) < MIN_SAMPLES:
        raise value_error("ringing: time", f"shape {times.shape}", f"at least {MIN_SAMPLES} increasing times")
    if len(falls := np.flatnonzero(np.diff(times) <= 0.0)):
        given = f"{times[falls[0] + 1]:.10g} after {times[falls[0]]:.10g} s"
        raise value_error("ringing: time", given, "increasing times")
    if values.ndim != 2 or len(values) != len(times):
        raise value_error("ringing: values", f"shape {values.shape}", f"({len(times)},) or ({len(times)}, c) readings")
    if not np.isfinite(values).all():
        raise value_error("ringing: values", f"{(~np.isfinite(values)).sum()} readings", "finite numbers")
    if len(names) != values.shape[1]:
        raise value_error("ringing: names", list(names), f"{values.shape[1]} names, one for each column")


def _from_start(times: Array, signals: Array) -> tuple[Array, Array]:
    """Return the record from its largest deviation from the mean of its end on, if this is in its first half."""
    away = np.abs(signals - signals[-len(signals) // 4 :].mean(axis=0)).sum(axis=1)
    first = int(away.argmax())
    first = first if first < len(signals) // 2 else 0
    return times[first:] - times[first], signals[first:]


def _fit_samples(times: Array, signals: Array, names: Sequence[str]) -> tuple[DampedSinusoids, list[int], list[str]]:
    """Return the fit of the samples of the vibration, the indices of its columns, and what was left out."""
    repeated = np.any([repeated_readings(each) for each in signals.T], axis=0)
    notes = [f"{repeated.sum()} readings that repeat the one before are left out"] * bool(repeated.any())
    times, signals = times[~repeated], signals[~repeated]
    at_limit = np.column_stack([crowded_extremes(each) for each in signals.T])
    steps = np.array([rounding_step(each) for each in signals.T])
    fit, used = _fit_columns(times, signals, at_limit)
    notes += [_left_out(name, fit, signals[:, i : i + 1], times) for i, name in enumerate(names) if i not in used]
    if at_limit.any() and len(fit.times) < len(times):
        kept = _without_clipped(fit, times, signals[:, used], at_limit[:, used], steps[used])
        if kept.all():
            fit, used = _fit_columns(times, signals, 0.0 * at_limit)
        else:
            notes.append(f"{(~kept).sum()} readings at a limit of the sensor are left out")
            fit = DampedSinusoids.find(*_enough(times[kept], signals[kept][:, used]))
    elif at_limit.any():
        raise value_error("ringing", "readings at a limit of the sensor to the end", f"{MIN_SAMPLES} or more others")
    large = np.flatnonzero((np.abs(fit.vibration()) >= steps[used]).any(axis=1))
    end = int(large[-1]) + 1 if len(large) else 0
    if (fit.noise < COARSE * steps[used]).all() and MIN_SAMPLES <= end < len(fit.times):
        notes.append(f"{len(fit.times) - end} readings of a vibration smaller than a step of rounding are left out")
        fit = DampedSinusoids.find(fit.times[:end], fit.signals[:end])
    return fit, used, notes


def _fit_columns(times: Array, signals: Array, at_limit: Array) -> tuple[DampedSinusoids, list[int]]:
    """Return the fit of the readings that are not at a limit, and the indices of the columns with the vibration."""
    kept = ~at_limit.any(axis=1)
    times, signals = (times[kept], signals[kept]) if kept.sum() >= MIN_SAMPLES else (times, signals)
    used = list(range(signals.shape[1]))
    if len(used) > 1:
        left = DampedSinusoids.of(np.zeros((0, 2)), times, signals)
        errors = left.with_term()
        explained = 1.0 - (errors.residuals**2).sum(axis=0) / np.maximum((left.residuals**2).sum(axis=0), 1e-30)
        used = np.flatnonzero(explained >= MIN_EXPLAINED * explained.max()).tolist()
    return DampedSinusoids.find(*_enough(times, signals[:, used])), used


def _left_out(name: str, fit: DampedSinusoids, column: Array, times: Array) -> str:
    """Return the remark on a column (T, 1) without the vibration of the others."""
    own = DampedSinusoids.find(times - times[0], column)
    if own.explained < MIN_EXPLAINED:
        return f"{name}: no vibration is found; it is left out"
    frequencies = own.poles[0, 0], fit.poles[0, 0]
    return f"{name}: {frequencies[0]:.5g} Hz, and {frequencies[1]:.5g} Hz in the other columns; it is left out"


def _enough(times: Array, signals: Array) -> tuple[Array, Array]:
    """Return a record, its times from 0, or raise a ValueError for one with less than MIN_SAMPLES readings."""
    if len(times) < MIN_SAMPLES:
        raise value_error("ringing", f"{len(times)} readings within the limits of the sensor", f"{MIN_SAMPLES} or more")
    return times - times[0], signals


def _without_clipped(
    fit: DampedSinusoids, times: Array, signals: Array, at_limit: Array, steps: Array
) -> NDArray[np.bool_]:
    """Return True (T,) for readings below the limits that the vibration exceeds, by a fit of the others.

    Args:
        fit: fit of the readings that are not at extreme values.
        times: (T,) times of the whole record, s.
        signals: (T, c) all readings.
        at_limit: (T, c); see `crowded_extremes`.
        steps: (c,) steps of rounding.
    """
    kept, start = np.ones(len(times), dtype=bool), times[~at_limit.any(axis=1)][0]
    predicted = fit.predict(times - start)
    for i, (noise, step) in enumerate(zip(fit.noise, steps, strict=True)):
        for sign in (1.0, -1.0):
            side, values, expected = at_limit[:, i] == sign, sign * signals[:, i], sign * predicted[:, i]
            least = max(CLIPPED[0] * noise, CLIPPED[1] * step, CLIPPED[2])
            if side.any() and np.median(expected[side] - values[side]) > least:
                limit = np.median(values[side]) - MARGIN * noise
                kept &= ~(side | (np.minimum(expected, values + 2.0 * MARGIN * noise) > limit))
    return kept


def _modes(fit: DampedSinusoids, names: Sequence[str]) -> RingDown:
    """Return the proven modes of a fit, with remarks about other vibrations, or raise a ValueError without a mode."""
    if fit.explained < MIN_EXPLAINED:
        raise ValueError(
            f"ringing: damped vibrations explain {100 * max(fit.explained, 0.0):.0f} % of the record, less than "
            f"{100 * MIN_EXPLAINED:.0f} %; give a record that starts when the arm stops"
        )
    poles, deviations, notes = fit.poles, fit.deviations(), []
    long = poles[:, 0] * fit.times[-1] >= MIN_CYCLES
    smallest = poles[long, 1].min(initial=MAX_DAMPING)
    ringing = np.flatnonzero(long & (poles[:, 1] < max(TRANSIENT_DAMPING, smallest * 1.001)))
    proven = []
    for i in ringing.tolist():
        if poles[i, 1] > PROOF * deviations[i, 1] and fit.decays[i] > MIN_DECAY:
            proven.append(i)
            continue
        found = f"{poles[i, 0]:.4g} Hz with a damping ratio of {poles[i, 1]:.2g} +- {deviations[i, 1]:.2g}"
        notes.append(f"{found} does not decay and is left out")
    if not proven and notes:
        allowed = "a record that proves a decay, without the tone of a motor or a fan"
        raise value_error("ringing", notes[0].removesuffix(" does not decay and is left out"), allowed)
    _check_mode(poles[proven[0] if proven else 0], fit.times[-1])
    modes = proven[:MOST_MODES]
    result = RingDown(poles[modes], deviations[modes], tuple(notes))
    return _compare_columns(result, fit, names) if len(names) > 1 else result


def _check_mode(pole: Array, duration: float) -> None:
    """Raise a ValueError for a mode that is no vibration, or of which the record has too few cycles."""
    frequency, ratio = pole.tolist()
    if frequency * duration < MIN_CYCLES:
        cycles = f"{MIN_CYCLES:g} or more cycles of {frequency:.3g} Hz"
        raise value_error("ringing", f"a record of {duration:.3g} s", cycles)
    if not 0.0 < ratio < MAX_DAMPING:
        raise value_error("ringing: the damping ratio", round(ratio, 4), f"a vibration with 0 to {MAX_DAMPING:g}")


def _compare_columns(found: RingDown, fit: DampedSinusoids, names: Sequence[str]) -> RingDown:
    """Return modes with remarks about columns that have another frequency; these widen the deviation of the frequency.

    Args:
        found: modes of all columns.
        fit: fit of all columns.
        names: (c,) names of the columns.
    """
    frequency, deviation, notes = found.poles[0, 0], found.deviations[0, 0], list(found.notes)
    error = 0.0
    for i, name in enumerate(names):
        own = DampedSinusoids.find(fit.times, fit.signals[:, i : i + 1])
        nearest = int(np.abs(own.poles[:, 0] - frequency).argmin())
        difference, accuracy = abs(own.poles[nearest, 0] - frequency), own.deviations()[nearest, 0]
        limit = max(DISAGREEMENT[0] * float(np.hypot(deviation, accuracy)), DISAGREEMENT[1] * frequency)
        if difference > limit:
            largest = 0 if difference > SAME_MODE * frequency else nearest
            notes.append(f"{name} has {own.poles[largest, 0]:.5g} Hz, and all columns together {frequency:.5g} Hz")
            error = max(error, 0.5 * difference) if difference < SAME_MODE * frequency else error
    deviations = found.deviations.copy()
    deviations[0, 0] = max(deviation, error)
    return RingDown(found.poles, deviations, tuple(notes))


def _scales(terms: Array, length: float) -> Array:
    """Return the steps (k, 2) of terms that change a vibration noticeably over the length of a record, s."""
    rates = np.maximum(np.abs(terms[:, 0]), 1.0 / length)
    return 0.1 * np.column_stack([rates, 2.0 * np.maximum(np.sqrt(np.abs(terms[:, 1])), rates) * rates])


def _basis(terms: Array, times: Array, length: float) -> Array:
    """Return two solutions for each term, a constant and a line (T, 2 k + 2) over the length of a record, s."""
    columns = [np.ones(len(times)), times / length]
    for rate, square in terms.tolist():
        omega = max(float(np.sqrt(abs(square))), SLOWEST / length)  # slower exponentials would be equal
        if square > 0.0:
            decay = np.exp(np.clip(-rate * times, -700.0, 1.0))
            columns += decay * np.cos(omega * times), decay * np.sin(omega * times)
        else:
            columns += (np.exp(np.clip((sign * omega - rate) * times, -700.0, 1.0)) for sign in (1.0, -1.0))
    return np.column_stack([*columns[2:], *columns[:2]])

"""Frequencies and damping ratios of a record of free vibration, by separable least squares."""

import numpy as np

from flexman_gym.common.arrays import Array, Vector
from flexman_gym.common.checks import value_error
from flexman_gym.common.time_series import uniform_period

MIN_CYCLES = 2.0  # cycles of a mode in the record
MIN_AMPLITUDE = 0.01  # fraction of the root mean square of the record; smaller second modes are noise
MIN_EXPLAINED = 0.5  # fraction of the variance that damped sinusoids explain
MAX_DAMPING = 0.5  # damping ratio; a larger one is no vibration
TRANSIENT_DAMPING = 0.2  # damping ratio; beside a mode with less, a larger one is a transient of a servo or a filter
START_RATIOS = (0.001, 0.004, 0.015, 0.05, 0.15, 0.4)  # damping ratios from which the fit starts
LARGEST_RATIO = 0.95  # damping ratio of a transient in the fit
TERMS, MOST_MODES = 3, 2  # largest number of damped sinusoids in the fit, transients among them, and of modes
BLOCKS = 25  # blocks of residuals
PADDING = 4  # length of the padded spectrum / length of the record


def fit_ring_down(times: Vector, values: Array) -> tuple[Array, Array]:
    """Return damped frequencies (Hz) and damping ratios (k, 2) of a record, and their standard deviations (k, 2).

    The record begins at its largest deviation from the mean of its end; arguments as in `Ringing.estimate`.
    """
    moments, signals = np.asarray(times, dtype=float), np.atleast_2d(np.asarray(values, dtype=float).T).T
    period = uniform_period("ringing", moments)
    signals = signals[:, np.ptp(signals, axis=0) > 0.0]
    if not signals.size:
        raise ValueError("ringing: constant values are not allowed; give a record of a vibration")
    signals = np.asarray(signals / signals.std(axis=0), dtype=np.float64)
    away = np.abs(signals - signals[-len(signals) // 4 :].mean(axis=0)).sum(axis=1)
    first = int(away.argmax())
    signals = signals[first if first < len(signals) // 2 else 0 :]
    moments = period * np.arange(len(signals), dtype=np.float64)
    poles, left = np.zeros((0, 2)), _residuals(np.zeros((0, 2)), moments, signals)
    if signals.shape[1] > 1:  # columns without the vibration are left out
        errors = _residuals(_add_mode(poles, left, moments, signals), moments, signals)
        explained = 1.0 - (errors**2).sum(axis=0) / np.maximum((left**2).sum(axis=0), 1e-30)
        showing = explained >= MIN_EXPLAINED * explained.max()
        signals, left = signals[:, showing], left[:, showing]
    total = float((left**2).sum())
    for _ in range(TERMS):
        found = _add_mode(poles, left, moments, signals)
        errors = _residuals(found, moments, signals)
        before, after = float((left**2).sum()), float((errors**2).sum())
        gain = errors.size * np.log(before / max(after, 1e-30)) - (2 + 2 * signals.shape[1]) * np.log(errors.size)
        valid = (found > 0.0) & (found < (0.5 / period, LARGEST_RATIO))
        if len(poles) and not (valid.all() and gain > 0.0 and before - after > MIN_AMPLITUDE**2 * total):
            break
        poles, left = found, errors
    if (explained := 1.0 - float((left**2).sum()) / total) < MIN_EXPLAINED:
        raise ValueError(
            f"ringing: damped vibrations explain {100 * max(explained, 0.0):.0f} % of the record, less than "
            f"{100 * MIN_EXPLAINED:.0f} %; give a record that starts when the arm stops"
        )
    ringing = np.flatnonzero(poles[:, 1] < max(TRANSIENT_DAMPING, poles[:, 1].min() * 1.001))[:MOST_MODES]
    _check_modes(poles[ringing], moments[-1])
    return poles[ringing], _standard_deviations(poles, moments, signals)[ringing]


def _check_modes(poles: Array, duration: float) -> None:
    """Raise a ValueError for modes that are no vibration, or of which the record has too few cycles."""
    for frequency, ratio in poles.tolist():
        if not 0.0 < ratio < MAX_DAMPING:
            raise value_error("ringing: the damping ratio", round(ratio, 4), f"a vibration with 0 to {MAX_DAMPING:g}")
        if frequency * duration < MIN_CYCLES:
            cycles = f"{MIN_CYCLES:g} or more cycles of {frequency:.3g} Hz"
            raise value_error("ringing", f"a record of {duration:.3g} s", cycles)


def _residuals(poles: Array, times: Array, signals: Array) -> Array:
    """Return signals (T, c) less their best fit by modes (k, 2) with free amplitudes and phases, offset and drift."""
    rate = 2.0 * np.pi * np.abs(poles[:, 0])
    slopes = poles[:, 1] / np.sqrt(np.maximum(1.0 - poles[:, 1] ** 2, 0.01))
    decay = np.exp(np.maximum(-np.outer(times, np.clip(slopes, 0.0, 3.2) * rate), -700.0))
    phases = np.outer(times, rate)
    line = np.column_stack([np.ones(len(times)), times / times[-1]])
    basis = np.linalg.qr(np.hstack([decay * np.cos(phases), decay * np.sin(phases), line]))[0]
    return signals - basis @ (basis.T @ signals)


def _add_mode(poles: Array, left: Array, times: Array, signals: Array) -> Array:
    """Return modes (k + 1, 2) fitted to the signals, with a mode added at the peak of the spectrum of the residuals."""
    from scipy.optimize import least_squares

    spectrum = (np.abs(np.fft.rfft(left, PADDING * len(times), axis=0)) ** 2).sum(axis=1)
    spectrum[: int(1.5 * PADDING)] = 0.0
    peak = float(spectrum.argmax()) / (PADDING * len(times) * (times[1] - times[0]))
    starts = [np.vstack([poles, (peak, ratio)]) for ratio in START_RATIOS]
    start = min(starts, key=lambda each: float((_residuals(each, times, signals) ** 2).sum()))
    scales = np.column_stack([np.full(len(start), 0.1 / times[-1]), np.full(len(start), 0.01)]).ravel()

    def errors(steps: Array) -> Array:
        return _residuals(start + (scales * steps).reshape(-1, 2), times, signals).ravel()

    found = least_squares(errors, np.zeros(start.size), method="lm")
    return np.asarray(start + (scales * found.x).reshape(-1, 2))


def _standard_deviations(poles: Array, times: Array, signals: Array) -> Array:
    """Return the standard deviations (k, 2) of fitted modes."""
    steps = 1e-4 * np.column_stack([poles[:, 1] * poles[:, 0], poles[:, 1]]).ravel()
    middle, columns = _residuals(poles, times, signals), []
    for i, step in enumerate(steps):
        change = step * (np.arange(steps.size) == i).reshape(-1, 2)
        ahead, behind = (_residuals(poles + sign * change, times, signals) for sign in (1.0, -1.0))
        columns.append((ahead - behind) / 2.0)
    jacobian = np.stack(columns)  # (2 k, T, c), per step
    inverse = np.linalg.inv(np.einsum("atc,btc->ab", jacobian, jacobian))
    scores = np.einsum("atc,tc->at", jacobian, middle)
    blocks = np.stack([each.sum(axis=1) for each in np.array_split(scores, BLOCKS, axis=1)])
    white = float((middle**2).sum()) / (middle.size - 5 * len(steps)) * np.diag(inverse)
    robust = np.diag(inverse @ blocks.T @ blocks @ inverse)
    return np.asarray((steps * np.sqrt(np.maximum(white, robust))).reshape(-1, 2))

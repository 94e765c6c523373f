"""Ringing: frequencies and damping ratios, estimated from records of free vibration, and their exact derivatives."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from flexman_gym.common.arrays import Array, Vector
from flexman_gym.common.checks import (
    flag,
    positive,
    sequence,
    set_fields,
    value_error,
    vector,
    warn_caller,
    whole_number,
)
from flexman_gym.common.clock import EqualTimes
from flexman_gym.common.time_series import read_time_series
from flexman_gym.model.dynamics import damping_matrix, mass_matrix, stiffness_matrix
from flexman_gym.model.model import Model
from flexman_gym.model.vibration import EquilibriumMatrices
from flexman_gym.simulation.parameters import varied_model

FREQUENCY_DEVIATION = 0.005  # relative standard deviation of a measured frequency
DAMPING_DEVIATION = 0.1  # relative standard deviation of a measured damping ratio
KEYS = ("frequencies", "damping", "joint_angles", "lock_joints", "numbers", "deviation", "damping_deviation")


def _positive(name: str, value: float | Vector, count: int) -> float | Vector:
    """Return a checked number > 0 for all modes, or (count,) numbers."""
    if np.ndim(value) == 0:
        return positive(name, value)
    return tuple(positive(f"{name}[{i}]", each) for i, each in enumerate(vector(name, value, count)))


@dataclass(frozen=True)
class Ringing:
    """Natural frequencies and damping ratios with given deviations, measured at one posture.

    Attributes:
        frequencies: damped natural frequencies (k,) from a ring-down or a spectrum, Hz.
        damping: damping ratios (k,) of the modes with these frequencies, or None. A logarithmic decrement D corresponds
            to a damping ratio D / sqrt(4 pi^2 + D^2).
        joint_angles: joint angles (n,) of the measurement, rad; None for zeros.
        lock_joints: True if the motors, not the links, were locked in the measurement; False if they were free.
        numbers: indices (k,) of these modes among the modes of the model, from 0 for the lowest frequency; None for the
            k lowest frequencies.
        deviation: relative standard deviation of the frequencies, 1, for all or (k,).
        damping_deviation: relative standard deviation of the damping ratios, 1, for all or (k,).

    Examples:
        >>> ringing = fm.Ringing(frequencies=(1.3, 11.2), damping=(0.008, 0.007), joint_angles=(0.5,))
        >>> found = fm.fit(fm.catalog.one_joint(), "joint_stiffness", ringing, elements=1)
        >>> found.frequencies.shape
        (4, 3)
    """

    frequencies: Vector
    damping: Vector | None = None
    joint_angles: Vector | None = None
    lock_joints: bool = True
    numbers: Vector | None = None
    deviation: float | Vector = FREQUENCY_DEVIATION
    damping_deviation: float | Vector = DAMPING_DEVIATION

    def __post_init__(self) -> None:
        values = vector("frequencies", self.frequencies, unit="Hz")
        count = len(values)
        if not values or min(values) <= 0.0:
            raise value_error("frequencies", self.frequencies, "numbers > 0 (Hz)")
        set_fields(self, frequencies=values, deviation=_positive("deviation", self.deviation, count))
        flag("lock_joints", self.lock_joints)
        if self.damping is not None:
            damping = vector("damping", self.damping, count)
            if not all(0.0 < ratio < 1.0 for ratio in damping):
                raise value_error("damping", self.damping, "damping ratios > 0 and < 1, one for each frequency")
            deviation = _positive("damping_deviation", self.damping_deviation, count)
            set_fields(self, damping=damping, damping_deviation=deviation)
        numbers = range(count) if self.numbers is None else sequence("numbers", self.numbers)
        set_fields(self, numbers=tuple(whole_number("numbers", each, 0, 10**4) for each in numbers))
        if len(self.numbers) != count:  # type: ignore[arg-type]
            raise value_error("numbers", self.numbers, f"{count} mode numbers, one for each frequency")

    @property
    def measured(self) -> Array:
        """Measured frequencies (k,), Hz; with damping (2 k,), followed by the damping ratios."""
        return np.array([*self.frequencies, *(self.damping or ())])

    @property
    def deviations(self) -> Array:
        """Standard deviations (k,) of the frequencies, Hz; with damping (2 k,), then those of the damping ratios."""
        parts = [np.broadcast_to(self.deviation, len(self.frequencies))]
        return self.measured * np.append(parts, np.broadcast_to(self.damping_deviation, len(self.damping or ())))

    @classmethod
    def estimate(cls, times: Vector, values: Array) -> "Ringing":
        """Estimate frequencies and damping ratios of one or two modes from a record of free vibration.

        The record is fitted by least squares with damped sinusoids, an offset and a drift. A second mode is kept if the
        Bayesian information criterion accepts it, with at least MIN_AMPLITUDE of the signal. The standard deviations
        are the larger ones of those of white noise and those of blocks of the residuals, which may be correlated.

        Args:
            times: (T,) times, s; steps that vary by up to half of their median are interpolated, with a UserWarning.
            values: (T,) or (T, c) readings, in any unit.

        Raises:
            ValueError: for a record of less than MIN_CYCLES cycles, and for one without a damped vibration.
        """
        poles, deviations = _fit_ring_down(times, values)
        order = np.argsort(poles[:, 0])
        (frequencies, damping), (first, second) = poles[order].T, deviations[order].T
        return cls(frequencies, damping, deviation=first / frequencies, damping_deviation=second / damping)

    @classmethod
    def from_csv(cls, path: str | Path, columns: Sequence[str] | None = None) -> "Ringing":
        """Estimate frequencies and damping ratios from a CSV file; see `read_time_series` and `estimate`.

        Args:
            path: path of the file; its columns need no units.
            columns: names of the columns; None for all but commands, set points and temperatures.

        Raises:
            FileNotFoundError: if the file does not exist.
        """
        record = read_time_series(path, columns).warn()
        return cls.estimate(record.times, record.table)

    def predict(self, model: Model, parameters: Mapping[str, Array], h: float) -> tuple[Array, Array]:
        """Compute the frequencies and damping ratios of a model, and their Jacobian.

        A change of mass, damping and stiffness matrices M, C and K changes an eigenvalue s with eigenvector y by
        -y^T (s^2 dM + s dC + dK) y, if y^T (2 s M + C) y = 1. M and K are linear in most parameters, so that their
        differences are exact.

        Args:
            model: the model.
            parameters: values (1 + p, ...) by name: unperturbed values, then for each of p free scalars the values
                with this scalar increased.
            h: increase of the values, absolute or as a fraction, for the Jacobian.

        Returns:
            Frequencies (k,) or frequencies and damping ratios (2 k,), and their Jacobian with p columns.
        """
        count = len(next(iter(parameters.values())))
        rows = [{name: values[i] for name, values in parameters.items()} for i in range(count)]
        matrices = [self._equilibrium(varied_model(model, **row)) for row in rows]
        columns = matrices[0].free if self.lock_joints else np.arange(model.n_dof)
        found = matrices[0].oscillatory_modes(columns)
        chosen = list(self.numbers or ())
        if len(found.values) <= max(chosen):
            raise value_error(
                "frequencies", self.frequencies, f"at most {len(found.values)}, the number of modes of this model"
            )
        s, y = found.values[chosen], found.shapes[chosen]
        jacobian = []
        for perturbed in matrices[1:]:
            pairs = zip(perturbed[:3], matrices[0][:3], strict=True)
            mass, damping, stiffness = ((a - b)[np.ix_(columns, columns)] / h for a, b in pairs)
            change = -(y * (s[:, None] ** 2 * (y @ mass) + s[:, None] * (y @ damping) + y @ stiffness)).sum(axis=1)
            ratio = -(change * np.abs(s) - s * (np.conj(s) * change).real / np.abs(s)).real / np.abs(s) ** 2
            jacobian.append(self._join(change.imag / (2.0 * np.pi), ratio))
        return self._join(s.imag / (2.0 * np.pi), -s.real / np.abs(s)), np.transpose(jacobian)

    def _join(self, frequencies: Array, ratios: Array) -> Array:
        """Return frequencies, followed by damping ratios if these were measured."""
        return np.append(frequencies, ratios) if self.damping else np.asarray(frequencies)

    def _equilibrium(self, model: Model) -> EquilibriumMatrices:
        """Return the matrices at the equilibrium, which is the undeformed arm if there is no gravity."""
        angles = np.zeros(model.n_joints) if self.joint_angles is None else self.joint_angles
        if any(model.arm.gravity):
            return EquilibriumMatrices.of(model, angles)
        matrices = mass_matrix(model, model.initial_state(angles)), damping_matrix(model), stiffness_matrix(model)
        return EquilibriumMatrices(*matrices, np.zeros((3, model.n_dof)), model.motor_columns)


MIN_CYCLES = 2.0  # cycles of a mode in the record
MIN_SAMPLES = 16  # readings in a fit
CLIPPED = 3  # equal extreme readings in a row that show a limit of the sensor
PROOF = 4.0  # standard deviations of a damping ratio above 0 that prove a decay
MIN_AMPLITUDE = 0.01  # fraction of the root mean square of the record; smaller second modes are noise
MIN_EXPLAINED = 0.5  # fraction of the variance that damped sinusoids explain
MAX_DAMPING = 0.5  # damping ratio; a larger one is no vibration
TRANSIENT_DAMPING = 0.2  # damping ratio; beside a mode with less, a larger one is a transient of a servo or a filter
START_RATIOS = (0.001, 0.004, 0.015, 0.05, 0.15, 0.4)  # damping ratios from which the fit starts
LARGEST_RATIO = 0.95  # damping ratio of a transient in the fit
TERMS, MOST_MODES = 3, 2  # largest number of damped sinusoids in the fit, transients among them, and of modes
BLOCKS = 25  # blocks of residuals
PADDING = 4  # length of the padded spectrum / length of the record


def _fit_ring_down(times: Vector, values: Array) -> tuple[Array, Array]:
    """Return damped frequencies (Hz) and damping ratios (k, 2) of a record, and their standard deviations (k, 2).

    The record begins at its largest deviation from the mean of its end; arguments as in `Ringing.estimate`.
    """
    from scipy.interpolate import make_interp_spline

    moments, signals = np.asarray(times, dtype=float), np.atleast_2d(np.asarray(values, dtype=float).T).T
    even = EqualTimes.of("ringing", moments)
    if even.is_interpolated:
        signals = make_interp_spline(moments, signals)(even.times)
    if even.note:
        warn_caller(f"ringing: {even.note}")
    period = float(even.times[1] - even.times[0])
    signals = signals[:, np.ptp(signals, axis=0) > 0.0]
    if not signals.size:
        raise ValueError("ringing: constant values are not allowed; give a record of a vibration")
    signals = np.asarray(signals / signals.std(axis=0), dtype=np.float64)
    signals = signals[_end_of_clipping(signals) :]
    if len(signals) < MIN_SAMPLES:
        raise value_error("ringing", f"{len(signals)} readings after the last one at a limit", f"{MIN_SAMPLES} or more")
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
    deviations = _standard_deviations(poles, moments, signals)
    proven = ringing[poles[ringing, 1] > PROOF * deviations[ringing, 1]]
    for i in ringing[~np.isin(ringing, proven)].tolist():
        found = f"{poles[i, 0]:.4g} Hz with a damping ratio of {poles[i, 1]:.2g} +- {deviations[i, 1]:.2g}"
        if not len(proven):
            allowed = "a record that proves a decay, without the tone of a motor or a fan"
            raise value_error("ringing", found, allowed)
        warn_caller(f"ringing: {found} does not decay and is left out")
    _check_modes(poles[proven], moments[-1])
    return poles[proven], deviations[proven]


def _end_of_clipping(signals: Array) -> int:
    """Return the index after the last reading at a limit of the sensor, with a UserWarning for such readings.

    A reading is at a limit if at least CLIPPED of its neighbours in a row have the same value, which is the largest or
    the smallest one of its column. As a free vibration decays, only its beginning is clipped.
    """
    last = 0
    for values in signals.T:
        equal = np.r_[False, np.diff(values) == 0.0]
        for limit in (values.max(), values.min()):
            runs = np.convolve(equal & (values == limit), np.ones(CLIPPED - 1), "valid") == CLIPPED - 1
            last = max(last, int(np.flatnonzero(runs)[-1]) + CLIPPED - 1 if runs.any() else 0)
    if not last:
        return 0
    warn_caller(f"ringing: the first {last} readings, up to the last one at a limit of the sensor, are left out")
    return last


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
    decay = np.maximum(np.abs(poles[:, 1]), 1.0 / (2.0 * np.pi * poles[:, 0] * times[-1]))  # also of an undamped tone
    steps = 1e-4 * np.column_stack([decay * poles[:, 0], decay]).ravel()
    poles = np.column_stack([poles[:, 0], np.maximum(poles[:, 1], 1e-4 * decay)])  # `_residuals` has no growth
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

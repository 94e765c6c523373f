"""Predicted root strain against the strain gauges of a real arm, and the margin that the error of the model needs."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

import flexman_gym as fm
from flexman_gym.common.arrays import Array
from flexman_gym.model.linearization import LinearMeasurements
from flexman_gym.toolbox.controllers.observers.kalman_filter import measurement_update, stationary_covariance
from flexman_gym.toolbox.identification.least_squares import FreeParameters
from studies.machine.measure import (
    CURRENT,
    DATA,
    FACTORS,
    HALF,
    LENGTHS,
    LOGGED,
    ONE,
    TWO,
    both_stages,
    driven,
    friction_fit,
    moving,
)

THICKNESSES = (1.27e-3, 0.889e-3)  # m; thicknesses of the strips; strains are compared at the radius of gyration
HORIZONS = (0.0, 0.1, 0.3, 1.0)  # s; 0 for the whole record from its initial state
WINDOW, DEGREE = (
    0.042,
    5,
)  # s, degree; polynomials that smooth and differentiate the log: errors of 3 % at 17 Hz, 11 % at 25 Hz
LOG_NOISE, OFFSET = 5e-6, 1.5e-5  # m/m; standard deviations of noise and offset of the log in the observer
OFFSET_TIME_CONSTANT = 30.0  # s; correlation time of the offset
HUB_NOISES = (0.3, 1.0, 3.0, 10.0)  # rad/s^2; candidates for the error of the acceleration of a hub in each period
LIMITED = 0.5  # fraction of the median peak; runs with smaller peaks are far from any limit and are not pooled
ONE_STAGE, BOTH, ALL = "one stage", "both stages", "all"


@dataclass(frozen=True)
class StrainRow:
    """Error of the predicted strain at a gauge in held-out records.

    Attributes:
        part: "one stage", "both stages", or "currents" for both stages with currents in place of hub angles as inputs.
        run: name of the record; "all" for the records of the part whose peak is at least half of the median peak.
        stage: number of the gauge.
        horizon: time of the prediction from the state of the observer, s; 0 for the whole record.
        peak: largest magnitude of the measured strain, m/m, by the calibration of the data sheet.
        rms, most, nearly_all, largest: root mean square, 95 % quantile, 99.9 % quantile and maximum of the magnitude of
            the error, as fractions of the peak of its record.
    """

    part: str
    run: str
    stage: float
    horizon: float
    peak: float
    rms: float
    most: float
    nearly_all: float
    largest: float

    @classmethod
    def pooled(cls, part: str, run: str, stage: int, horizon: float, peak: float, errors: Array) -> "StrainRow":
        """Return the row of errors (k,), which are fractions of the peaks."""
        sizes = np.abs(errors)
        quantiles = np.quantile(sizes, [0.95, 0.999, 1.0]).tolist()
        return cls(part, run, stage, horizon, peak, float(np.sqrt(np.mean(sizes**2))), *quantiles)


def unfiltered(values: Array, period: float) -> Array:
    """Return signals (..., T) before the filter of the log, up to 25 Hz, from the derivatives of logged signals."""
    from scipy.signal import savgol_filter

    square, slope, _ = LOGGED.denominator[::-1]
    window = 2 * round(WINDOW / period / 2.0) + 1
    parts = [savgol_filter(values, window, DEGREE, deriv=order, delta=period) for order in range(3)]
    return np.asarray(parts[0] + slope / square * parts[1] + parts[2] / square)


def strain_record(record: fm.Measurement) -> fm.Measurement:
    """Return a record with strains at the root in place of deflections w(L), for a force at the end of the strip."""
    names = {old: old.replace("link_deflection", "root_strain") for old in record.outputs if "deflection" in old}
    rest = {name: values for name, values in record.outputs.items() if name not in names}
    factors = {
        old: -(3.0**0.5) / 2.0 * thickness / length**2
        for old, thickness, length in zip(names, THICKNESSES, LENGTHS, strict=False)
    }
    return replace(
        record,
        outputs=rest | {new: factors[old] * np.asarray(record.outputs[old]) for old, new in names.items()},
        filters={names[old]: each for old, each in record.filters.items()},
        gains=tuple(names[old] for old in record.gains),
        offsets=tuple(names[old] for old in record.offsets),
    )


class GaugeObserver:
    """Stationary Kalman filter of the deviation of links, log and its offset from a simulation with given hub angles.

    The deviation satisfies the equations of motion linearised at rest. It is driven by errors of the accelerations of
    the hubs, which are white from sample to sample.

    Args:
        found: fitted arm.
        names: m names of strains.
        period: sampling period, s.
        hub_noise: standard deviation of the errors of the accelerations, rad/s^2.
    """

    def __init__(self, found: fm.Fit, names: Sequence[str], period: float, hub_noise: float) -> None:
        from scipy.linalg import expm

        model = fm.build_model(found.arm, **found.choice)
        n, d, m = model.n_joints, model.n_dof, len(names)
        balance = fm.linearize(model, np.zeros(n)).balance
        assert balance is not None
        links, both = np.arange(n, d), np.append(np.arange(n, d), np.arange(d + n, 2 * d))
        inertia, (square, slope, _) = balance.mass[np.ix_(links, links)], LOGGED.denominator[::-1]
        x, log, offset = np.split(np.arange(2 * (d - n) + 3 * m), [2 * (d - n), 2 * (d - n) + 2 * m])
        speeds, size = x[d - n :], len(x) + 3 * m
        self.strain, self.log = np.zeros((m, size)), np.eye(size)[log[:m]]
        rows = LinearMeasurements(model).measure(np.eye(2 * d))["root_strains"][both]
        gains = np.array([found.gains[name][0] for name in names])
        self.strain[:, x] = gains[:, None] * rows[:, [3 * (int(name.split("_")[2]) - 1) for name in names]].T
        self.strain[:, offset] = np.eye(m)
        rates = np.zeros((size, size))
        rates[x[: d - n], speeds] = 1.0
        rates[np.ix_(speeds, x)] = np.linalg.solve(inertia, balance.forces[np.ix_(links, both)])
        rates[log[:m], log[m:]] = 1.0
        rates[log[m:]] = square * self.strain
        rates[np.ix_(log[m:], log)] -= np.hstack([square * np.eye(m), slope * np.eye(m)])
        rates[offset, offset] = -1.0 / OFFSET_TIME_CONSTANT
        self.transition, effect = expm(rates * period), np.zeros((size, n))
        effect[speeds] = hub_noise * period * np.linalg.solve(inertia, balance.mass[links, :n])
        noise = effect @ effect.T
        noise[offset, offset] = 2.0 * OFFSET**2 * period / OFFSET_TIME_CONSTANT
        variances = np.full(m, LOG_NOISE**2)
        before = stationary_covariance(self.transition, noise, self.log, variances)
        self.gain = measurement_update(before, self.log, variances)[0]

    def deviations(self, residuals: Array) -> Array:
        """Return the estimates (s, T) after each sample of the residuals (m, T) of the log."""
        result, estimate = np.zeros((len(self.transition), residuals.shape[1])), np.zeros(len(self.transition))
        for k, residual in enumerate(residuals.T):
            estimate = self.transition @ estimate
            result[:, k] = estimate = estimate + self.gain @ (residual - self.log @ estimate)
        return result

    def predicted(self, deviations: Array, samples: int) -> Array:
        """Return the deviations of the strains (m, T - samples), predicted a number of samples ahead of estimates."""
        count = deviations.shape[1] - samples
        return np.asarray(self.strain @ np.linalg.matrix_power(self.transition, samples) @ deviations[:, :count])


@dataclass(frozen=True)
class _Compared:
    """Measured strains of a record and their simulation, (m, T), both before the filter of the log."""

    measured: Array
    simulated: Array
    residuals: Array
    period: float

    @classmethod
    def of(cls, found: fm.Fit, record: fm.Measurement, known: slice = slice(0)) -> "_Compared":
        """Simulate a record; offsets are mean residuals of the known samples."""
        computed = found.predicted(replace(record, offsets=()))
        names = [name for name in record.outputs if "strain" in name]
        log, shown = (np.array([each[name] for name in names]) for each in (record.outputs, computed))
        if len(log[0, known]):
            shown = shown + (log - shown)[:, known].mean(axis=1, keepdims=True)
        period = record.period
        return cls(unfiltered(log, period), unfiltered(shown, period), log - shown, period)

    def errors(self, observer: GaugeObserver, horizon: float, part: slice) -> tuple[Array, Array]:
        """Return the peaks (m,) of the strains in a part of the record, and the errors (m, k) relative to them."""
        samples = round(horizon / self.period)
        errors = (self.measured - self.simulated)[:, samples:]
        if horizon:
            errors = errors - observer.predicted(observer.deviations(self.residuals), samples)
        peaks = np.abs(self.measured[:, part]).max(axis=1)
        late = slice(max((part.start or 0) - samples, 0), None if part.stop is None else part.stop - samples)
        return peaks, errors[:, late] / peaks[:, None]


def _tuned(found: fm.Fit, names: Sequence[str], fitted: Sequence[_Compared], part: slice) -> GaugeObserver:
    """Return the observer with the smallest RMS error of its predictions in the records of the fit."""

    def misfit(observer: GaugeObserver) -> float:
        return sum(float(np.mean(each.errors(observer, horizon, part)[1] ** 2))
                   for each in fitted for horizon in HORIZONS[1:])  # fmt: skip

    return min((GaugeObserver(found, names, fitted[0].period, noise) for noise in HUB_NOISES), key=misfit)


def _rows(part: str, errors: Mapping[tuple[str, int, float], tuple[float, Array]]) -> Iterator[StrainRow]:
    """Yield a row for each run, gauge and horizon, and the rows over the runs with large peaks."""
    median = {j: np.median([peak for (_, i, _), (peak, _) in errors.items() if i == j]) for _, j, _ in errors}
    for (run, j, horizon), (peak, values) in errors.items():
        yield StrainRow.pooled(part, run, j, horizon, peak, values)
    for j, horizon in dict.fromkeys(key[1:] for key in errors):
        some = [each for key, each in errors.items() if key[1:] == (j, horizon) and each[0] >= LIMITED * median[j]]
        values = np.concatenate([each for _, each in some])
        yield StrainRow.pooled(part, ALL, j, horizon, float(median[j]), values)


def one_stage(folder: Path = DATA) -> Iterator[StrainRow]:
    """Yield the rows of the runs of the first stage, each predicted with the fit of the other half of the runs."""
    runs = {name: strain_record(record) for name, record in moving(folder).items()}
    errors: dict[tuple[str, int, float], tuple[float, Array]] = {}
    names, whole = sorted(runs), slice(0, None)
    for half in (names[::2], names[1::2]):
        found = _fit(fm.catalog.quanser_2dsfl(1), FACTORS, [runs[name] for name in half], ONE)
        compared = {name: _Compared.of(found, runs[name]) for name in names}
        peaks = {name: np.abs(compared[name].measured).max() for name in half}
        large = [compared[name] for name in half if peaks[name] > LIMITED * np.median([*peaks.values()])]
        observer = _tuned(found, list(runs[half[0]].outputs), large, whole)
        for name in set(names) - set(half):
            for horizon in HORIZONS:
                peak, values = compared[name].errors(observer, horizon, whole)
                errors[name, 1, horizon] = float(peak[0]), values[0]
    yield from _rows(ONE_STAGE, dict(sorted(errors.items())))


def two_stages(folder: Path = DATA) -> Iterator[StrainRow]:
    """Yield the rows of the second half of the record of both stages.

    The stiffness and damping of link 1 are those of the runs of the first stage, and those of link 2 are fitted to the
    first half of the record. If this half determines all four, its residuals are smaller, but the factors of the
    stiffness become 2 and 0.2, and the errors in the second half are larger. For the prediction from currents the
    friction is fitted to the first half, too.
    """
    runs = [strain_record(record) for record in moving(folder).values()]
    first = _fit(fm.catalog.quanser_2dsfl(1), FACTORS, runs, ONE)
    start = FreeParameters(fm.catalog.quanser_2dsfl(), [f"{name}[0]" for name in FACTORS])
    arm = start.build_arm(np.array([first.values[name][0] for name in FACTORS]))
    record = strain_record(both_stages(folder / "two_stages.csv"))
    found = _fit(arm, [f"{name}[1]" for name in FACTORS], [record.part(0.0, HALF)], TWO)
    early, late = (slice(round(a / record.period), b) for a, b in ((record.settling, round(HALF / record.period)),
                                                                    (HALF, None)))  # fmt: skip
    compared, names = _Compared.of(found, record, early), list(record.outputs)
    observer = _tuned(found, names, [compared], early)
    errors: dict[tuple[str, int, float], tuple[float, Array]] = {}
    for horizon in HORIZONS:
        peaks, values = compared.errors(observer, horizon, late)
        errors |= {("second half", j + 1, horizon): (float(peaks[j]), values[j]) for j in range(len(names))}
    yield from _rows(BOTH, errors)
    moved = replace(friction_fit(found, strain_record(driven(folder / "two_stages.csv"))), step=record.period)
    peaks, values = _Compared.of(moved, strain_record(driven(folder / "two_stages.csv", 1)), early).errors(
        observer, 0.0, late
    )
    yield from _rows(CURRENT, {("second half", j + 1, 0.0): (float(peaks[j]), values[j]) for j in range(len(names))})


def _fit(arm: fm.Arm, free: Sequence[str], records: Sequence[fm.Measurement], choice: dict[str, Any]) -> fm.Fit:
    return fm.fit(arm, free, records=records, starts=0, check=False, **choice)

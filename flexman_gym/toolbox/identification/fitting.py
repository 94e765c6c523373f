"""Fit of an arm to measurements: estimates, covariance, practical identifiability, data warnings and report."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from flexman_gym.common.arrays import Array
from flexman_gym.common.checks import instance, mapping, positive, whole_number
from flexman_gym.common.errors import value_error
from flexman_gym.common.files import write_data, write_file
from flexman_gym.common.plot_style import BLUE, MIDDLE, new_figure, save_figure
from flexman_gym.model.model import build_model
from flexman_gym.scene.arm import Arm
from flexman_gym.scene.serialization import to_plain
from flexman_gym.simulation.episode import Episode
from flexman_gym.simulation.physical_parameters import ARM, PARAMETERS, nominal_parameters
from flexman_gym.toolbox.identification.least_squares import FreeParameters, LeastSquaresProblem
from flexman_gym.toolbox.identification.measurement import Measurement, SimulatedResponse, output_unit
from flexman_gym.toolbox.identification.ringing import KEYS, Ringing

MAX_RELATIVE_DEVIATION = 0.5  # relative standard deviation above which a parameter is not practically identifiable
MIN_COMPONENT = 0.3  # dimensionless; least entry of a unit eigenvector of the covariance that counts for a parameter
SPIKE_FACTOR = 10.0  # dimensionless; size of a spike relative to the robust standard deviation of the residual
MIN_CORRELATION = 0.7  # dimensionless; least correlation of measured and computed output for a check of unit and sign
MAX_SCORE = 0.995  # dimensionless; R2 above which no missing filter is suspected
UNIT_SCALES = {"rad": {57.29578: "deg", 1e3: "mrad"}, "m": {1e3: "mm", 1e2: "cm"}, "m/s^2": {1.0 / 9.80665: "g"},
               "1": {1e6: "um/m", 1e2: "percent"}}  # fmt: skip
MAX_SCALE = 4.0  # dimensionless; ratio of measured to computed output above which a wrong unit is suspected
FILTER_RESIDUAL = 0.5  # a filter is reported as missing if it reduces the squared residuals below this fraction


def _find_unidentifiable(free: FreeParameters, values: Array, covariance: Array) -> tuple[tuple[str, ...], str]:
    """Find the parameters that are not practically identifiable from the data.

    The standard deviation of such a parameter exceeds half of its value and half of its initial value.

    Args:
        free: the free parameters.
        values: (p,) values of these parameters.
        covariance: (p, p) covariance of their logarithms.

    Returns:
        The names of these parameters, and a sentence about them and about parameters that are inseparable.
    """
    scale = values / np.maximum(values, free.start)
    variances, directions = np.linalg.eigh(covariance * np.outer(scale, scale))
    uncertain = np.sqrt(np.diag(covariance)) * scale > MAX_RELATIVE_DEVIATION
    names = tuple(str(number) for number, each in zip(free.numbers, uncertain, strict=True) if each)
    phrases, single = [], set(names)
    for variance, direction in sorted(zip(variances, directions.T, strict=True), key=lambda pair: -pair[0]):
        together = [str(free.numbers[i]) for i in np.flatnonzero(uncertain & (np.abs(direction) > MIN_COMPONENT))]
        if np.sqrt(max(variance, 0.0)) > MAX_RELATIVE_DEVIATION and len(together) > 1 and single & set(together):
            phrases.append(f"{' and '.join(together)} separately")
            single -= set(together)
    phrases = [*(name for name in names if name in single), *phrases]
    if not phrases:
        return names, "The data determine every free parameter."
    return names, f"The data do not determine {', nor '.join(phrases)}."


def _data_warnings(problem: LeastSquaresProblem, x: Array) -> tuple[str, ...]:
    """Return a line for each likely error in the records."""
    lines = []
    first = problem.split(problem.evaluate(problem.start)[0])
    last = problem.split(problem.evaluate(x)[0])
    unexplained = set()
    for block, before, after in zip(problem.blocks, first, last, strict=True):
        if block.record < 0:
            continue
        label, residual = f"record {block.record}, {block.name}", after * block.sigma
        data = problem.responses[block.record].measurement
        lines += _find_spikes(label, np.asarray(data.times)[data.compared], block.measured, residual)
        computed = block.measured + before * block.sigma
        wrong = _check_scale(label, block.name, block.measured, computed) if block.gain < 0 else ""
        lines += [wrong] if wrong else []
        score = _r_squared(block.measured, block.measured + residual)
        if score < MAX_SCORE and not wrong and not data.filters.get(block.name):
            unexplained.add(block.name)
        if score < 0.5:
            lines.append(
                f"{label}: the arm explains only {max(score, 0.0):.0%} of it; the model or the record is incomplete"
            )
    return (*lines, *(line for name in sorted(unexplained) for line in _check_filter(problem, x, name)))


def _find_spikes(label: str, times: Array, measured: Array, residual: Array) -> list[str]:
    """Return a line about samples (m,) whose residual is far from the residual of their neighbours, if any."""
    jumps = np.abs(residual[1:-1] - 0.5 * (residual[2:] + residual[:-2]))
    limit = SPIKE_FACTOR * max(1.4826 * float(np.median(jumps)), 1e-9 * np.ptp(measured))
    padded = np.pad(jumps, 1)
    found = np.flatnonzero((jumps > limit) & (jumps >= padded[:-2]) & (jumps >= padded[2:])) + 1
    if not len(found) or len(found) > 0.02 * len(residual):
        return []
    time = times[found[0]]
    return [f"{label}: single samples have large residuals, the first at {time:g} s; is the record damaged?"]


def _check_scale(label: str, name: str, measured: Array, computed: Array) -> str:
    """Return a line about an output whose unit or sign contradicts the initial arm, "" for none."""
    a, b = computed - computed.mean(), measured - measured.mean()
    sizes = np.linalg.norm(a), np.linalg.norm(b)
    if min(sizes) == 0.0:
        return ""
    correlation, ratio = float(a @ b) / (sizes[0] * sizes[1]), float(sizes[1] / sizes[0])
    if correlation < -MIN_CORRELATION:
        return f"{label}: it moves opposite to the arm; is a sign wrong?"
    if correlation < MIN_CORRELATION or 1.0 / MAX_SCALE < ratio < MAX_SCALE:
        return ""
    unit = output_unit(name)
    near = [other for factor, other in UNIT_SCALES.get(unit, {}).items() if 0.5 < ratio / factor < 2.0]
    guess = f" in {near[0]}" if near else " or an input in another unit"
    return f"{label}: it is {ratio:.3g} times the computed value in {unit}; is it{guess}?"


def _check_filter(problem: LeastSquaresProblem, x: Array, name: str) -> list[str]:
    """Return a line about a low-pass filter that the record lacks, if it explains most of the residual of an output."""
    filtered = LeastSquaresProblem(problem.free, problem.ringing, problem.responses, problem.choice, corner=name)
    start = filtered.start.copy()
    index = len(problem.free.numbers) + filtered.nuisances.index(f"corner of {name}")
    data = filtered.responses[0].measurement
    start[index] = np.log(2.0 * np.pi / data.period * np.sqrt(0.5 / len(data.times)))  # mid-range
    found = filtered.solve(start)
    sums = [_squared_residuals(each, y, name) for each, y in ((problem, x), (filtered, found))]
    corner = float(np.exp(found[index]) / (2.0 * np.pi))
    if sums[1] > FILTER_RESIDUAL * sums[0] or corner > 0.4 / data.period:
        return []
    return [f"{name}: a low-pass of about {corner:.2g} Hz, which the record does not specify, explains it better; "
            f"was the signal filtered?"]  # fmt: skip


def _squared_residuals(problem: LeastSquaresProblem, x: Array, name: str) -> float:
    """Return the sum of squared residuals of an output over all records."""
    pairs = zip(problem.blocks, problem.split(problem.evaluate(x)[0]), strict=True)
    return float(sum(np.sum((rows * block.sigma) ** 2) for block, rows in pairs if block.name == name))


REPORT = """# Arm fitted to measurements

{explanation}

| parameter | value | standard deviation |
| --- | --- | --- |
{numbers}

{compared}
{warnings}
![Measured and computed](fit.png)

The arm is stored in `arm.yaml`.
"""


def _write_report(found: "Fit", folder: Path) -> None:
    """Write fit.md, fit.png and arm.yaml of a Fit to a folder; the plot needs Matplotlib."""
    folder.mkdir(parents=True, exist_ok=True)
    found.save(folder / "arm.yaml")
    _draw(found, folder / "fit.png")
    lines = [
        f"| {name} | {', '.join(f'{each:.5g}' for each in np.ravel(found.values[name]))} "
        f"| {', '.join(f'{each:.2g}' for each in np.ravel(found.deviations[name]))} |"
        for name in found.values
    ]
    lines += [f"| gain of {name} | {gain:.5g} | {deviation:.2g} |" for name, (gain, deviation) in found.gains.items()]
    compared = [f"- {name}: R2 {score:.4f}" for name, score in found.scores.items()]
    compared += [f"- measured {row[0]:.5g}, computed {row[1]:.5g} ({row[2]:.2g})" for row in found.frequencies]
    warnings = [f"- **{line}**" for line in found.warnings]
    text = REPORT.format(
        explanation=found.explanation, numbers="\n".join(lines), compared="\n".join(compared) + "\n",
        warnings="\n".join(warnings) + "\n" * bool(warnings),
    )  # fmt: skip
    write_file(folder / "fit.md", text)


def _draw(found: "Fit", file: Path) -> None:
    """Plot each output of each record, measured and computed, to a file."""
    panels = [(i, record, name) for i, record in enumerate(found.records) for name in record.outputs]
    computed = [found.predicted(record) for record in found.records]
    figure = new_figure((9.0, 2.4 * max(1, len(panels))), 100.0, layout="constrained")
    grid = figure.subplots(max(1, len(panels)), 1, squeeze=False)[:, 0]
    for axes, (i, record, name) in zip(grid, panels, strict=False):
        axes.plot(record.times, record.outputs[name], color=MIDDLE, linewidth=2.0, label="measured")
        axes.plot(record.times, computed[i][name], color=BLUE, linewidth=1.0, label="computed")
        axes.set(title=f"record {i}, {name}", xlabel="time (s)")
        axes.legend(frameon=False)
    if not panels:
        grid[0].errorbar(*found.frequencies.T[:2], xerr=found.frequencies[:, 2], fmt="o", color=BLUE)
        grid[0].set(xlabel="measured (Hz, or damping ratio)", ylabel="computed")
    save_figure(figure, file)


MIN_SCORE = 0.9  # dimensionless; R2 below which a fit is poor and repeated from random initial values
MAX_DEVIATIONS = 3.0  # standard deviations of a frequency residual beyond which a fit is poor
SPREAD = 1.0  # dimensionless; largest change of the logarithm of a parameter in random initial values
SOLVED_STARTS = 3  # number of random initial values from which the problem is solved: those with the smallest misfit
WEAK_PRIOR = 1e-8  # dimensionless; relative weight of a prior that keeps the covariance finite


@dataclass(frozen=True, eq=False)
class Fit:
    """Arm fitted to measurements, with the uncertainty of its parameters.

    Attributes:
        arm: the arm with the fitted parameters.
        values: fitted values by the names passed to `fit`; a number, or (n,) with one value per joint or link. Units
            are those of `physical_parameters.PARAMETERS`; link_stiffness_factor is a factor on the moduli of the
            initial arm.
        deviations: standard deviations of the values by the names passed to `fit`; 0 for fixed values. The standard
            deviations take the autocorrelation of the residuals into account.
        undetermined: parameters that are not practically identifiable from the data, such as "joint_stiffness[1]".
        explanation: sentence about these parameters and about parameters that the data cannot separate.
        warnings: likely errors in the data: wrong units or signs, missing filters, damaged samples.
        gains: name of each output with an unknown gain -> estimated gain and its standard deviation.
        scores: coefficient of determination R2 of each output, by a name such as "record 0, motor_angle_1".
        frequencies: rows (k, 3) of measured value, computed value and standard deviation of the frequencies (Hz) and
            damping ratios (1).
        correlation: correlation matrix (p, p) of the free parameters, in their order.
        choice: arguments `elements` and `modes` of `build_model`.
        records: the fitted records.
        step: time step of the simulation, s; None for the sampling interval.

    Examples:
        >>> arm = fm.catalog.one_joint()
        >>> found = fm.fit(arm, "joint_stiffness", frequencies=[1.3, 11.2], elements=1)
        >>> found.arm.joints[0].stiffness < arm.joints[0].stiffness
        True
        >>> found.undetermined
        ()
    """

    arm: Arm
    values: dict[str, Any]
    deviations: dict[str, Any]
    undetermined: tuple[str, ...]
    explanation: str
    warnings: tuple[str, ...]
    gains: dict[str, tuple[float, float]]
    scores: dict[str, float]
    frequencies: Array
    correlation: Array
    choice: dict[str, Any] = field(repr=False)
    records: tuple[Measurement, ...] = field(repr=False)
    step: float | None = field(repr=False)

    def __repr__(self) -> str:
        def row(values: Any) -> str:
            return " ".join(f"{each:.4g}" for each in np.atleast_1d(values))

        numbers = (f"  {name}: {row(self.values[name])} +- {row(self.deviations[name])}" for name in self.values)
        return "\n".join(["<Fit", *numbers, *(f"  {each}" for each in (self.explanation, *self.warnings))]) + ">"

    def predicted(self, record: Measurement) -> dict[str, Array]:
        """Return the outputs (T,) of a record, by name, predicted by the fitted arm and its sensors.

        Sensor offsets are estimated as the mean residuals of this record.
        """
        model = build_model(self.arm, **self.choice)
        nominal = {"payload_mass": nominal_parameters(model)["payload_mass"][None]}
        signals = SimulatedResponse(self.arm, record, self.step).signals(model, nominal)[0]
        result = {}
        for name, values in zip(record.outputs, signals, strict=True):
            shown = values * self.gains.get(name, (1.0, 0.0))[0]
            residual = (np.asarray(record.outputs[name]) - shown)[record.compared]
            result[name] = shown + (residual.mean() if name in record.offsets else 0.0)
        return result

    def score(self, record: Measurement) -> dict[str, float]:
        """Return the coefficient of determination R2 of each output of any record, by name."""
        outputs, samples = self.predicted(record), record.compared
        return {
            name: _r_squared(np.asarray(record.outputs[name])[samples], each[samples]) for name, each in outputs.items()
        }

    def save(self, path: str | Path) -> None:
        """Write the arm to a .json, .yaml or .yml file under the key `arm`, as in a configuration of an environment."""
        write_data(Path(path), {"arm": to_plain(self.arm)})

    def report(self, folder: str | Path) -> None:
        """Write fit.md, fit.png and arm.yaml to a folder; the plot needs Matplotlib."""
        _write_report(self, Path(folder))


def fit(
    arm: Arm,
    free: str | Sequence[str],
    frequencies: Any = None,
    damping: Any = None,
    records: Sequence[Measurement | Episode] = (),
    *,
    elements: int | tuple[int, ...] = 2,
    modes: int | tuple[int | tuple[int, ...], ...] | None = None,
    step: float | None = None,
    starts: int = 12,
    check: bool = True,
) -> Fit:
    """Estimate physical parameters of an arm from measured frequencies, damping ratios and time records.

    The sum of squared residuals, each relative to its standard deviation, is minimised by Gauss-Newton steps in a trust
    region. The Jacobian of frequencies and damping ratios is exact; the Jacobian of time records is computed by forward
    differences. A poor fit is repeated from random initial values. The time step of the simulation is halved until the
    estimates no longer change.

    Args:
        arm: initial arm.
        free: names of free parameters from `physical_parameters.PARAMETERS`; "joint_stiffness[1]" is the stiffness of
            the joint with index 1, counted from 0.
        frequencies: the k lowest frequencies (k,) at zero joint angles with locked motors, Hz, with a relative standard
            deviation of 0.5 %. For other postures, free motors or given standard deviations: a `Ringing` (natural
            frequencies and damping ratios with given deviations), a mapping of its arguments, or a list of these.
        damping: damping ratios (k,) of the modes with these frequencies, with a relative standard deviation of 10 %.
        records: time records; an Episode, such as a log of `flexman drive`, is read by `Measurement.from_episode`.
        elements: numbers of finite elements, see `build_model`.
        modes: numbers of component modes, see `build_model`.
        step: initial time step of the simulation, s; None for the sampling interval.
        starts: number of random initial values for a poor fit, drawn within a factor e of the values of the arm; the
            problem is solved from the best three only.
        check: True checks the records for wrong units or signs, missing filters and damaged samples. This takes a
            further fit for each poorly explained output without a filter.

    Returns:
        The fitted arm, with its uncertainty.

    Raises:
        ValueError: for an invalid argument, and for fewer data than free parameters.

    Examples:
        >>> arm = fm.catalog.one_joint()
        >>> measured = 0.9 * fm.frequencies(fm.build_model(arm, 1), lock_joints=True)[:2]
        >>> found = fm.fit(arm, ["joint_stiffness", "link_stiffness_factor"], measured, elements=1)
        >>> round(float(found.values["link_stiffness_factor"][0]), 2)
        0.81
    """
    parameters = FreeParameters(instance("arm", arm, Arm, "an Arm"), free)
    ringing = _parse_ringings(frequencies, damping)
    whole_number("starts", starts, 0, 10**4)
    read = [Measurement.from_episode(each) if isinstance(each, Episode) else each for each in records]
    measured = tuple(instance(f"records[{i}]", each, Measurement, "a Measurement") for i, each in enumerate(read))
    step = None if step is None else positive("step", step, "s")
    choice = {"elements": elements, "modes": modes}
    responses = [SimulatedResponse(parameters.arm, each, step) for each in measured]
    problem = LeastSquaresProblem(parameters, ringing, responses, choice)
    if (count := sum(len(part.measured) for part in problem.blocks)) < len(parameters.numbers):
        allowed = f"at least as many as free parameters, {len(parameters.numbers)}"
        raise value_error("frequencies, damping and records", f"{count} numbers", allowed)
    x = problem.refine(_solve_from_starts(problem, starts, np.random.default_rng(0)))
    arguments = measured, choice, min((each.step for each in responses), default=None)
    return _make_fit(problem, x, _data_warnings(problem, x) if check else (), arguments)


def _solve_from_starts(problem: LeastSquaresProblem, starts: int, rng: np.random.Generator) -> Array:
    """Return the parameter vector of the best fit; a poor fit is repeated from random initial values.

    `starts` values are drawn; the problem is solved from the SOLVED_STARTS best of them only.
    """
    x = problem.solve(problem.start)
    if not _is_poor(problem, x) or not starts:
        return x
    vectors = [problem.start.copy() for _ in range(starts)]
    for vector in vectors:
        vector[: len(problem.free.numbers)] += rng.uniform(-SPREAD, SPREAD, len(problem.free.numbers))
    vectors.sort(key=lambda vector: _misfit(problem, vector))
    found = [x, *(problem.solve(vector) for vector in vectors[:SOLVED_STARTS])]
    return min(found, key=lambda vector: _misfit(problem, vector))


def _misfit(problem: LeastSquaresProblem, x: Array) -> float:
    """Return the sum over all outputs of the mean squared residual relative to the variance of the measured values.

    For frequencies and damping ratios the residuals are relative to their given standard deviations.
    """
    total = 0.0
    for block, rows in zip(problem.blocks, problem.split(problem.evaluate(x)[0]), strict=True):
        residual = rows if block.record < 0 else rows * block.sigma / max(float(np.std(block.measured)), 1e-300)
        total += float(np.mean(residual**2))
    return total


def _is_poor(problem: LeastSquaresProblem, x: Array) -> bool:
    """Return True if R2 of an output is low, or a frequency or damping ratio far from its measured value."""
    for block, rows in zip(problem.blocks, problem.split(problem.evaluate(x)[0]), strict=True):
        if block.record < 0:
            if np.abs(rows).max() > MAX_DEVIATIONS:
                return True
        elif _r_squared(block.measured, block.measured + rows * block.sigma) < MIN_SCORE:
            return True
    return False


def _make_fit(problem: LeastSquaresProblem, x: Array, warnings: tuple[str, ...], arguments: tuple[Any, ...]) -> Fit:
    """Return the Fit of a parameter vector."""
    residuals, free = problem.evaluate(x)[0], problem.free
    covariance, p = parameter_covariance(problem, x), len(free.numbers)
    values, deviations = problem.values(x), np.sqrt(np.diag(covariance))
    estimates, standard_deviations = free.parameters(values), free.parameters(values * deviations[:p], rest=0.0)
    names, sentence = _find_unidentifiable(free, values, covariance[:p, :p])
    gains = {
        name.removeprefix("gain of "): (float(x[p + i]), float(deviations[p + i]))
        for i, name in enumerate(problem.nuisances) if name.startswith("gain")
    }  # fmt: skip
    scores, rows = {}, [np.zeros((0, 3))]
    for block, residual in zip(problem.blocks, problem.split(residuals), strict=True):
        computed = block.measured + residual * block.sigma
        if block.record < 0:
            rows.append(np.column_stack([block.measured, computed, block.sigma]))
        else:
            scores[f"record {block.record}, {block.name}"] = _r_squared(block.measured, computed)
    deviation = np.sqrt(np.diag(covariance[:p, :p]))
    return Fit(
        free.build_arm(values), _by_name(free, estimates), _by_name(free, standard_deviations), names, sentence,
        warnings, gains, scores,
        np.vstack(rows), covariance[:p, :p] / np.outer(deviation, deviation), arguments[1], arguments[0], arguments[2],
    )  # fmt: skip


def _by_name(free: FreeParameters, parameters: Mapping[str, Array]) -> dict[str, Any]:
    """Return values by the names passed to `fit`."""
    result: dict[str, Any] = {}
    for name, numbers in free.by_name.items():
        kind, scalar = numbers[0].name, "[" in name or PARAMETERS[numbers[0].name].of == ARM
        values = np.ravel(parameters[kind])
        result[name] = float(values[numbers[0].part or 0]) if scalar else values
    return result


def parameter_covariance(problem: LeastSquaresProblem, x: Array) -> Array:
    """Return the covariance (u, u) of the parameter vector, a sandwich estimate for autocorrelated residuals."""
    residuals, jacobian = problem.evaluate(x)
    prior = WEAK_PRIOR * np.eye(len(x)) * np.maximum((jacobian**2).sum(axis=0).max(), 1.0) * 1e-4
    inverse = np.linalg.inv(jacobian.T @ jacobian + prior)
    used = len(x) / len(residuals)  # fraction of the degrees of freedom used by the fit
    middle = np.zeros_like(inverse)
    for block, rows, slopes in zip(problem.blocks, problem.split(residuals), problem.split(jacobian), strict=True):
        variance = float(np.mean(rows**2)) / max(1.0 - used, 0.1)
        noise = 1.0 if block.record < 0 else variance * _autocorrelation_time(rows)
        middle += noise * slopes.T @ slopes
    return np.asarray(inverse @ (middle + prior) @ inverse)


def _autocorrelation_time(rows: Array) -> float:
    """Return the integrated autocorrelation time of residuals, in samples: 1 for white noise, more for coloured noise.

    It is the sum of the autocorrelation over positive and negative lags, up to the first insignificant lag.
    """
    centred = rows - rows.mean()
    size, power = len(centred), float(centred @ centred)
    if power <= 0.0:
        return 1.0
    spectrum = np.abs(np.fft.rfft(centred, 2 * size)) ** 2
    autocorrelation = np.fft.irfft(spectrum)[:size] / power
    ends = np.flatnonzero(autocorrelation < 2.0 / np.sqrt(size))  # lags without significant correlation
    return float(1.0 + 2.0 * autocorrelation[1 : ends[0] if len(ends) else size].sum())


def _r_squared(measured: Array, computed: Array) -> float:
    """Return R2: 1 minus the mean squared residual relative to the variance of the measured values."""
    spread = float(np.sum((measured - measured.mean()) ** 2))
    return 1.0 - float(np.sum((measured - computed) ** 2)) / max(spread, 1e-300)


def _parse_ringings(frequencies: Any, damping: Any) -> list[Ringing]:
    """Return the arguments `frequencies` and `damping` of `fit` as a list of Ringing."""
    if frequencies is None:
        if damping is not None:
            raise value_error("damping", damping, "the frequencies of the same modes, too")
        return []
    several = isinstance(frequencies, list | tuple) and frequencies and isinstance(frequencies[0], Mapping | Ringing)
    result = []
    for each in frequencies if several else [frequencies]:
        if isinstance(each, Ringing):
            result.append(each)
        elif isinstance(each, Mapping):
            result.append(Ringing(**mapping("frequencies", dict(each), KEYS)))
        else:
            result.append(Ringing(each, damping))
    if damping is not None and (several or isinstance(frequencies, Mapping | Ringing)):
        raise value_error("damping", damping, "damping as an entry of the mapping with the frequencies")
    return result

"""Fit of an arm to measurements: estimates, covariance, undetermined parameters, warnings about the data, and a
report.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from flexman_gym.common import files as scene_file
from flexman_gym.common.arrays import Array
from flexman_gym.common.checks import instance, mapping, positive, value_error, whole_number
from flexman_gym.identification.least_squares import FreeParameters, LeastSquaresProblem, ResidualBlock
from flexman_gym.identification.measurement import Measurement, SimulatedResponse, output_unit
from flexman_gym.identification.ringing import KEYS, Ringing
from flexman_gym.model.model import build_model
from flexman_gym.scene.arm import Arm
from flexman_gym.scene.serialization import to_plain
from flexman_gym.simulation.parameters import ARM, PARAMETERS, nominal_parameters

LIMIT, INVOLVED = 0.5, 0.3  # of a number: a deviation that tells nothing; of a direction: a part that counts
LOUD, ALIKE, CLEAN = 10.0, 0.7, 0.995  # usual errors; least correlation of a scale; R2 at which no filter is looked for
SCALES = {"rad": {57.29578: "deg", 1e3: "mrad"}, "m": {1e3: "mm", 1e2: "cm"}, "m/s^2": {1.0 / 9.80665: "g"},
          "1": {1e6: "um/m", 1e2: "percent"}}  # fmt: skip
SCALE = 4.0  # times, from which on a scale is odd
FILTERED = 0.5  # of the squared residuals, that a filter leaves which is missing


def _find_undetermined(free: FreeParameters, values: Array, covariance: Array) -> tuple[tuple[str, ...], str]:
    """Gives the numbers that the data cannot tell, and one sentence about them.

    A number cannot be told where its standard deviation is more than half of it, and of what the fit started from.

    Args:
        free: what is free.
        values: (p,).
        covariance: (p, p) of their logarithms.
    """
    scale = values / np.maximum(values, free.start)
    sizes, directions = np.linalg.eigh(covariance * np.outer(scale, scale))
    wide = np.sqrt(np.diag(covariance)) * scale > LIMIT
    names = tuple(str(number) for number, each in zip(free.numbers, wide, strict=True) if each)
    said, alone = [], set(names)
    for size, direction in sorted(zip(sizes, directions.T, strict=True), key=lambda pair: -pair[0]):
        together = [str(free.numbers[i]) for i in np.flatnonzero(wide & (np.abs(direction) > INVOLVED))]
        if np.sqrt(max(size, 0.0)) > LIMIT and len(together) > 1 and alone & set(together):
            said.append(f"{' and '.join(together)} apart")
            alone -= set(together)
    said = [*(name for name in names if name in alone), *said]
    return names, f"The data cannot tell {', nor '.join(said)}." if said else "The data tell every free number."


def _data_warnings(problem: LeastSquaresProblem, x: Array) -> tuple[str, ...]:
    """Gives a line for each thing that looks wrong with the records."""
    said = []
    first = problem.divided(problem.evaluated(problem.start)[0])
    last = problem.divided(problem.evaluated(x)[0])
    muddy = set()
    for part, before, after in zip(problem.parts, first, last, strict=True):
        if part.record < 0:
            continue
        where, left = f"record {part.record}, {part.name}", after * part.sigma
        said += _spikes(where, problem, part, left)
        odd = _scale(where, part, part.measured + before * part.sigma) if part.gain < 0 else ""
        said += [odd] if odd else []
        score = 1.0 - np.mean(left**2) / max(float(np.var(part.measured)), 1e-300)
        if score < CLEAN and not odd and not problem.responses[part.record].measurement.filters.get(part.name):
            muddy.add(part.name)
        if score < 0.5:
            said.append(
                f"{where}: the arm explains {max(score, 0.0):.0%} of it; the model or the record lacks something"
            )
    return (*said, *(line for name in sorted(muddy) for line in _filter(problem, x, name)))


def _spikes(where: str, problem: LeastSquaresProblem, part: ResidualBlock, left: Array) -> list[str]:
    """Samples far beyond their neighbours."""
    jumps = np.abs(left[1:-1] - 0.5 * (left[2:] + left[:-2]))
    loud, beside = LOUD * max(1.4826 * float(np.median(jumps)), 1e-9 * np.ptp(part.measured)), np.pad(jumps, 1)
    found = np.flatnonzero((jumps > loud) & (jumps >= beside[:-2]) & (jumps >= beside[2:])) + 1
    if not len(found) or len(found) > 0.02 * len(left):
        return []
    data = problem.responses[part.record].measurement
    time = np.asarray(data.times)[data.compared][found[0]]
    return [f"{where}: single samples stand out of what is left, the first at {time:g} s; is the record damaged?"]


def _scale(where: str, part: ResidualBlock, shown: Array) -> str:
    """A unit or a sign that looks wrong beside the arm as it was given."""
    a, b = shown - shown.mean(), part.measured - part.measured.mean()
    sizes = np.linalg.norm(a), np.linalg.norm(b)
    if min(sizes) == 0.0:
        return ""
    alike, ratio = float(a @ b) / (sizes[0] * sizes[1]), float(sizes[1] / sizes[0])
    if alike < -ALIKE:
        return f"{where}: it moves against the arm; is a sign wrong?"
    if alike < ALIKE or 1.0 / SCALE < ratio < SCALE:
        return ""
    unit = output_unit(part.name)
    near = [name for factor, name in SCALES.get(unit, {}).items() if 0.5 < ratio / factor < 2.0]
    other = f" in {near[0]}" if near else " or an input in another unit"
    return f"{where}: it is {ratio:.3g} times what the arm shows in {unit}; is it{other}?"


def _filter(problem: LeastSquaresProblem, x: Array, name: str) -> list[str]:
    """A low-pass that the record does not name, where one explains most of what is left."""
    other = LeastSquaresProblem(problem.free, problem.ringing, problem.responses, problem.choice, corner=name)
    start = other.start.copy()
    at = len(problem.free.numbers) + other.nuisances.index(f"corner of {name}")
    data = other.responses[0].measurement
    start[at] = np.log(2.0 * np.pi / data.period * np.sqrt(0.5 / len(data.times)))  # between slowest and fastest
    found = other.solved(start)
    left = [_left(each, y, name) for each, y in ((problem, x), (other, found))]
    corner = float(np.exp(found[at]) / (2.0 * np.pi))
    if left[1] > FILTERED * left[0] or corner > 0.4 / data.period:
        return []
    return [f"{name}: a low-pass of about {corner:.2g} Hz, which the record does not name, explains it better; "
            f"did the signal pass one?"]  # fmt: skip


def _left(problem: LeastSquaresProblem, x: Array, name: str) -> float:
    """Squared residuals of an output in all records."""
    parts = zip(problem.parts, problem.divided(problem.evaluated(x)[0]), strict=True)
    return float(sum(np.sum((rows * part.sigma) ** 2) for part, rows in parts if part.name == name))


PAGE = """# An arm fitted to measurements

{explanation}

| number | value | deviation |
| --- | --- | --- |
{numbers}

{compared}
{warnings}
![measured and computed](fit.png)

The arm is in `arm.yaml`.
"""
MEASURED, COMPUTED = "#8a8f98", "#0072B2"


def _write_report(found: "Fit", folder: Path) -> None:
    """Writes fit.md, fit.png and arm.yaml of a Fit into a folder.

    Raises:
        ImportError: without Matplotlib.
    """
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
    text = PAGE.format(
        explanation=found.explanation, numbers="\n".join(lines), compared="\n".join(compared) + "\n",
        warnings="\n".join(warnings) + "\n" * bool(warnings),
    )  # fmt: skip
    (folder / "fit.md").write_text(text, encoding="utf-8")


def _draw(found: "Fit", file: Path) -> None:
    """Each output of each record, measured and computed."""
    try:
        from matplotlib.backends.backend_agg import FigureCanvasAgg
        from matplotlib.figure import Figure
    except ImportError as error:
        raise ImportError("pictures need Matplotlib: pip install 'flexman_gym[render]'") from error
    panels = [(i, record, name) for i, record in enumerate(found.records) for name in record.outputs]
    shown = [found.predicted(record) for record in found.records]
    figure = Figure(figsize=(9.0, 2.4 * max(1, len(panels))), dpi=100, layout="constrained")
    FigureCanvasAgg(figure)
    grid = figure.subplots(max(1, len(panels)), 1, squeeze=False)[:, 0]
    for axes, (i, record, name) in zip(grid, panels, strict=False):
        axes.plot(record.times, record.outputs[name], color=MEASURED, linewidth=2.0, label="measured")
        axes.plot(record.times, shown[i][name], color=COMPUTED, linewidth=1.0, label="computed")
        axes.set(title=f"record {i}, {name}", xlabel="time (s)")
        axes.legend(frameon=False)
    if not panels:
        grid[0].errorbar(*found.frequencies.T[:2], xerr=found.frequencies[:, 2], fmt="o", color=COMPUTED)
        grid[0].set(xlabel="measured (Hz, or damping ratio)", ylabel="computed")
    figure.savefig(file)


POOR, FAR = 0.9, 3.0  # R2 below which, and deviations of a frequency beyond which, other starts are tried
SPREAD, FEW = 1.0, 3  # of the logarithms of other starts, and how many of the best are followed
WEAK = 1e-8  # of a prior that nobody feels, in place of an infinite deviation


@dataclass(frozen=True, eq=False)
class Fit:
    """An arm that was fitted to measurements.

    Attributes:
        arm: with the fitted numbers.
        values: name as it was given to `fit` -> a number, or (n,) one for each joint or link; in the units of
            `simulation.parameters.PARAMETERS`, link_stiffness_factor as a factor on the moduli of the arm that was
            given.
        deviations: name -> their standard deviations, 0 of what was not free. Residuals that are not white count as so
            many fewer samples.
        undetermined: the numbers that the data cannot tell, such as "joint_stiffness[1]".
        explanation: one sentence that says which these are, and which cannot be told apart.
        warnings: what looks wrong with the data: a unit, a sign, a filter, single samples.
        gains: name of an output with an unknown gain -> gain and standard deviation.
        scores: "record 0, motor_angle_1" -> R2 of an output, the part of its variance that the arm explains.
        frequencies: what was measured of ringing, computed, and the standard deviation, (k, 3) rows.
        correlation: (p, p) of the free numbers in their order.
        choice: elements and modes of the model.
        records: that were fitted.
        step: s, of the simulation; None for the interval between samples.

    Examples:
        >>> arm = fm.catalog.one_joint()
        >>> found = fm.fit(arm, "joint_stiffness", frequencies=[1.3, 11.2], elements=1)
        >>> found.arm.joints[0].stiffness < arm.joints[0].stiffness
        True
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
        """Gives the outputs (T,) of a measurement, by name, as the fitted arm and its sensors show them.

        Offsets are those of the record itself: the mean of what is left.
        """
        model = build_model(self.arm, **self.choice)
        nominal = {"payload_mass": nominal_parameters(model)["payload_mass"][None]}
        signals = SimulatedResponse(self.arm, record, self.step).signals(model, nominal)[0]
        result = {}
        for name, values in zip(record.outputs, signals, strict=True):
            shown = values * self.gains.get(name, (1.0, 0.0))[0]
            left = (np.asarray(record.outputs[name]) - shown)[record.compared]
            result[name] = shown + (left.mean() if name in record.offsets else 0.0)
        return result

    def score(self, record: Measurement) -> dict[str, float]:
        """Gives R2 of each output of a measurement, which need not be one of those that were fitted."""
        shown, kept = self.predicted(record), record.compared
        return {name: _r_squared(np.asarray(record.outputs[name])[kept], each[kept]) for name, each in shown.items()}

    def save(self, path: str | Path) -> None:
        """Writes the arm to a .json, .yaml or .yml file, with the key arm, as a description of an environment has it.

        Raises:
            ValueError: for another suffix.
        """
        scene_file.write_data(Path(path), {"arm": to_plain(self.arm)})

    def report(self, folder: str | Path) -> None:
        """Writes fit.md, fit.png and arm.yaml into a folder; the picture needs Matplotlib."""
        _write_report(self, Path(folder))


def fit(
    arm: Arm,
    free: str | Sequence[str],
    frequencies: Any = None,
    damping: Any = None,
    records: Sequence[Measurement] = (),
    *,
    elements: int | tuple[int, ...] = 2,
    modes: int | tuple[int | tuple[int, ...], ...] | None = None,
    step: float | None = None,
    starts: int = 12,
    check: bool = True,
) -> Fit:
    """Fits physical parameters of an arm to what was measured of it.

    Least squares over the residuals in standard deviations, by Gauss-Newton steps in a region of trust. Slopes of
    frequencies are exact; those of time records are central differences of arms that move side by side. A fit that
    remains poor is started anew from other places. Steps of the simulation are halved until they matter no more.

    Args:
        arm: where the fit starts.
        free: names in `simulation.parameters.PARAMETERS`; "joint_stiffness[1]" is that of one joint, counted from 0.
        frequencies: (k,) Hz, the lowest ones at zero angles with held motors, to 0.5 %; or a mapping of the arguments
            of `Ringing`, which says other postures, motors and deviations; or several mappings.
        damping: (k,) damping ratios of these frequencies, to 10 %.
        records: of Measurement.
        elements: of the model, see `build_model`.
        modes: of the model, see `build_model`.
        step: s, of the simulation, to begin with; None takes the interval between samples.
        starts: other places that are tried where the fit is poor, within a factor of e.
        check: check units, signs, filters and single samples of the records; takes a further fit with a filter for
            each output that is not explained well and passed none.

    Raises:
        ValueError: one line with field, value and what is allowed; where there are fewer data than free numbers.
    """
    parameters = FreeParameters(instance("arm", arm, Arm, "an Arm"), free)
    ringing = _parse_ringings(frequencies, damping)
    whole_number("starts", starts, 0, 10**4)
    records = tuple(instance(f"records[{i}]", each, Measurement, "a Measurement") for i, each in enumerate(records))
    step = None if step is None else positive("step", step, "s")
    choice = {"elements": elements, "modes": modes}
    responses = [SimulatedResponse(parameters.arm, each, step) for each in records]
    problem = LeastSquaresProblem(parameters, ringing, responses, choice)
    if (count := sum(len(part.measured) for part in problem.parts)) < len(parameters.numbers):
        allowed = f"at least as many as free numbers, {len(parameters.numbers)}"
        raise value_error("frequencies, damping and records", f"{count} numbers", allowed)
    x = problem.refined(_best(problem, starts, np.random.default_rng(0)))
    given = records, choice, min((each.step for each in responses), default=None)
    return _concluded(problem, x, _data_warnings(problem, x) if check else (), given)


def _best(problem: LeastSquaresProblem, starts: int, rng: np.random.Generator) -> Array:
    """The unknowns of the best fit, from the start of the problem, and from others where that is poor."""
    x = problem.solved(problem.start)
    if not _poor(problem, x) or not starts:
        return x
    places = [problem.start.copy() for _ in range(starts)]
    for place in places:
        place[: len(problem.free.numbers)] += rng.uniform(-SPREAD, SPREAD, len(problem.free.numbers))
    places.sort(key=lambda place: _misfit(problem, place))
    found = [x, *(problem.solved(place) for place in places[:FEW])]
    return min(found, key=lambda place: _misfit(problem, place))


def _misfit(problem: LeastSquaresProblem, x: Array) -> float:
    """What can be compared between weights: the parts of variances and squared deviations that are left, summed."""
    total = 0.0
    for part, rows in zip(problem.parts, problem.divided(problem.evaluated(x)[0]), strict=True):
        left = rows if part.record < 0 else rows * part.sigma / max(float(np.std(part.measured)), 1e-300)
        total += float(np.mean(left**2))
    return total


def _poor(problem: LeastSquaresProblem, x: Array) -> bool:
    for part, rows in zip(problem.parts, problem.divided(problem.evaluated(x)[0]), strict=True):
        if part.record < 0 and np.abs(rows).max() > FAR:
            return True
        if (
            part.record >= 0
            and 1.0 - np.mean((rows * part.sigma) ** 2) / max(float(np.var(part.measured)), 1e-300) < POOR
        ):
            return True
    return False


def _concluded(problem: LeastSquaresProblem, x: Array, said: tuple[str, ...], given: tuple[Any, ...]) -> Fit:
    """What follows from the unknowns."""
    residuals, free = problem.evaluated(x)[0], problem.free
    covariance, p = _covariance(problem, x), len(free.numbers)
    values, deviations = problem.values(x), np.sqrt(np.diag(covariance))
    own, spread = free.parameters(values), free.parameters(values * deviations[:p], rest=0.0)
    names, sentence = _find_undetermined(free, values, covariance[:p, :p])
    gains = {
        name.removeprefix("gain of "): (float(x[p + i]), float(deviations[p + i]))
        for i, name in enumerate(problem.nuisances) if name.startswith("gain")
    }  # fmt: skip
    scores, rows = {}, [np.zeros((0, 3))]
    for part, own_rows in zip(problem.parts, problem.divided(residuals), strict=True):
        shown = part.measured + own_rows * part.sigma
        if part.record < 0:
            rows.append(np.column_stack([part.measured, shown, part.sigma]))
        else:
            scores[f"record {part.record}, {part.name}"] = _r_squared(part.measured, shown)
    size = np.sqrt(np.diag(covariance[:p, :p]))
    return Fit(
        free.changed(values), _named(free, own), _named(free, spread), names, sentence, said, gains,
        scores,
        np.vstack(rows), covariance[:p, :p] / np.outer(size, size), given[1], given[0], given[2],
    )  # fmt: skip


def _named(free: FreeParameters, parameters: Mapping[str, Array]) -> dict[str, Any]:
    """Values by the names that were given."""
    result: dict[str, Any] = {}
    for name, numbers in free.asked.items():
        kind, one = numbers[0].parameter, "[" in name or PARAMETERS[numbers[0].parameter].of == ARM
        values = np.ravel(parameters[kind])
        result[name] = float(values[numbers[0].place or 0]) if one else values
    return result


def _covariance(problem: LeastSquaresProblem, x: Array) -> Array:
    """Covariance (u, u) of the unknowns: noise that is not white or differs between records counts as it is."""
    residuals, slopes = problem.evaluated(x)
    weak = WEAK * np.eye(len(x)) * np.maximum((slopes**2).sum(axis=0).max(), 1.0) * 1e-4
    inverse = np.linalg.inv(slopes.T @ slopes + weak)
    share = len(x) / len(residuals)
    middle = np.zeros_like(inverse)
    for part, rows, own in zip(problem.parts, problem.divided(residuals), problem.divided(slopes), strict=True):
        noise = 1.0 if part.record < 0 else float(np.mean(rows**2)) / max(1.0 - share, 0.1) * _memory(rows)
        middle += noise * own.T @ own
    return np.asarray(inverse @ (middle + weak) @ inverse)


def _memory(rows: Array) -> float:
    """Samples that count as one: 1 of white noise, more where neighbours are alike."""
    left = rows - rows.mean()
    size, power = len(left), float(left @ left)
    if power <= 0.0:
        return 1.0
    spectrum = np.abs(np.fft.rfft(left, 2 * size)) ** 2
    alike = np.fft.irfft(spectrum)[:size] / power
    ends = np.flatnonzero(alike < 2.0 / np.sqrt(size))
    return float(1.0 + 2.0 * alike[1 : ends[0] if len(ends) else size].sum())


def _r_squared(measured: Array, shown: Array) -> float:
    """1 less the part of the variance that is left."""
    spread = float(np.sum((measured - measured.mean()) ** 2))
    return 1.0 - float(np.sum((measured - shown) ** 2)) / max(spread, 1e-300)


def _parse_ringings(frequencies: Any, damping: Any) -> list[Ringing]:
    """Gives what the arguments `frequencies` and `damping` of a fit say.

    Raises:
        ValueError: for what is neither a list of numbers nor a mapping, or a list of these.
    """
    if frequencies is None:
        if damping is not None:
            raise value_error("damping", damping, "frequencies beside it, which say of what")
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
        raise value_error("damping", damping, "it as an entry of the mapping that has the frequencies")
    return result

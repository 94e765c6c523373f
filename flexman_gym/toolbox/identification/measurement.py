"""Measurements: time records, filters of their signals, and the simulated response of an arm to their inputs."""

import re
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, NamedTuple, Self

import numpy as np

from flexman_gym.common.arrays import Array, Vector
from flexman_gym.common.checks import (
    MAX_ENTRIES,
    instance,
    is_decimal_integer,
    number_array,
    one_of,
    positive,
    sequence,
    set_fields,
    text,
    vector,
)
from flexman_gym.common.errors import suggestion, value_error
from flexman_gym.common.time_series import TimeSeries
from flexman_gym.model.linearization import column_names
from flexman_gym.model.model import Model
from flexman_gym.scene.arm import Arm
from flexman_gym.scene.scene import Initial, ModelChoice, Scene
from flexman_gym.scene.signals import ConstantTorque, SampledAngles, SampledTorque
from flexman_gym.simulation.episode import Episode
from flexman_gym.simulation.scene_simulation import TIP_ACCELERATIONS, simulate_all, tip_accelerations

INTERVAL_TOLERANCE = 1e-3  # dimensionless; largest relative deviation of a sampling interval from the median
MIN_SAMPLES = 16  # least number of samples of a record
INPUT = re.compile(r"(torque|current)_[1-9][0-9]*")  # names of columns read as inputs by default
OUTPUT = re.compile(
    r"(tip|tip_velocity|tip_acceleration|specific_force|deflection)_[xyz]"
    r"|((joint|motor)_(angle|rate)|joint_twist|joint_twist_rate)_[1-9][0-9]*"
    r"|link_deflection(_rate)?_[1-9][0-9]*_[yz]|root_strain_[1-9][0-9]*_(y|z|torsion)"
)  # names of columns read as outputs by default
LOGGED = {"motor_angles", "joint_twists", "root_strains"}  # readings of an episode that become outputs
INPUTS = {"torque": "N m", "current": "A", "motor_angle": "rad"}  # kind of an input -> unit


@dataclass(frozen=True)
class Filter:
    """Linear filter of a measured signal, as a transfer function of the Laplace variable s, in rad/s.

    Attributes:
        numerator: coefficients, highest power of s first, such as (1.0,). Its degree does not exceed the degree of the
            denominator, so that the gain at high frequencies is finite.
        denominator: coefficients, highest power of s first, such as (0.1, 1.0) for 1 / (0.1 s + 1). All poles must have
            a negative real part.

    Raises:
        ValueError: for empty or infinite coefficients, and for an improper or unstable filter.

    Examples:
        >>> smooth = fm.Filter.low_pass(10.0)
        >>> smooth.denominator[1] == 2.0 * 3.141592653589793 * 10.0
        True
    """

    numerator: Vector
    denominator: Vector

    def __post_init__(self) -> None:
        for name in ("numerator", "denominator"):
            values = sequence(f"Filter.{name}", getattr(self, name), "numbers")
            allowed = "finite numbers, the first of the denominator not 0"
            array = number_array(f"Filter.{name}", values, (max(1, len(values)),), allowed)
            set_fields(self, **{name: tuple(array.tolist())})
        if self.denominator[0] == 0.0 or len(self.numerator) > len(self.denominator):
            raise value_error(
                "Filter.denominator", self.denominator, "a first number other than 0, and as many as above"
            )
        if len(self.denominator) > 1 and np.roots(self.denominator).real.max() >= 0.0:
            raise value_error("Filter.denominator", self.denominator, "poles with negative real part")

    @classmethod
    def low_pass(cls, frequency: float, damping_ratio: float | None = None) -> Self:
        """Return a low-pass filter with a cut-off frequency (Hz), of first order, or of second with a damping ratio."""
        corner = 2.0 * np.pi * positive("frequency", frequency, "Hz")
        if damping_ratio is None:
            return cls((corner,), (1.0, corner))
        return cls((corner**2,), (1.0, 2.0 * positive("damping_ratio", damping_ratio) * corner, corner**2))

    def applied(self, values: Array, period: float) -> Array:
        """Return signals (..., T) after the filter; samples are a period (s) apart, and linear in between."""
        from scipy.signal import cont2discrete, lfilter, lfilter_zi

        if len(self.denominator) == 1:
            return values * (self.numerator[0] / self.denominator[0])
        b, a, _ = cont2discrete((self.numerator, self.denominator), period, "foh")
        start = lfilter_zi(b.ravel(), a) * values[..., :1]
        return np.asarray(lfilter(b.ravel(), a, values, zi=start)[0])


class _InputChannel(NamedTuple):
    """Input of a record: its kind in INPUTS, and the index of its joint, from 0."""

    kind: str
    joint: int


@dataclass(frozen=True, eq=False)
class Measurement:
    """Measurement record: signals of a real arm at T equally spaced times.

    Attributes:
        times: times (T,), s.
        inputs: inputs (T,) by name: "torque_1" (N m), "current_1" (A, for a joint with a motor) or "motor_angle_1"
            (rad, for a motor with prescribed motion); joints count from 1. Motors without an input are free.
        outputs: outputs (T,) by name, with the names and units of `Trajectory.columns`, such as "motor_angle_1" (rad),
            "link_deflection_1_y" (m) or "root_strain_1_z", and "tip_acceleration_x" and "specific_force_x" (m/s^2).
        filters: name of an output -> Filter of its sensor, or several Filters in series.
        gains: names of outputs whose sensor has an unknown gain; it is estimated, one value per output for all records.
        offsets: names of outputs whose sensor has an unknown constant offset; it is estimated, one value per record.
        deviations: name of an output -> standard deviation of its noise, in its unit, or name of a prescribed motor
            angle -> standard deviation of its rounding, rad. The noise of an output without an entry is estimated.
        settling: time, s, at the start of the record whose samples are not compared, so that the response to an earlier
            motion can decay.
        start: initial motor angles (n,) at rest, rad. None for the first samples of the motor angles among the outputs,
            and 0 for all other motors. Give `start` if encoders are noisy, because its error does not decay.
        hold: interpolation of torques and currents between samples, "zero" (constant) or "linear".

    Raises:
        ValueError: for example for NaN in a damaged record and for a gap in its times, with a one-line message: field,
            value and allowed values.

    Examples:
        >>> times = [0.01 * i for i in range(100)]
        >>> record = fm.Measurement(times, {"torque_1": [0.1] * 100}, {"motor_angle_1": [0.0] * 100})
        >>> record.period
        0.01
    """

    times: Any
    inputs: Mapping[str, Any]
    outputs: Mapping[str, Any]
    filters: Mapping[str, Any] = field(default_factory=dict)
    gains: Sequence[str] = ()
    offsets: Sequence[str] = ()
    deviations: Mapping[str, float] = field(default_factory=dict)
    settling: float = 0.0
    start: Any = None
    hold: str = "zero"

    def __post_init__(self) -> None:
        name, count = "Measurement.times", len(sequence("Measurement.times", self.times, "times (s)"))
        allowed = f"{MIN_SAMPLES} to {MAX_ENTRIES} finite numbers (s), equally spaced"
        if not MIN_SAMPLES <= count <= MAX_ENTRIES:
            raise value_error(name, f"{count} times", allowed)
        times = number_array(name, self.times, (count,), allowed)
        steps = np.diff(times)
        gaps = np.flatnonzero(np.abs(steps - np.median(steps)) > INTERVAL_TOLERANCE * np.median(steps))
        if np.median(steps) <= 0.0 or len(gaps):
            i = int(gaps[0]) if len(gaps) else 0
            raise value_error(
                f"{name}[{i + 1}]", float(times[i + 1]), f"{allowed}: there is a gap after {times[i]:g} s"
            )
        set_fields(self, times=times, inputs=self._signals("inputs", count), outputs=self._signals("outputs", count))
        for each in self.inputs:
            self.channel(each)
        if not self.outputs:
            raise value_error("Measurement.outputs", {}, "at least one")
        for part in ("filters", "gains", "offsets"):
            for each in getattr(self, part):
                one_of(f"Measurement.{part}", each, self.outputs)
        for each, value in self.deviations.items():
            one_of("Measurement.deviations", each, [*self.outputs, *self.inputs])
            positive(f"Measurement.deviations[{each!r}]", value)
        listed: dict[str, tuple[Filter, ...]] = {}
        for each, some in self.filters.items():
            field_ = f"Measurement.filters[{each!r}]"
            several = (some,) if isinstance(some, Filter) else sequence(field_, some, "Filter")
            listed[each] = tuple(instance(field_, one, Filter, "a Filter, or several") for one in several)
        one_of("Measurement.hold", self.hold, ("zero", "linear"))
        set_fields(self, filters=listed)
        if not 0.0 <= self.settling < times[-1] - times[0]:
            raise value_error("Measurement.settling", self.settling, f"less than {times[-1] - times[0]:g} (s)")

    def _signals(self, part: str, count: int) -> dict[str, Array]:
        """Check the signals "inputs" or "outputs", and return them as arrays (count,) by name."""
        given = getattr(self, part)
        if not isinstance(given, Mapping):
            raise value_error(f"Measurement.{part}", given, "a mapping from names to numbers")
        allowed = f"{count} finite numbers, one for each time"
        for name in given:
            text(f"a name in Measurement.{part}", name)
        return {
            name: number_array(f"Measurement.{part}[{name!r}]", each, (count,), allowed) for name, each in given.items()
        }

    def channel(self, name: str) -> _InputChannel:
        """Return the kind and the joint of an input, given its name."""
        kind, _, number = name.rpartition("_")
        if kind not in INPUTS or not is_decimal_integer(number) or int(number) == 0:
            allowed = "torque_1, current_1 or motor_angle_1, with the number of the joint from 1"
            raise value_error("Measurement.inputs", name, allowed)
        return _InputChannel(kind, int(number) - 1)

    @classmethod
    def from_csv(
        cls,
        path: str | Path,
        inputs: Mapping[str, str] | None = None,
        outputs: Mapping[str, str] | None = None,
        **more: Any,
    ) -> Self:
        """Read a CSV file with units in its header, such as "time (s),hub (deg)"; see `read_time_series`.

        Args:
            path: path of the file.
            inputs: name of an input -> column; the unit of the column must fit the input. None selects the columns
                torque_1, current_1 and so on.
            outputs: name of an output -> column; the unit of the column must fit the output. None selects all unused
                columns with the name of an output; a UserWarning names the columns that are not read.
            **more: further arguments of the class, such as filters and gains.

        Returns:
            The record.

        Raises:
            FileNotFoundError: if the file does not exist.
        """
        record = TimeSeries.read(path)
        inputs, outputs = _select_columns(record, inputs, outputs)
        record = record.select([*inputs.values(), *outputs.values()]).in_equal_steps(linear=[*inputs.values()]).warn()
        signals: list[dict[str, Any]] = []
        for part in (inputs, outputs):
            read = {}
            for name, column in part.items():
                units = (INPUTS.get(name.rpartition("_")[0]) if part is inputs else None) or output_unit(name)
                read[name] = record.values((units,), [column])[:, 0]
            signals.append(read)
        return cls(record.times, signals[0], signals[1], **more)

    @classmethod
    def from_episode(cls, episode: Episode, **more: Any) -> Self:
        """Return torques, motor angles, joint twists and root strains of an episode, such as a log of `flexman drive`.

        Readings that were not received are interpolated. Readings that do not change are left out.

        Args:
            episode: the episode, with readings named motor_angles, joint_twists or root_strains.
            **more: further arguments of the class, such as gains.

        Raises:
            ValueError: for an episode without such readings.
        """
        n, time, outputs = episode.actions.shape[1], episode.time, dict[str, Array]()
        for name in LOGGED & episode.readings.keys():
            values = episode.readings[name]
            for label, column in zip(column_names(name, "", values.shape[1], n), values.T, strict=True):
                known = np.isfinite(column)
                if known.any() and np.ptp(column[known]) > 0.0:
                    outputs[label.partition(" (")[0]] = np.interp(time, time[known], column[known])
        if not outputs:
            raise value_error(
                "Measurement.from_episode", list(episode.readings), f"readings of {', '.join(sorted(LOGGED))}"
            )
        torques = np.vstack([episode.torques, episode.torques[-1:]]).T
        start = episode.readings["motor_angles"][0] if "motor_angles" in episode.readings else None
        inputs = {f"torque_{joint}": values for joint, values in enumerate(torques, 1)}
        return cls(time, inputs, dict(sorted(outputs.items())), **{"start": start, **more})

    def part(self, start: float, stop: float) -> Self:
        """Return the samples of the record from a start to a stop time, s; their times do not change."""
        inside = (self.times >= start) & (self.times <= stop)
        inputs = {name: each[inside] for name, each in self.inputs.items()}
        outputs = {name: each[inside] for name, each in self.outputs.items()}
        return replace(self, times=np.asarray(self.times)[inside], inputs=inputs, outputs=outputs)

    @property
    def period(self) -> float:
        """Sampling interval, s."""
        return float((self.times[-1] - self.times[0]) / (len(self.times) - 1))

    @property
    def compared(self) -> slice:
        """Slice of the samples after the settling time, which are compared with the simulation."""
        return slice(round(self.settling / self.period), len(self.times))


def _select_columns(
    record: TimeSeries, inputs: Mapping[str, str] | None, outputs: Mapping[str, str] | None
) -> tuple[Mapping[str, str], Mapping[str, str]]:
    """Return the mappings of inputs and outputs; None is replaced by all unused columns with suitable names."""
    used = {*(inputs or {}).values(), *(outputs or {}).values()}
    remaining = [name for name in record.columns if name not in used]
    if inputs is None:
        inputs = {name: name for name in remaining if INPUT.fullmatch(name)}
    if outputs is None:
        outputs = {name: name for name in remaining if OUTPUT.fullmatch(name)}
        unknown = [name for name in remaining if not (name in inputs or name in outputs or INPUT.fullmatch(name))]
        if not outputs:
            allowed = "columns with names such as motor_angle_1 or root_strain_1_y, or outputs={name: column}"
            raise value_error(f"{record.path.name}: the header", [*record.columns], allowed)
        if unknown:
            line = f"{record.path.name}: {', '.join(unknown)} not read: unknown names, see Measurement.outputs"
            warnings.warn(line, UserWarning, stacklevel=3)
    return inputs, outputs


def output_unit(name: str) -> str:
    """Return the SI unit of an output, rad by default."""
    units = (
        ("acceleration", "m/s^2"), ("specific_force", "m/s^2"), ("deflection_rate", "m/s"), ("deflection", "m"),
        ("strain", "1"), ("tip_velocity", "m/s"), ("tip", "m"), ("rate", "rad/s"),
    )  # fmt: skip
    return next((unit for part, unit in units if part in name), "rad")


METHOD = "gauss_3"  # integration method of order 4, which simulates several arms at once in lanes
STACKED = (  # attributes of a trajectory with a row for each time
    "time", "tip", "tip_velocity", "joint_angles", "motor_angles", "energy", "moving_energy", "work", "dissipation",
    "states", "deflection",
)  # fmt: skip


class SimulatedResponse:
    """Simulated response of an arm to the inputs of a measurement.

    Args:
        arm: the arm.
        measurement: the measurement.
        step: time step, s; None for the sampling interval.

    Attributes:
        measurement: the measurement.
        step: time step, s.
        scene: scene with the inputs of the measurement.
    """

    def __init__(self, arm: Arm, measurement: Measurement, step: float | None) -> None:
        self.measurement = measurement
        self.step = measurement.period if step is None else step
        times = np.asarray(measurement.times) - measurement.times[0]
        torques, motions = np.zeros((len(times), arm.n_joints)), [None] * arm.n_joints
        starts = [float(measurement.outputs.get(f"motor_angle_{i + 1}", [0.0])[0]) for i in range(arm.n_joints)]
        if measurement.start is not None:
            starts = list(vector("Measurement.start", measurement.start, arm.n_joints, "rad"))
        for name, values in measurement.inputs.items():
            channel = measurement.channel(name)
            if channel.joint >= arm.n_joints:
                raise value_error("Measurement.inputs", name, f"joints from 1 to {arm.n_joints}")
            if channel.kind == "motor_angle":
                deviation = measurement.deviations.get(name, 0.0)
                motions[channel.joint] = SampledAngles(times, values, deviation)  # type: ignore[call-overload]
            else:
                factor = 1.0 if channel.kind == "torque" else _per_ampere(arm, channel.joint)
                torques[:, channel.joint] += values * factor
        zero = ConstantTorque(np.zeros(arm.n_joints).tolist())
        changes = np.ones(len(times), dtype=bool)
        if measurement.hold == "zero":  # fewer samples: the simulation stops at each of them
            changes[1:-1] = (np.diff(torques, axis=0)[:-1] != 0.0).any(axis=1)
        self.scene = Scene(
            arm,
            ModelChoice((True,) * arm.n_joints, (1,) * arm.n_joints),
            SampledTorque(times[changes], torques[changes], measurement.hold) if torques.any() else zero,  # type: ignore[arg-type]
            Initial(starts, np.zeros(arm.n_joints).tolist()),
            duration=measurement.period * (len(times) - 1),
            output_step=measurement.period,
            prescribed=motions if any(motions) else None,
        )

    def signals(self, model: Model, parameters: Mapping[str, Array]) -> Array:
        """Simulate b arms of one model that differ in physical parameters, and filter their outputs.

        Args:
            model: model of the arms.
            parameters: values (b,) or (b, n) of at least one parameter, by its name in
                `simulation.physical_parameters.PARAMETERS`.

        Returns:
            The c outputs of the measurement after their filters, (b, c, T); NaN for an arm whose simulation failed.
        """
        count = len(next(iter(parameters.values())))
        varied: dict[str, Any] = dict(parameters)
        runs = simulate_all([self.scene] * count, model, METHOD, self.step, **varied)
        size, period = len(self.measurement.times), self.measurement.period
        complete = [run for run in runs if len(run.time) == size]
        result = np.full((count, len(self.measurement.outputs), size), np.nan)
        if not complete:
            return result
        rows: dict[str, Any] = {each: np.concatenate([getattr(run, each) for run in complete]) for each in STACKED}
        stacked = replace(complete[0], **rows)
        columns = {header.partition(" (")[0]: values for header, values in stacked.columns().items()}
        accelerations = None
        good = [i for i, run in enumerate(runs) if len(run.time) == size]
        for c, name in enumerate(self.measurement.outputs):
            if name in TIP_ACCELERATIONS:
                if accelerations is None:
                    accelerations = tip_accelerations(self.scene, runs, model, parameters)
                result[:, c] = accelerations[:, :, TIP_ACCELERATIONS[name]]
            else:
                if name not in columns:
                    near = suggestion(name, [*columns, *TIP_ACCELERATIONS])
                    raise value_error("Measurement.outputs", name, f"a name in Trajectory.columns{near}")
                result[good, c] = columns[name].reshape(len(complete), size)
            for each in self.measurement.filters.get(name, ()):
                result[good, c] = each.applied(result[good, c], period)
        return result


def _per_ampere(arm: Arm, joint: int) -> float:
    """Return the torque per current of the motor of a joint, after the gear, N m/A."""
    motor = arm.joints[joint].motor
    if motor is None:
        raise value_error(f"Measurement.inputs['current_{joint + 1}']", None, "torques: this joint has no Motor")
    return motor.torque_per_ampere

"""Measurements: time records with the filters of their signals, and the simulated response of an arm to their
inputs.
"""

import re
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from difflib import get_close_matches
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
    value_error,
    vector,
)
from flexman_gym.common.time_series import TimeSeries, read_time_series
from flexman_gym.kernels import layout
from flexman_gym.kernels.outputs import tip_accelerations
from flexman_gym.model.model import Model
from flexman_gym.scene.arm import Arm
from flexman_gym.scene.scene import Initial, ModelChoice, Scene
from flexman_gym.scene.signals import ConstantTorque, SampledAngles, SampledTorque
from flexman_gym.simulation.integrator import prescribed_flags
from flexman_gym.simulation.parameters import varied_constants
from flexman_gym.simulation.scene_simulation import prescribed_joints, simulate_all
from flexman_gym.simulation.trajectory import Trajectory

STEADY = 1e-3  # of the interval between samples: by how much one may differ from the next
LEAST = 16  # samples
DRIVE = re.compile(r"(torque|current)_[1-9][0-9]*")  # columns that are inputs where no mapping is given
OUTPUT = re.compile(
    r"(tip|tip_velocity|tip_acceleration|specific_force|deflection)_[xyz]"
    r"|((joint|motor)_(angle|rate)|joint_twist|joint_twist_rate)_[1-9][0-9]*"
    r"|link_deflection(_rate)?_[1-9][0-9]*_[yz]|root_strain_[1-9][0-9]*_(y|z|torsion)"
)  # columns that are outputs where no mapping is given
INPUTS = {"torque": "N m", "current": "A", "motor_angle": "rad"}  # with the number of the joint behind, from 1


@dataclass(frozen=True)
class Filter:
    """A linear filter that a signal passed, by the coefficients of its transfer function in s, highest power first.

    Attributes:
        numerator: coefficients, the highest power of s first, such as (1.0,). It has no higher power than the
            denominator: a filter does not amplify fast signals without end.
        denominator: coefficients, the highest power first, such as (0.1, 1.0) for 1 / (0.1 s + 1).

    Raises:
        ValueError: for lists that are empty, not finite, or make no such filter, and for one that is not stable.
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
        """Gives a low-pass of first order with a corner (Hz), or of second order with a damping ratio."""
        corner = 2.0 * np.pi * positive("frequency", frequency, "Hz")
        if damping_ratio is None:
            return cls((corner,), (1.0, corner))
        return cls((corner**2,), (1.0, 2.0 * positive("damping_ratio", damping_ratio) * corner, corner**2))

    def applied(self, values: Array, period: float) -> Array:
        """Gives signals (..., T) behind the filter: straight lines between samples a period (s) apart."""
        from scipy.signal import cont2discrete, lfilter, lfilter_zi

        if len(self.denominator) == 1:
            return values * (self.numerator[0] / self.denominator[0])
        b, a, _ = cont2discrete((self.numerator, self.denominator), period, "foh")
        start = lfilter_zi(b.ravel(), a) * values[..., :1]
        return np.asarray(lfilter(b.ravel(), a, values, zi=start)[0])


class _InputChannel(NamedTuple):
    """An input: its kind in INPUTS, and the joint, from 0."""

    kind: str
    joint: int


@dataclass(frozen=True, eq=False)
class Measurement:
    """Signals of a machine at T moments, equally far apart.

    Attributes:
        times: (T,) s.
        inputs: what drove the arm, name -> (T,): "torque_1" (N m), "current_1" (A, of a joint with a motor) or
            "motor_angle_1" (rad, a hub whose motion is given); joints count from 1. Motors without one are free.
        outputs: what it did, name -> (T,), by the names and units of `Trajectory.columns`, such as "motor_angle_1"
            (rad), "link_deflection_1_y" (m) or "root_strain_1_z" (1); and "tip_acceleration_x", "specific_force_x"
            (m/s^2).
        filters: name of an output -> the Filter that it passed, or several; what has none passed none.
        gains: outputs whose sensor has an unknown gain, which is fitted; of one name it is the same in all records.
        offsets: outputs with an unknown constant beside them.
        deviations: name -> standard deviation of the noise of an output, or of the rounding of an input's angles, in
            its unit. That of an output which is not given is estimated.
        settling: s at the start that are not compared, while what the arm did before dies away.
        start: (n,) angles at which the motors rest at first, rad; None for the first sample of each motor angle in the
            outputs, and 0 of others. Where encoders are noisy, say them: what is wrong at the start stays.
        hold: "zero" or "linear", what torques and currents do between samples.

    Raises:
        ValueError: one line with field, value and what is allowed; a damaged record has NaN in it, or times with a gap.
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
        allowed = f"{LEAST} to {MAX_ENTRIES} finite numbers (s), equally far apart"
        if not LEAST <= count <= MAX_ENTRIES:
            raise value_error(name, f"{count} times", allowed)
        times = number_array(name, self.times, (count,), allowed)
        steps = np.diff(times)
        odd = np.flatnonzero(np.abs(steps - np.median(steps)) > STEADY * np.median(steps))
        if np.median(steps) <= 0.0 or len(odd):
            i = int(odd[0]) if len(odd) else 0
            raise value_error(
                f"{name}[{i + 1}]", float(times[i + 1]), f"{allowed}: there is a gap behind {times[i]:g} s"
            )
        set_fields(self, times=times, inputs=self._signals("inputs", count), outputs=self._signals("outputs", count))
        for each in self.inputs:
            self.head(each)
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
        """Inputs or outputs as arrays."""
        given = getattr(self, part)
        if not isinstance(given, Mapping):
            raise value_error(f"Measurement.{part}", given, "a mapping from names to numbers")
        allowed = f"{count} finite numbers, one for each time"
        for name in given:
            text(f"a name in Measurement.{part}", name)
        return {
            name: number_array(f"Measurement.{part}[{name!r}]", each, (count,), allowed) for name, each in given.items()
        }

    def head(self, name: str) -> _InputChannel:
        """Gives kind and joint of an input; raises ValueError for what is none."""
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
        """Read a file with units in its head, such as "time (s),hub (deg)"; see `common.time_series.read_time_series`.

        Args:
            path: of the file.
            inputs: name -> column of the file. One in a unit that is not its own is refused. None for the columns
                torque_1, current_1 and so on.
            outputs: name -> column of the file. One whose unit no output of this name has is refused. None for all
                columns with the name of an output that are no inputs; other columns are warned of (UserWarning).
            more: filters, gains and so on.

        Raises:
            FileNotFoundError, ValueError: one line.
        """
        record = read_time_series(path)
        inputs, outputs = _named(record, inputs, outputs)
        signals: list[dict[str, Any]] = []
        for part in (inputs, outputs):
            read = {}
            for name, column in part.items():
                units = (INPUTS.get(name.rpartition("_")[0]) if part is inputs else None) or output_unit(name)
                read[name] = record.values((units,), [column])[:, 0]
            signals.append(read)
        return cls(record.times, signals[0], signals[1], **more)

    def part(self, start: float, stop: float) -> Self:
        """Gives the record from start to stop (s) of its own times."""
        kept = (self.times >= start) & (self.times <= stop)
        cut = {part: {name: each[kept] for name, each in getattr(self, part).items()} for part in ("inputs", "outputs")}
        return replace(self, times=np.asarray(self.times)[kept], inputs=cut["inputs"], outputs=cut["outputs"])

    @property
    def period(self) -> float:
        """Time from one sample to the next, s."""
        return float((self.times[-1] - self.times[0]) / (len(self.times) - 1))

    @property
    def compared(self) -> slice:
        """The samples behind the settling."""
        return slice(round(self.settling / self.period), len(self.times))


def _named(
    record: TimeSeries, inputs: Mapping[str, str] | None, outputs: Mapping[str, str] | None
) -> tuple[Mapping[str, str], Mapping[str, str]]:
    """Return both mappings; one that is None has the columns with known names that the other leaves."""
    used = {*(inputs or {}).values(), *(outputs or {}).values()}
    left = [name for name in record.columns if name not in used]
    if inputs is None:
        inputs = {name: name for name in left if DRIVE.fullmatch(name)}
    if outputs is None:
        outputs = {name: name for name in left if OUTPUT.fullmatch(name)}
        unknown = [name for name in left if not (name in inputs or name in outputs or DRIVE.fullmatch(name))]
        if not outputs:
            allowed = "columns with names such as motor_angle_1 or root_strain_1_y, or outputs={name: column}"
            raise value_error(f"{record.path.name}: the head", [*record.columns], allowed)
        if unknown:
            line = f"{record.path.name}: {', '.join(unknown)} not read: no known names, see Measurement.outputs"
            warnings.warn(line, UserWarning, stacklevel=3)
    return inputs, outputs


def output_unit(name: str) -> str:
    """Gives the SI unit of an output by its name, or that of an angle where the name says none."""
    ends = (
        ("acceleration", "m/s^2"), ("specific_force", "m/s^2"), ("deflection_rate", "m/s"), ("deflection", "m"),
        ("strain", "1"), ("tip_velocity", "m/s"), ("tip", "m"), ("rate", "rad/s"),
    )  # fmt: skip
    return next((unit for part, unit in ends if part in name), "rad")


METHOD = "gauss_3"  # of order 4, in lanes: its error stays below that of the data
STACKED = (
    "time", "tip", "tip_velocity", "joint_angles", "motor_angles", "energy", "moving_energy", "work", "dissipation",
    "states", "deflection",
)  # fmt: skip
FELT = {  # column of `kernels.outputs.compute_tip_accelerations` by name
    f"{name}_{axis}": part.start + i
    for name, part in (("tip_acceleration", layout.TIP_ACCELERATION), ("specific_force", layout.SPECIFIC_FORCE))
    for i, axis in enumerate("xyz")
}


class SimulatedResponse:
    """How an arm answers the inputs of a measurement.

    Attributes:
        measurement: what was recorded.
        scene: the same inputs, for the simulator.
        method: its name.
        step: s.
    """

    def __init__(self, arm: Arm, measurement: Measurement, step: float | None, method: str = METHOD) -> None:
        self.measurement, self.method = measurement, method
        self.step = measurement.period if step is None else step
        times = np.asarray(measurement.times) - measurement.times[0]
        torques, motions = np.zeros((len(times), arm.n_joints)), [None] * arm.n_joints
        starts = [float(measurement.outputs.get(f"motor_angle_{i + 1}", [0.0])[0]) for i in range(arm.n_joints)]
        if measurement.start is not None:
            starts = list(vector("Measurement.start", measurement.start, arm.n_joints, "rad"))
        for name, values in measurement.inputs.items():
            head = measurement.head(name)
            if head.joint >= arm.n_joints:
                raise value_error("Measurement.inputs", name, f"joints from 1 to {arm.n_joints}")
            if head.kind == "motor_angle":
                motions[head.joint] = SampledAngles(times, values, measurement.deviations.get(name, 0.0))  # type: ignore[call-overload]
            else:
                torques[:, head.joint] += values * (1.0 if head.kind == "torque" else _per_ampere(arm, head.joint))
        still = ConstantTorque(np.zeros(arm.n_joints).tolist())
        kept = np.ones(len(times), dtype=bool)
        if measurement.hold == "zero":  # a simulation stops at every sample, and only changes matter
            kept[1:-1] = (np.diff(torques, axis=0)[:-1] != 0.0).any(axis=1)
        self.scene = Scene(
            arm,
            ModelChoice((True,) * arm.n_joints, (1,) * arm.n_joints),
            SampledTorque(times[kept], torques[kept], measurement.hold) if torques.any() else still,  # type: ignore[arg-type]
            Initial(starts, np.zeros(arm.n_joints).tolist()),
            duration=measurement.period * (len(times) - 1),
            output_step=measurement.period,
            prescribed=motions if any(motions) else None,
        )

    def signals(self, model: Model, parameters: Mapping[str, Array]) -> Array:
        """Gives the outputs (b, c, T) of b arms behind their filters, NaN of an arm that failed.

        Args:
            model: of the arm.
            parameters: values (b, ...) by their name in `simulation.parameters.PARAMETERS`, at least one.
        """
        count = len(next(iter(parameters.values())))
        given: dict[str, Any] = dict(parameters)
        runs = simulate_all([self.scene] * count, model, self.method, self.step, **given)
        size, period = len(self.measurement.times), self.measurement.period
        whole = [run for run in runs if len(run.time) == size]
        result = np.full((count, len(self.measurement.outputs), size), np.nan)
        if not whole:
            return result
        rows: dict[str, Any] = {each: np.concatenate([getattr(run, each) for run in whole]) for each in STACKED}
        stacked = replace(whole[0], **rows)
        columns = {head.partition(" (")[0]: values for head, values in stacked.columns().items()}
        felt = None
        good = [i for i, run in enumerate(runs) if len(run.time) == size]
        for c, name in enumerate(self.measurement.outputs):
            if name in FELT:
                felt = self._felt(model, runs, parameters) if felt is None else felt
                result[:, c] = felt[:, :, FELT[name]]
            else:
                if name not in columns:
                    near = ", ".join(get_close_matches(name, [*columns, *FELT], 3, 0.0))
                    raise value_error(
                        "Measurement.outputs", name, f"a name of Trajectory.columns; the nearest are {near}"
                    )
                result[good, c] = columns[name].reshape(len(whole), size)
            for each in self.measurement.filters.get(name, ()):
                result[good, c] = each.applied(result[good, c], period)
        return result

    def _felt(self, model: Model, runs: list[Trajectory], parameters: Mapping[str, Array]) -> Array:
        """Tip accelerations (b, T, TIP_ACCELERATIONS), under the drive up to each sample."""
        own, size = varied_constants(model, len(runs), parameters), len(self.measurement.times)
        flags = prescribed_flags(model.n_joints, prescribed_joints(self.scene))
        pieces, d = self.scene.pieces, model.n_dof
        moments = self.measurement.period * np.arange(size)
        middle = 0.5 * (pieces.moments[1:] + pieces.moments[:-1])
        drives = np.array([pieces.table(p) for p in range(len(middle))])
        before = np.clip(np.searchsorted(pieces.moments, moments - 1e-9 * moments[-1]) - 1, 0, len(middle) - 1)
        applied = drives[before, layout.OFFSET] + drives[before, layout.SLOPE] * moments[:, None]
        result = np.full((len(runs), size, layout.TIP_ACCELERATIONS), np.nan)
        work = layout.make_work(model.constants)
        for i, run in enumerate(runs):
            constants = model.constants._replace(prescribed=flags, **{name: each[i] for name, each in own.items()})
            for state, drive, out in zip(run.states, applied, result[i], strict=False):
                tip_accelerations(constants, work, state[:d], state[d:], drive, out)
        return result


def _per_ampere(arm: Arm, joint: int) -> float:
    """Torque at a joint for each ampere, N m/A."""
    motor = arm.joints[joint].motor
    if motor is None:
        raise value_error(f"Measurement.inputs['current_{joint + 1}']", None, "torques: this joint has no Motor")
    return motor.torque_per_ampere

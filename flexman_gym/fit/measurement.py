"""Measurement: what was recorded of a machine, with the filters that each signal passed on its way."""

import re
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, NamedTuple, Self

import numpy as np

from flexman_gym.arrays import Array, Vector
from flexman_gym.checks import (
    MOST_ENTRIES,
    instance,
    is_count,
    number_array,
    one_of,
    positive,
    refusal,
    sequence,
    store,
    text,
)
from flexman_gym.scene.record import Record, read_record

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
            store(self, **{name: tuple(array.tolist())})
        if self.denominator[0] == 0.0 or len(self.numerator) > len(self.denominator):
            raise refusal("Filter.denominator", self.denominator, "a first number other than 0, and as many as above")
        if len(self.denominator) > 1 and np.roots(self.denominator).real.max() >= 0.0:
            raise refusal("Filter.denominator", self.denominator, "poles with negative real part")

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


class Head(NamedTuple):
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
        allowed = f"{LEAST} to {MOST_ENTRIES} finite numbers (s), equally far apart"
        if not LEAST <= count <= MOST_ENTRIES:
            raise refusal(name, f"{count} times", allowed)
        times = number_array(name, self.times, (count,), allowed)
        steps = np.diff(times)
        odd = np.flatnonzero(np.abs(steps - np.median(steps)) > STEADY * np.median(steps))
        if np.median(steps) <= 0.0 or len(odd):
            i = int(odd[0]) if len(odd) else 0
            raise refusal(f"{name}[{i + 1}]", float(times[i + 1]), f"{allowed}: there is a gap behind {times[i]:g} s")
        store(self, times=times, inputs=self._signals("inputs", count), outputs=self._signals("outputs", count))
        for each in self.inputs:
            self.head(each)
        if not self.outputs:
            raise refusal("Measurement.outputs", {}, "at least one")
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
        store(self, filters=listed)
        if not 0.0 <= self.settling < times[-1] - times[0]:
            raise refusal("Measurement.settling", self.settling, f"less than {times[-1] - times[0]:g} (s)")

    def _signals(self, part: str, count: int) -> dict[str, Array]:
        """Inputs or outputs as arrays."""
        given = getattr(self, part)
        if not isinstance(given, Mapping):
            raise refusal(f"Measurement.{part}", given, "a mapping from names to numbers")
        allowed = f"{count} finite numbers, one for each time"
        for name in given:
            text(f"a name in Measurement.{part}", name)
        return {
            name: number_array(f"Measurement.{part}[{name!r}]", each, (count,), allowed) for name, each in given.items()
        }

    def head(self, name: str) -> Head:
        """Gives kind and joint of an input; raises ValueError for what is none."""
        kind, _, number = name.rpartition("_")
        if kind not in INPUTS or not is_count(number) or int(number) == 0:
            allowed = "torque_1, current_1 or motor_angle_1, with the number of the joint from 1"
            raise refusal("Measurement.inputs", name, allowed)
        return Head(kind, int(number) - 1)

    @classmethod
    def from_csv(
        cls,
        path: str | Path,
        inputs: Mapping[str, str] | None = None,
        outputs: Mapping[str, str] | None = None,
        **more: Any,
    ) -> Self:
        """Read a file with units in its head, such as "time (s),hub (deg)"; see `scene.record.read_record`.

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
        record = read_record(path)
        inputs, outputs = _named(record, inputs, outputs)
        signals: list[dict[str, Any]] = []
        for part in (inputs, outputs):
            read = {}
            for name, column in part.items():
                units = (INPUTS.get(name.rpartition("_")[0]) if part is inputs else None) or unit_of(name)
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
    record: Record, inputs: Mapping[str, str] | None, outputs: Mapping[str, str] | None
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
            raise refusal(f"{record.path.name}: the head", [*record.columns], allowed)
        if unknown:
            line = f"{record.path.name}: {', '.join(unknown)} not read: no known names, see Measurement.outputs"
            warnings.warn(line, UserWarning, stacklevel=3)
    return inputs, outputs


def unit_of(name: str) -> str:
    """Gives the SI unit of an output by its name, or that of an angle where the name says none."""
    ends = (
        ("acceleration", "m/s^2"), ("specific_force", "m/s^2"), ("deflection_rate", "m/s"), ("deflection", "m"),
        ("strain", "1"), ("tip_velocity", "m/s"), ("tip", "m"), ("rate", "rad/s"),
    )  # fmt: skip
    return next((unit for part, unit in ends if part in name), "rad")

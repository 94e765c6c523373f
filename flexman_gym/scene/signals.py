"""Signals over time: constant, sinusoidal and sampled torques, accelerations and forces."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, ClassVar, Protocol, Self

import numpy as np
from numpy.typing import NDArray

from flexman_gym.common.arrays import Array, Vector
from flexman_gym.common.checks import (
    MAX_ENTRIES,
    finite,
    non_negative,
    number_array,
    one_of,
    positive,
    set_fields,
    vector,
    whole_ratio,
)
from flexman_gym.common.errors import value_error
from flexman_gym.common.files import write_csv

HOLDS = ("zero", "linear")
MIN_SPLINE_SAMPLES = 4


@dataclass(frozen=True)
class SampledSignal:
    """Signal given by T samples; a scene accepts it in place of a Signal.

    Between samples the signal is constant (hold="zero": zero-order hold) or linear (hold="linear": first-order hold).
    With hold="zero" the last value is held for the last sampling interval, times[-1] - times[-2]. The signal is
    undefined before the first sample and after its end; the duration of a scene must lie in this interval. Integration
    steps end at every sample, so that no step contains a jump or a kink.

    Attributes:
        times: times (T,) of the samples, s, ascending; T >= 2.
        values: values (T,) in the unit of the physical quantity.
        hold: interpolation between samples, "zero" or "linear".

    Examples:
        >>> gust = fm.SampledSignal(times=[0.0, 0.5, 1.0], values=[0.0, 2.0, 0.0], hold="linear")
        >>> gust.end
        1.0
    """

    times: Vector
    values: Vector
    hold: str = "zero"

    def __post_init__(self) -> None:
        times = _checked_times("SampledSignal.times", self.times)
        values = number_array("SampledSignal.values", self.values, times.shape, f"{len(times)} finite numbers")
        one_of("SampledSignal.hold", self.hold, HOLDS)
        set_fields(self, times=tuple(times.tolist()), values=tuple(values.tolist()))

    @classmethod
    def from_csv(cls, path: str | Path, column: str, unit: str, hold: str = "zero") -> Self:
        """Read a column of a CSV file, converted to a unit (from mN to N, for example); see `read_time_series`."""
        from flexman_gym.common.time_series import read_time_series

        record = read_time_series(path, [column], (unit,)).warn()
        return cls(record.times, record.table[:, 0], hold)

    @property
    def largest(self) -> float:
        """Value of largest magnitude."""
        return max(self.values, key=abs)

    @property
    def end(self) -> float:
        """Time at which the signal ends, s."""
        return self.times[-1] + (self.times[-1] - self.times[-2] if self.hold == "zero" else 0.0)

    def lines(self, times: Array) -> tuple[Array, Array]:
        """Return a (p,) and b (p,) of the line a + b t that the signal follows at each of the times (p,), s."""
        samples, values = np.array(self.times), np.array(self.values)
        j = np.clip(np.searchsorted(samples, times, "right") - 1, 0, len(samples) - 1)
        if self.hold == "zero":
            return values[j], np.zeros(len(times))
        j = np.minimum(j, len(samples) - 2)
        slopes = (values[j + 1] - values[j]) / (samples[j + 1] - samples[j])
        return values[j] - slopes * samples[j], slopes


@dataclass(frozen=True)
class SampledTorque:
    """Torques of n motors, given by T samples and interpolated as in `SampledSignal`.

    Attributes:
        times: times (T,) of the samples, s, ascending; T >= 2.
        values: motor torques (T, n) at the joints, N m.
        hold: interpolation between samples, "zero" or "linear".

    Examples:
        >>> torque = fm.SampledTorque(times=[0.0, 0.5, 1.0], values=[[0.1], [-0.1], [0.0]], hold="zero")
        >>> torque.at(0.7)
        array([-0.1])
    """

    kind: ClassVar[str] = "sampled"
    times: Vector
    values: Sequence[Vector]
    hold: str = "zero"

    def __post_init__(self) -> None:
        times = _checked_times("SampledTorque.times", self.times)
        values = _checked_torques("SampledTorque.values", self.values, len(times))
        one_of("SampledTorque.hold", self.hold, HOLDS)
        set_fields(self, times=tuple(times.tolist()), values=tuple(map(tuple, values.tolist())))

    @classmethod
    def from_csv(cls, path: str | Path, columns: Sequence[str] | None = None, hold: str = "zero") -> Self:
        """Read a CSV file with a header such as "time (s),torque_1 (N m)"; see `common.time_series.read_time_series`.

        Args:
            path: path of the file.
            columns: names of the n columns, such as "torque_1", in the order of the joints; None reads all columns of
                torques, without commands if there are others.
            hold: "zero" or "linear".

        Raises:
            FileNotFoundError: if the file does not exist.
        """
        from flexman_gym.common.time_series import read_time_series

        record = read_time_series(path, columns, ("N m",)).warn()
        return cls(record.times, record.table, hold)  # type: ignore[arg-type]

    @classmethod
    def from_function(
        cls, function: Callable[[float], Vector], duration: float, period: float, hold: str = "linear"
    ) -> Self:
        """Sample a function of time before the simulation.

        The function is called once per sample. The integration restarts at every sample, which takes 30 us for any arm.
        With linear interpolation the error is at most period^2 / 8 times the second derivative of the function.

        Args:
            function: function of the time (s) that returns the motor torques (n,), N m.
            duration: time of the last sample, s.
            period: sampling interval, s; it must divide the duration.
            hold: "zero" or "linear".

        Examples:
            >>> torque = fm.SampledTorque.from_function(lambda time: [2.0 * time], duration=1.0, period=0.25)
            >>> torque.at(0.5)
            array([1.])
        """
        allowed = "a number of seconds that divides the duration"
        count = whole_ratio("period", positive("period", period, "s"), positive("duration", duration, "s"), allowed)
        if count >= MAX_ENTRIES:
            raise value_error("period", period, f"at most {MAX_ENTRIES} samples in {duration} s")
        times = np.linspace(0.0, duration, count + 1)
        return cls(times, [function(time) for time in times.tolist()], hold)

    def to_csv(self, path: str | Path) -> None:
        """Write times and values, without `hold`, to a CSV file for `from_csv`."""
        columns = enumerate(zip(*self.values, strict=True), 1)
        write_csv(path, {"time (s)": self.times, **{f"torque_{i} (N m)": column for i, column in columns}})

    def signals(self) -> list[Any]:
        """Return the torques of the n motors as n SampledSignals."""
        return [SampledSignal(self.times, column, self.hold) for column in np.array(self.values).T]

    def at(self, time: float) -> NDArray[np.float64]:
        """Return the torques (n,), N m, at a time (s) within the samples."""
        signals = self.signals()
        if not self.times[0] <= time <= signals[0].end:
            raise value_error("time", time, f"one from {self.times[0]} to {signals[0].end} (s)")
        lines = np.array([signal.lines(np.array([time])) for signal in signals])
        result: NDArray[np.float64] = lines[:, 0, 0] + lines[:, 1, 0] * time
        return result


@dataclass(frozen=True)
class SampledAngles:
    """Prescribed motion of a motor (of the joint itself if it is rigid), given by its angle at T times.

    The motor follows a cubic spline with continuous acceleration that interpolates the angles or, for a positive
    `deviation`, smooths them. Initial angle and rate of the joint are taken from the spline and replace the values in
    `Initial`. For exact samples of a smooth motion, the error of the spline is proportional to the fourth power of the
    sampling interval.

    Attributes:
        times: times (T,) of the samples, s, ascending; T >= 4.
        angles: motor angles (T,), rad.
        deviation: standard deviation of the noise or rounding error of the angles, rad. If positive, the spline has the
            fewest pieces with this root-mean-square distance from the angles (smoothing spline of FITPACK). If 0, it
            passes through all angles; rounding by an encoder then causes large accelerations.

    Examples:
        >>> motion = fm.SampledAngles(times=[0.0, 0.1, 0.2, 0.3], angles=[0.0, 0.01, 0.04, 0.09])
        >>> round(motion.acceleration.values[0], 6)
        2.0
    """

    times: Vector
    angles: Vector
    deviation: float = 0.0

    def __post_init__(self) -> None:
        times = _checked_times("SampledAngles.times", self.times)
        angles = number_array("SampledAngles.angles", self.angles, times.shape, f"{len(times)} finite numbers (rad)")
        if len(times) < MIN_SPLINE_SAMPLES:
            raise value_error("SampledAngles.times", self.times, f"at least {MIN_SPLINE_SAMPLES} times (s)")
        deviation = non_negative("SampledAngles.deviation", self.deviation, "rad")
        set_fields(self, times=tuple(times.tolist()), angles=tuple(angles.tolist()), deviation=deviation)

    @classmethod
    def from_csv(cls, path: str | Path, column: str, deviation: float = 0.0) -> Self:
        """Read a column of angles, such as "hub" of a CSV file with the header "time (s),hub (deg)"."""
        from flexman_gym.common.time_series import read_time_series

        record = read_time_series(path, [column], ("rad",)).warn()
        return cls(record.times, record.table[:, 0], deviation)

    @cached_property
    def _spline(self) -> tuple[Any, Array]:
        """Spline of the angles (rad) over time, and the times of its knots (s)."""
        from scipy.interpolate import CubicSpline, UnivariateSpline  # imported here because it takes 0.3 s

        if self.deviation == 0.0:
            return CubicSpline(self.times, self.angles), np.array(self.times)
        weights = np.full(len(self.times), 1.0 / self.deviation)
        spline = UnivariateSpline(self.times, self.angles, weights, k=3, s=float(len(weights)))
        return spline, np.array(spline.get_knots())

    @property
    def acceleration(self) -> SampledSignal:
        """Second derivative of the spline, rad/s^2, as a signal that is linear between the knots."""
        spline, knots = self._spline
        return SampledSignal(knots, spline.derivative(2)(knots), "linear")

    def start(self, time: float = 0.0) -> tuple[float, float]:
        """Return angle (rad) and rate (rad/s) of the spline at a time (s)."""
        spline, _ = self._spline
        return float(spline(time)), float(spline.derivative()(time))


def _checked_times(name: str, value: object) -> Array:
    """Return times (T,), s, as an array after checking that they ascend."""
    allowed = f"2 to {MAX_ENTRIES} finite numbers (s), each larger than the one before"
    count = len(value) if isinstance(value, list | tuple | np.ndarray) else 0
    times = number_array(name, value, (count,), allowed) if 2 <= count <= MAX_ENTRIES else np.zeros(2)
    if not (np.diff(times) > 0.0).all():
        raise value_error(name, value, allowed)
    return times


def _checked_torques(name: str, value: object, count: int) -> Array:
    """Return torques (count, n), N m, as an array after checking their shape."""
    allowed = f"{count} lists of finite numbers (N m), one for each time, all of the same length"
    try:
        joints = len(value[0])  # type: ignore[index]
    except Exception:  # no list of lists
        joints = 0
    if joints < 1:
        raise value_error(name, value, allowed)
    return number_array(name, value, (count, joints), allowed)


TIME_TOLERANCE = 1e-12  # dimensionless; difference of two equal times / duration, at most


@dataclass(frozen=True)
class Signal:
    """Sine with an offset: offset + amplitude sin(2 pi frequency_hz t + phase) for start <= t < stop, and 0 otherwise.

    Attributes:
        offset: mean value, in the unit of the physical quantity.
        amplitude: amplitude, in the unit of the physical quantity.
        frequency_hz: frequency, Hz, not negative.
        phase: phase, rad.
        start: start time, s, not negative.
        stop: end time, s, after the start; None for a signal without end.

    Examples:
        >>> push = fm.Signal(offset=5.0, start=0.2, stop=0.3)
        >>> push.offset * (push.stop - push.start)
        0.4999999999999999
    """

    offset: float = 0.0
    amplitude: float = 0.0
    frequency_hz: float = 0.0
    phase: float = 0.0
    start: float = 0.0
    stop: float | None = None

    def __post_init__(self) -> None:
        names = ("offset", "amplitude", "phase")
        set_fields(self, **{name: finite(f"Signal.{name}", getattr(self, name)) for name in names})
        set_fields(self, frequency_hz=non_negative("Signal.frequency_hz", self.frequency_hz, "Hz"))
        set_fields(self, start=non_negative("Signal.start", self.start, "s"))
        if self.stop is not None:
            set_fields(self, stop=finite("Signal.stop", self.stop, "s"))
            if self.stop <= self.start:
                raise value_error("Signal.stop", self.stop, f"a time after the start {self.start} (s), or None")

    def column(self) -> NDArray[np.float64]:
        """Return the column (7,) of the signal in `signal_table`."""
        stop = math.inf if self.stop is None else self.stop
        return np.array([self.offset, self.amplitude, self.frequency_hz, self.phase, self.start, stop, 0.0])

    @property
    def largest(self) -> float:
        """Offset or amplitude, whichever has the larger magnitude."""
        return max(self.offset, self.amplitude, key=abs)


@dataclass(frozen=True)
class ConstantTorque:
    """Constant torques of the motors.

    Attributes:
        value: motor torques (n,) at the joints, N m.

    Examples:
        >>> fm.ConstantTorque((400.0, 400.0, 400.0)).value
        (400.0, 400.0, 400.0)
    """

    kind: ClassVar[str] = "constant"
    value: Vector

    def __post_init__(self) -> None:
        set_fields(self, value=vector("ConstantTorque.value", self.value, unit="N m"))

    def signals(self) -> list[Signal | SampledSignal]:
        """Return the torques of the n motors as n Signals."""
        return [Signal(value) for value in self.value]

    def at(self, time: float) -> NDArray[np.float64]:
        """Return the torques (n,), N m, at a time (s)."""
        return np.array(self.value)


@dataclass(frozen=True)
class SineTorque:
    """Sinusoidal torques of the motors: amplitude sin(2 pi frequency_hz t + phase).

    Attributes:
        amplitude: amplitudes (n,) of the motor torques at the joints, N m.
        frequency_hz: frequencies (n,), Hz, not negative.
        phase: phases (n,), rad.

    Examples:
        >>> torque = fm.SineTorque(amplitude=(2.0,), frequency_hz=(0.5,), phase=(0.0,))
        >>> torque.at(0.5)
        array([2.])
    """

    kind: ClassVar[str] = "sine"
    amplitude: Vector
    frequency_hz: Vector
    phase: Vector

    def __post_init__(self) -> None:
        amplitude = vector("SineTorque.amplitude", self.amplitude, unit="N m")
        frequency_hz = vector("SineTorque.frequency_hz", self.frequency_hz, len(amplitude), "Hz")
        for i, frequency in enumerate(frequency_hz):
            non_negative(f"SineTorque.frequency_hz[{i}]", frequency, "Hz")
        phase = vector("SineTorque.phase", self.phase, len(amplitude), "rad")
        set_fields(self, amplitude=amplitude, frequency_hz=frequency_hz, phase=phase)

    def signals(self) -> list[Signal | SampledSignal]:
        """Return the torques of the n motors as n Signals."""
        return [Signal(0.0, *numbers) for numbers in zip(self.amplitude, self.frequency_hz, self.phase, strict=True)]

    def at(self, time: float) -> NDArray[np.float64]:
        """Return the torques (n,), N m, at a time (s)."""
        return self.amplitude * np.sin(2.0 * np.pi * time * np.array(self.frequency_hz) + self.phase)


_NO_SIGNAL = Signal()


def signal_table(signals: Sequence[Signal | None]) -> NDArray[np.float64]:
    """Return the signals as the table (7, n + 6) that the kernels read.

    Its rows are offset, amplitude, frequency (Hz), phase (rad), start (s), stop (s) and slope (unit of the signal / s).

    Args:
        signals: n motor signals, 3 components of the tip force and 3 of the base acceleration; None for zero.
    """
    return np.column_stack([(signal or _NO_SIGNAL).column() for signal in signals])


class BaseRotation(Protocol):
    """Protocol of the rotation of a base, see `simulation.foundation`; `times` (p + 1,), s, bound its intervals."""

    times: Array

    def columns(self, time: float) -> Array:
        """Return the last columns of the drive table at a time (s)."""
        ...


class PiecewiseSignals:
    """Signals of a scene, with one signal table for each interval between neighbouring samples.

    Args:
        signals: n + 6 signals in the order of `signal_table`; None for zero.
        duration: end of the last interval, s.
        rotation: rotation of the base, whose foundation rows are the last columns of the tables; None for none.

    Attributes:
        times: boundaries (p + 1,) of the p intervals, s, from 0; p = 1 if no signal is sampled.
    """

    def __init__(
        self,
        signals: Sequence[Signal | SampledSignal | None],
        duration: float,
        rotation: "BaseRotation | None" = None,
    ) -> None:
        self._rotation = rotation
        sampled = {i: signal for i, signal in enumerate(signals) if isinstance(signal, SampledSignal)}
        self._table = signal_table([None if isinstance(signal, SampledSignal) else signal for signal in signals])
        turns = () if rotation is None else (rotation.times,)
        times = np.unique(np.concatenate([[0.0, duration], *(each.times for each in sampled.values()), *turns]))
        times = times[(times >= 0.0) & (times <= duration)]
        distinct = np.append(True, np.diff(times) > TIME_TOLERANCE * duration)
        self.times = times[distinct] if distinct[-1] else np.append(times[distinct][:-1], duration)
        self._middles = 0.5 * (self.times[1:] + self.times[:-1])
        self._lines: dict[int, tuple[Array, Array]] = {i: each.lines(self._middles) for i, each in sampled.items()}

    def table(self, interval: int = 0) -> NDArray[np.float64]:
        """Return the signal table (7, n + 6) of an interval, given by its index."""
        result = self._table.copy()
        for i, (offsets, slopes) in self._lines.items():
            result[0, i], result[-1, i] = offsets[interval], slopes[interval]
        if self._rotation is not None:
            result = np.hstack([result, self._rotation.columns(self._middles[interval])])
        return result

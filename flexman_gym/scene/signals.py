"""Signals over time for torques, motions, forces and accelerations: constants, sines and samples."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, ClassVar, Self

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
    value_error,
    vector,
    whole_ratio,
)
from flexman_gym.common.time_series import read_time_series, write_csv

HOLDS = ("zero", "linear")
MIN_SPLINE_SAMPLES = 4


@dataclass(frozen=True)
class SampledSignal:
    """Signal given by T samples, usable wherever a Signal is.

    Between samples it is constant (hold="zero", the output of a digital-to-analogue converter) or linear
    (hold="linear"). With hold="zero" the last value lasts as long as the previous one. The signal is undefined outside
    these times, so that a scene must not begin earlier or end later. The steps of a simulation end at every sample:
    none crosses a jump or a kink.

    Attributes:
        times: times (T,) of the samples, s, ascending, at least two.
        values: values (T,) in the unit of the quantity.
        hold: "zero" or "linear".

    Examples:
        >>> gust = fm.SampledSignal(times=[0.0, 0.5, 1.0], values=[0.0, 2.0, 0.0], hold="linear")
        >>> gust.end
        1.0
    """

    times: Vector
    values: Vector
    hold: str = "zero"

    def __post_init__(self) -> None:
        times = _moments("SampledSignal.times", self.times)
        values = number_array("SampledSignal.values", self.values, times.shape, f"{len(times)} finite numbers")
        one_of("SampledSignal.hold", self.hold, HOLDS)
        set_fields(self, times=tuple(times.tolist()), values=tuple(values.tolist()))

    @classmethod
    def from_csv(cls, path: str | Path, column: str, unit: str, hold: str = "zero") -> Self:
        """Read a column in a unit, or in a multiple of it such as mN for N, from a CSV file; see `read_time_series`."""
        record = read_time_series(path)
        return cls(record.times, record.values((unit,), [column])[:, 0], hold)

    @property
    def largest(self) -> float:
        """Value of largest magnitude."""
        return max(self.values, key=abs)

    @property
    def end(self) -> float:
        """Time at which the signal ends, s."""
        return self.times[-1] + (self.times[-1] - self.times[-2] if self.hold == "zero" else 0.0)

    def lines(self, moments: Array) -> tuple[Array, Array]:
        """Return value at time 0 and slope (per s) of the straight line followed at times (p,), s."""
        times, values = np.array(self.times), np.array(self.values)
        j = np.clip(np.searchsorted(times, moments, "right") - 1, 0, len(times) - 1)
        if self.hold == "zero":
            return values[j], np.zeros(len(moments))
        j = np.minimum(j, len(times) - 2)
        slopes = (values[j + 1] - values[j]) / (times[j + 1] - times[j])
        return values[j] - slopes * times[j], slopes


@dataclass(frozen=True)
class SampledTorque:
    """Torques of n motors (of the links in rigid joints) given by T samples; between samples like `SampledSignal`.

    Attributes:
        times: times (T,) of the samples, s, ascending, at least two.
        values: torques (T, n), N m.
        hold: "zero" or "linear".

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
        times = _moments("SampledTorque.times", self.times)
        values = _rows("SampledTorque.values", self.values, len(times))
        one_of("SampledTorque.hold", self.hold, HOLDS)
        set_fields(self, times=tuple(times.tolist()), values=tuple(map(tuple, values.tolist())))

    @classmethod
    def from_csv(cls, path: str | Path, columns: Sequence[str] | None = None, hold: str = "zero") -> Self:
        """Read a CSV file with a header such as "time (s),torque_1 (N m)"; see `read_time_series`.

        Args:
            path: path of the file.
            columns: names of columns, such as "torque_1", in the order of the joints; None reads all torques of the
                file.
            hold: "zero" or "linear".

        Returns:
            The torques.

        Raises:
            FileNotFoundError: if the file does not exist.
        """
        record = read_time_series(path)
        return cls(record.times, record.values(("N m",), columns), hold)  # type: ignore[arg-type]

    @classmethod
    def from_function(
        cls, function: Callable[[float], Vector], duration: float, period: float, hold: str = "linear"
    ) -> Self:
        """Sample a function of time before the simulation.

        The function is called once per sample, not within the steps of a method. The simulation then stops at every
        sample, which takes 30 us of one core in addition to the steps and the function itself, whatever the arm. With
        linear interpolation the error is at most period^2 / 8 times the second derivative.

        Args:
            function: torques (n,) in N m at a time in s.
            duration: time of the last sample, s.
            period: sampling interval, s; it must divide the duration.
            hold: "zero" or "linear".

        Returns:
            The torques.

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
        """Write a CSV file, from which `from_csv` reads equal torques if it is given the same hold."""
        write_csv(path, {"time (s)": self.times, **_headed_columns("torque", "N m", self.values)})

    def signals(self) -> list[Any]:
        """Return the torque of each motor as a signal, n in all."""
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
    """Prescribed motion of a motor (of the joint itself if rigid), given by its angle at T times.

    The motor follows a cubic spline with continuous acceleration, through the angles or, if they are noisy, close to
    them. It starts at the angle and rate of the spline, whatever `Initial` contains for this joint. For exact samples
    of a smooth motion, the error of the spline is proportional to the fourth power of the sampling interval.

    Attributes:
        times: times (T,) of the samples, s, ascending, at least four.
        angles: angles (T,), rad.
        deviation: standard deviation of the noise or rounding of the angles, rad. If positive, the spline has as few
            pieces as this deviation from the angles permits (smoothing of FITPACK). If 0, it passes through all angles;
            the rounding of an encoder, differentiated twice, then shakes the arm.

    Examples:
        >>> motion = fm.SampledAngles(times=[0.0, 0.1, 0.2, 0.3], angles=[0.0, 0.01, 0.04, 0.09])
        >>> round(motion.acceleration.values[0], 6)
        2.0
    """

    times: Vector
    angles: Vector
    deviation: float = 0.0

    def __post_init__(self) -> None:
        times = _moments("SampledAngles.times", self.times)
        angles = number_array("SampledAngles.angles", self.angles, times.shape, f"{len(times)} finite numbers (rad)")
        if len(times) < MIN_SPLINE_SAMPLES:
            raise value_error("SampledAngles.times", self.times, f"at least {MIN_SPLINE_SAMPLES} times (s)")
        deviation = non_negative("SampledAngles.deviation", self.deviation, "rad")
        set_fields(self, times=tuple(times.tolist()), angles=tuple(angles.tolist()), deviation=deviation)

    @classmethod
    def from_csv(cls, path: str | Path, column: str, deviation: float = 0.0) -> Self:
        """Read a column of angles from a CSV file, such as "hub" in "time (s),hub (deg)"; see `read_time_series`."""
        record = read_time_series(path)
        return cls(record.times, record.values(("rad",), [column])[:, 0], deviation)

    @cached_property
    def _spline(self) -> tuple[Any, Array]:
        """Spline of the angles, and the times of its knots."""
        from scipy.interpolate import CubicSpline, UnivariateSpline  # imported here because it takes 0.3 s

        if self.deviation == 0.0:
            return CubicSpline(self.times, self.angles), np.array(self.times)
        weights = np.full(len(self.times), 1.0 / self.deviation)
        spline = UnivariateSpline(self.times, self.angles, weights, k=3, s=float(len(weights)))
        return spline, np.array(spline.get_knots())

    @property
    def acceleration(self) -> SampledSignal:
        """Acceleration, rad/s^2, linear between the knots of the spline."""
        spline, knots = self._spline
        return SampledSignal(knots, spline.derivative(2)(knots), "linear")

    def start(self, time: float = 0.0) -> tuple[float, float]:
        """Return angle (rad) and rate (rad/s) of the spline at a time (s)."""
        spline, _ = self._spline
        return float(spline(time)), float(spline.derivative()(time))


def _headed_columns(name: str, unit: str, values: Sequence[Vector]) -> dict[str, Any]:
    """Return columns by header, such as "torque_1 (N m)", numbered from 1."""
    return {f"{name}_{i} ({unit})": column for i, column in enumerate(zip(*values, strict=True), 1)}


def _moments(name: str, value: object) -> Array:
    """Return times (T,) in ascending order as an array."""
    allowed = f"2 to {MAX_ENTRIES} finite numbers (s), each larger than the one before"
    count = len(value) if isinstance(value, list | tuple | np.ndarray) else 0
    times = number_array(name, value, (count,), allowed) if 2 <= count <= MAX_ENTRIES else np.zeros(2)
    if not (np.diff(times) > 0.0).all():
        raise value_error(name, value, allowed)
    return times


def _rows(name: str, value: object, count: int) -> Array:
    """Return values (T, n) as an array."""
    allowed = f"{count} lists of finite numbers (N m), one for each time, all of the same length"
    try:
        joints = len(value[0])  # type: ignore[index]
    except Exception:  # no list of lists
        joints = 0
    if joints < 1:
        raise value_error(name, value, allowed)
    return number_array(name, value, (count, joints), allowed)


TIME_TOLERANCE = 1e-12  # of the duration; times closer than this are equal


@dataclass(frozen=True)
class Signal:
    """Sine with an offset: offset + amplitude sin(2 pi frequency_hz t + phase) for start <= t < stop, and 0 otherwise.

    Attributes:
        offset: mean value, in the unit of the quantity.
        amplitude: amplitude, in the unit of the quantity.
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
        """Return the column (7,) of the signal in the signal table of the kernels, see `kernels.layout`."""
        stop = math.inf if self.stop is None else self.stop
        return np.array([self.offset, self.amplitude, self.frequency_hz, self.phase, self.start, stop, 0.0])

    @property
    def largest(self) -> float:
        """Offset or amplitude, whichever has the larger magnitude."""
        return max(self.offset, self.amplitude, key=abs)


@dataclass(frozen=True)
class ConstantTorque:
    """Constant torques on the motors (on the links in rigid joints).

    Attributes:
        value: torques (n,), N m.

    Examples:
        >>> fm.ConstantTorque((400.0, 400.0, 400.0)).value
        (400.0, 400.0, 400.0)
    """

    kind: ClassVar[str] = "constant"
    value: Vector

    def __post_init__(self) -> None:
        set_fields(self, value=vector("ConstantTorque.value", self.value, unit="N m"))

    def signals(self) -> list[Signal | SampledSignal]:
        """Return the torque of each motor as a Signal, n in all."""
        return [Signal(value) for value in self.value]

    def at(self, time: float) -> NDArray[np.float64]:
        """Return the torques (n,), N m, at a time (s)."""
        return np.array(self.value)


@dataclass(frozen=True)
class SineTorque:
    """Sinusoidal torques amplitude sin(2 pi frequency_hz t + phase) on the motors (on the links in rigid joints).

    Attributes:
        amplitude: amplitudes (n,), N m.
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
        """Return the torque of each motor as a Signal, n in all."""
        return [Signal(0.0, *numbers) for numbers in zip(self.amplitude, self.frequency_hz, self.phase, strict=True)]

    def at(self, time: float) -> NDArray[np.float64]:
        """Return the torques (n,), N m, at a time (s)."""
        return self.amplitude * np.sin(2.0 * np.pi * time * np.array(self.frequency_hz) + self.phase)


def signal_table(drives: Sequence[Signal | None]) -> NDArray[np.float64]:
    """Return the signal table (7, n + 6) of n + 6 signals; None stands for a zero signal."""
    return np.column_stack([(drive or Signal()).column() for drive in drives])


class PiecewiseSignals:
    """Signals from 0 s to a duration as one table per interval, in which no sample begins or ends.

    Args:
        drives: the signals; None for a zero signal.
        duration: end of the last interval, s.

    Attributes:
        moments: boundaries (p + 1,) of the p intervals, s; one interval if no signal is sampled.
    """

    def __init__(self, drives: Sequence[Signal | SampledSignal | None], duration: float) -> None:
        sampled = {i: drive for i, drive in enumerate(drives) if isinstance(drive, SampledSignal)}
        self._table = signal_table([None if isinstance(drive, SampledSignal) else drive for drive in drives])
        moments = np.unique(np.concatenate([[0.0, duration], *(drive.times for drive in sampled.values())]))
        moments = moments[(moments >= 0.0) & (moments <= duration)]
        apart = np.append(True, np.diff(moments) > TIME_TOLERANCE * duration)
        self.moments = moments[apart] if apart[-1] else np.append(moments[apart][:-1], duration)
        middles = 0.5 * (self.moments[1:] + self.moments[:-1])
        self._lines: dict[int, tuple[Array, Array]] = {i: drive.lines(middles) for i, drive in sampled.items()}

    def table(self, piece: int = 0) -> NDArray[np.float64]:
        """Return the signal table (7, n + 6) of an interval, see `kernels.layout`."""
        result = self._table.copy()
        for i, (values, slopes) in self._lines.items():
            result[0, i], result[-1, i] = values[piece], slopes[piece]
        return result

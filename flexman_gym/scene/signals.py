"""Signals of torque, motion, force and acceleration over time: constants, sines and samples."""

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
LEAST_OF_SPLINE = 4  # samples


@dataclass(frozen=True)
class SampledSignal:
    """A signal that is known at T moments; it takes the place of a Signal.

    From each sample to the next it keeps the value (hold="zero", as a converter puts out), or goes in a straight line
    (hold="linear"). The last value of hold="zero" lasts as long as the one before it. Nothing is known outside these
    times: a scene that begins earlier or ends later is refused. Steps of a simulation end at every sample, so that none
    goes over a jump or a bend.

    Attributes:
        times: (T,) s, ascending, at least two.
        values: (T,) in the unit of the driven quantity.
        hold: "zero" or "linear".

    Raises:
        ValueError: one line with field, value and what is allowed.
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
        """Reads a column in a unit, or one that is a part of it; see `read_time_series`."""
        record = read_time_series(path)
        return cls(record.times, record.values((unit,), [column])[:, 0], hold)

    @property
    def largest(self) -> float:
        """The value of largest size."""
        return max(self.values, key=abs)

    @property
    def end(self) -> float:
        """Time until which it is known, s."""
        return self.times[-1] + (self.times[-1] - self.times[-2] if self.hold == "zero" else 0.0)

    def lines(self, moments: Array) -> tuple[Array, Array]:
        """Gives value at time 0 and slope (per s) of the straight line on which it is at moments (p,) s."""
        times, values = np.array(self.times), np.array(self.values)
        j = np.clip(np.searchsorted(times, moments, "right") - 1, 0, len(times) - 1)
        if self.hold == "zero":
            return values[j], np.zeros(len(moments))
        j = np.minimum(j, len(times) - 2)
        slopes = (values[j + 1] - values[j]) / (times[j + 1] - times[j])
        return values[j] - slopes * times[j], slopes


@dataclass(frozen=True)
class SampledTorque:
    """Torques of n motors (of the links where joints are rigid) that are known at T moments; see `SampledSignal`.

    Attributes:
        times: (T,) s, ascending, at least two.
        values: (T, n) N m.
        hold: "zero" or "linear".

    Raises:
        ValueError: one line with field, value and what is allowed.

    Examples:
        >>> torque = fm.SampledTorque(times=[0.0, 0.5, 1.0], values=[[0.1], [-0.1], [0.0]], hold="zero")
        >>> torque.times
        (0.0, 0.5, 1.0)
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
        """Reads a CSV file with a head such as "time (s),torque_1 (N m)"; see `read_time_series`.

        Args:
            path: of the file.
            columns: names, such as "torque_1", in the order of the joints; None takes all torques of the file.
            hold: "zero" or "linear".

        Raises:
            FileNotFoundError, ValueError: one line, see `read_time_series`.
        """
        record = read_time_series(path)
        return cls(record.times, record.values(("N m",), columns), hold)  # type: ignore[arg-type]

    @classmethod
    def from_function(
        cls, function: Callable[[float], Vector], duration: float, period: float, hold: str = "linear"
    ) -> Self:
        """Samples a function of time, s, that gives torques (n,) N m, once every period (s) until the duration (s).

        The function is called once a sample, before the simulation, and not in the steps of a method. A simulation then
        stops at every sample, which takes 30 us of one core beside the steps and what the function takes, whatever the
        arm. Between samples a straight line is off by at most period^2 / 8 times the second derivative.

        Raises:
            ValueError: for a period that does not divide the duration, and for what is no torque.
        """
        allowed = "a number of seconds that divides the duration"
        count = whole_ratio("period", positive("period", period, "s"), positive("duration", duration, "s"), allowed)
        if count >= MAX_ENTRIES:
            raise value_error("period", period, f"at most {MAX_ENTRIES} samples in {duration} s")
        times = np.linspace(0.0, duration, count + 1)
        return cls(times, [function(time) for time in times.tolist()], hold)

    def to_csv(self, path: str | Path) -> None:
        """Writes a file from which `from_csv` gives an equal one, but for the hold."""
        write_csv(path, {"time (s)": self.times, **_heads("torque", "N m", self.values)})

    def signals(self) -> list[Any]:
        """Gives the torque of each motor, n of them."""
        return [SampledSignal(self.times, column, self.hold) for column in np.array(self.values).T]

    def at(self, time: float) -> NDArray[np.float64]:
        """Gives the torques (n,) in N m at a time in s; raises ValueError for one at which they are not known."""
        signals = self.signals()
        if not self.times[0] <= time <= signals[0].end:
            raise value_error("time", time, f"one from {self.times[0]} to {signals[0].end} (s)")
        lines = np.array([signal.lines(np.array([time])) for signal in signals])
        result: NDArray[np.float64] = lines[:, 0, 0] + lines[:, 1, 0] * time
        return result


@dataclass(frozen=True)
class SampledAngles:
    """The motion of a prescribed motor (a joint where it is rigid), known by its angles at T moments.

    The motor moves along a cubic spline, twice smoothly differentiable: through the angles, or near them where these
    have noise. It starts at the angle and rate of the spline, whatever `Initial` says of this joint. Where angles are
    exact samples of a smooth motion, the spline is off by a part of the interval to the fourth power.

    Attributes:
        times: (T,) s, ascending, at least four.
        angles: (T,) rad.
        deviation: rad, standard deviation of the noise or rounding of the angles. With one, the spline has as few
            pieces as leave it so far from the angles (FITPACK's smoothing); 0 goes through all of them, and what two
            derivatives make of an encoder's rounding shakes the arm.

    Raises:
        ValueError: one line with field, value and what is allowed.
    """

    times: Vector
    angles: Vector
    deviation: float = 0.0

    def __post_init__(self) -> None:
        times = _moments("SampledAngles.times", self.times)
        angles = number_array("SampledAngles.angles", self.angles, times.shape, f"{len(times)} finite numbers (rad)")
        if len(times) < LEAST_OF_SPLINE:
            raise value_error("SampledAngles.times", self.times, f"at least {LEAST_OF_SPLINE} times (s)")
        deviation = non_negative("SampledAngles.deviation", self.deviation, "rad")
        set_fields(self, times=tuple(times.tolist()), angles=tuple(angles.tolist()), deviation=deviation)

    @classmethod
    def from_csv(cls, path: str | Path, column: str, deviation: float = 0.0) -> Self:
        """Reads a column of angles of a CSV file, such as "hub" of "time (s),hub (deg)"; see `read_time_series`."""
        record = read_time_series(path)
        return cls(record.times, record.values(("rad",), [column])[:, 0], deviation)

    @cached_property
    def _spline(self) -> tuple[Any, Array]:
        """The spline, and the times at which its pieces meet."""
        from scipy.interpolate import CubicSpline, UnivariateSpline  # a third of a second, which few need

        if self.deviation == 0.0:
            return CubicSpline(self.times, self.angles), np.array(self.times)
        weights = np.full(len(self.times), 1.0 / self.deviation)
        spline = UnivariateSpline(self.times, self.angles, weights, k=3, s=float(len(weights)))
        return spline, np.array(spline.get_knots())

    @property
    def acceleration(self) -> SampledSignal:
        """The acceleration, rad/s^2: straight lines between the ends of the pieces of the spline."""
        spline, knots = self._spline
        return SampledSignal(knots, spline.derivative(2)(knots), "linear")

    def start(self, time: float = 0.0) -> tuple[float, float]:
        """Gives angle (rad) and rate (rad/s) of the spline at a time (s)."""
        spline, _ = self._spline
        return float(spline(time)), float(spline.derivative()(time))


def _heads(name: str, unit: str, values: Sequence[Vector]) -> dict[str, Any]:
    """Columns by heads that count from 1."""
    return {f"{name}_{i} ({unit})": column for i, column in enumerate(zip(*values, strict=True), 1)}


def _moments(name: str, value: object) -> Array:
    """Times (T,) in ascending order."""
    allowed = f"2 to {MAX_ENTRIES} finite numbers (s), each larger than the one before"
    count = len(value) if isinstance(value, list | tuple | np.ndarray) else 0
    times = number_array(name, value, (count,), allowed) if 2 <= count <= MAX_ENTRIES else np.zeros(2)
    if not (np.diff(times) > 0.0).all():
        raise value_error(name, value, allowed)
    return times


def _rows(name: str, value: object, count: int) -> Array:
    """Values (T, n)."""
    allowed = f"{count} lists of finite numbers (N m), one for each time, all of the same length"
    try:
        joints = len(value[0])  # type: ignore[index]
    except Exception:  # nothing that has a first list
        joints = 0
    if joints < 1:
        raise value_error(name, value, allowed)
    return number_array(name, value, (count, joints), allowed)


SAME = 1e-12  # of the duration: moments that are one


@dataclass(frozen=True)
class Signal:
    """A sine with an offset: offset + amplitude sin(2 pi frequency_hz t + phase) for start <= t < stop, and 0 outside.

    Attributes:
        offset: mean, in the unit of the driven quantity.
        amplitude: in that unit.
        frequency_hz: Hz, >= 0.
        phase: rad.
        start: s, >= 0.
        stop: s, > start; None for a signal without end.

    Raises:
        ValueError: for a number that is not finite or outside its range.
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
        """Gives its column (7,) in the table of a drive, see `kernels.layout`."""
        stop = math.inf if self.stop is None else self.stop
        return np.array([self.offset, self.amplitude, self.frequency_hz, self.phase, self.start, stop, 0.0])

    @property
    def largest(self) -> float:
        """The larger one of offset and amplitude."""
        return max(self.offset, self.amplitude, key=abs)


@dataclass(frozen=True)
class ConstantTorque:
    """Torques that do not change, on the motors (on the links where joints are rigid).

    Attributes:
        value: (n,) N m.

    Raises:
        ValueError: for a value that is not a list of finite numbers.
    """

    kind: ClassVar[str] = "constant"
    value: Vector

    def __post_init__(self) -> None:
        set_fields(self, value=vector("ConstantTorque.value", self.value, unit="N m"))

    def signals(self) -> list[Signal | SampledSignal]:
        """Gives the torque of each motor as a Signal, n of them."""
        return [Signal(value) for value in self.value]

    def at(self, time: float) -> NDArray[np.float64]:
        """Gives the torques (n,) in N m at a time in s."""
        return np.array(self.value)


@dataclass(frozen=True)
class SineTorque:
    """Torques amplitude sin(2 pi frequency_hz t + phase), on the motors (on the links where joints are rigid).

    Attributes:
        amplitude: (n,) N m.
        frequency_hz: (n,) Hz, >= 0.
        phase: (n,) rad.

    Raises:
        ValueError: for an attribute that is not a list of finite numbers, for lists of different length, and for a
            negative frequency.
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
        """Gives the torque of each motor as a Signal, n of them."""
        return [Signal(0.0, *numbers) for numbers in zip(self.amplitude, self.frequency_hz, self.phase, strict=True)]

    def at(self, time: float) -> NDArray[np.float64]:
        """Gives the torques (n,) in N m at a time in s."""
        return self.amplitude * np.sin(2.0 * np.pi * time * np.array(self.frequency_hz) + self.phase)


def signal_table(drives: Sequence[Signal | None]) -> NDArray[np.float64]:
    """Gives the table (7, n + 6) of a drive from its n + 6 signals; None stands for a signal that is always zero."""
    return np.column_stack([(drive or Signal()).column() for drive in drives])


class PiecewiseSignals:
    """A drive from 0 s to a duration as a table for each piece of this time, in which no sample ends.

    Attributes:
        moments: (p + 1,) s, where the p pieces begin and end; one piece for a drive without samples.
    """

    def __init__(self, drives: Sequence[Signal | SampledSignal | None], duration: float) -> None:
        sampled = {i: drive for i, drive in enumerate(drives) if isinstance(drive, SampledSignal)}
        self._table = signal_table([None if isinstance(drive, SampledSignal) else drive for drive in drives])
        moments = np.unique(np.concatenate([[0.0, duration], *(drive.times for drive in sampled.values())]))
        moments = moments[(moments >= 0.0) & (moments <= duration)]
        apart = np.append(True, np.diff(moments) > SAME * duration)
        self.moments = moments[apart] if apart[-1] else np.append(moments[apart][:-1], duration)
        middles = 0.5 * (self.moments[1:] + self.moments[:-1])
        self._lines: dict[int, tuple[Array, Array]] = {i: drive.lines(middles) for i, drive in sampled.items()}

    def table(self, piece: int = 0) -> NDArray[np.float64]:
        """Gives the table (7, n + 6) of a piece, see `kernels.layout`."""
        result = self._table.copy()
        for i, (values, slopes) in self._lines.items():
            result[0, i], result[-1, i] = values[piece], slopes[piece]
        return result

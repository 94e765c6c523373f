"""Drive: motor torques, prescribed motions and disturbances as functions of time."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from flexman_gym.arrays import Array, Vector
from flexman_gym.checks import finite, non_negative, refusal, sequence, store, vector
from flexman_gym.scene.samples import SampledSignal

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
        store(self, **{name: finite(f"Signal.{name}", getattr(self, name)) for name in names})
        store(self, frequency_hz=non_negative("Signal.frequency_hz", self.frequency_hz, "Hz"))
        store(self, start=non_negative("Signal.start", self.start, "s"))
        if self.stop is not None:
            store(self, stop=finite("Signal.stop", self.stop, "s"))
            if self.stop <= self.start:
                raise refusal("Signal.stop", self.stop, f"a time after the start {self.start} (s), or None")

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
        store(self, value=vector("ConstantTorque.value", self.value, unit="N m"))

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
        store(self, amplitude=amplitude, frequency_hz=frequency_hz, phase=phase)

    def signals(self) -> list[Signal | SampledSignal]:
        """Gives the torque of each motor as a Signal, n of them."""
        return [Signal(0.0, *numbers) for numbers in zip(self.amplitude, self.frequency_hz, self.phase, strict=True)]

    def at(self, time: float) -> NDArray[np.float64]:
        """Gives the torques (n,) in N m at a time in s."""
        return self.amplitude * np.sin(2.0 * np.pi * time * np.array(self.frequency_hz) + self.phase)


def signals(name: str, value: object, units: str) -> tuple[Signal | SampledSignal, ...] | None:
    """Checks the three signals of the components of a vector in the base frame, or None.

    Args:
        name: of the field, for the error.
        value: None, or three of Signal or SampledSignal along x, y and z; they come back as a tuple.
        units: of the vector, for the error.

    Raises:
        ValueError: for any other value.
    """
    if value is None:
        return None
    allowed = f"None or three of Signal or SampledSignal, along x, y and z ({units})"
    items = tuple(sequence(name, value, allowed))
    if len(items) != 3 or not all(isinstance(item, Signal | SampledSignal) for item in items):
        raise refusal(name, value, allowed)
    return items


def drive_table(drives: Sequence[Signal | None]) -> NDArray[np.float64]:
    """Gives the table (7, n + 6) of a drive from its n + 6 signals; None stands for a signal that is always zero."""
    return np.column_stack([(drive or Signal()).column() for drive in drives])


class Pieces:
    """A drive from 0 s to a duration as a table for each piece of this time, in which no sample ends.

    Attributes:
        moments: (p + 1,) s, where the p pieces begin and end; one piece for a drive without samples.
    """

    def __init__(self, drives: Sequence[Signal | SampledSignal | None], duration: float) -> None:
        sampled = {i: drive for i, drive in enumerate(drives) if isinstance(drive, SampledSignal)}
        self._table = drive_table([None if isinstance(drive, SampledSignal) else drive for drive in drives])
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

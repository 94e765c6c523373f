"""Drive: motor torques, prescribed motions and disturbances as functions of time."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from flexman_gym.arrays import Vector
from flexman_gym.checks import finite, non_negative, refusal, sequence, store, vector


@dataclass(frozen=True)
class Signal:
    """A sine with an offset: offset + amplitude sin(2 pi frequency_hz t + phase) for start <= t < stop, and 0 outside.

    Attributes:
        offset, amplitude: in the unit of the driven quantity.
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
        """Gives its column (6,) in the table of a drive, see `kernels.layout`."""
        stop = math.inf if self.stop is None else self.stop
        return np.array([self.offset, self.amplitude, self.frequency_hz, self.phase, self.start, stop])


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

    def signals(self) -> list[Signal]:
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

    def signals(self) -> list[Signal]:
        """Gives the torque of each motor as a Signal, n of them."""
        return [Signal(0.0, *numbers) for numbers in zip(self.amplitude, self.frequency_hz, self.phase, strict=True)]

    def at(self, time: float) -> NDArray[np.float64]:
        """Gives the torques (n,) in N m at a time in s."""
        return self.amplitude * np.sin(2.0 * np.pi * time * np.array(self.frequency_hz) + self.phase)


def signals(name: str, value: object, units: str) -> tuple[Signal, ...] | None:
    """Checks the three signals of the components of a vector in the base frame, or None.

    Args:
        name: of the field, for the error.
        value: None, or three of Signal along x, y and z; they come back as a tuple.
        units: of the vector, for the error.

    Raises:
        ValueError: for any other value.
    """
    if value is None:
        return None
    allowed = f"None or three of Signal, along x, y and z ({units})"
    items = tuple(sequence(name, value, allowed))
    if len(items) != 3 or not all(isinstance(item, Signal) for item in items):
        raise refusal(name, value, allowed)
    return items


def drive_table(drives: Sequence[Signal | None]) -> NDArray[np.float64]:
    """Gives the table (6, n + 6) of a drive from its n + 6 signals; None stands for a signal that is always zero."""
    return np.column_stack([(drive or Signal()).column() for drive in drives])

"""Instrument: a sensor with noise, bias, quantisation, delay, slow sampling or dropped samples."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from typing import Any, Self

import numpy as np

from flexman_gym.common.arrays import Array, IntArray
from flexman_gym.common.checks import non_negative, set_fields, value_error, whole_number
from flexman_gym.envs.limits import Limits
from flexman_gym.envs.random_streams import TruncatedNoise
from flexman_gym.envs.sensors.sensor import DEFAULT_QUANTITIES, Entry, MeasuredView, Sensor
from flexman_gym.envs.view import View

MIN_QUANTISATION = 1e-12  # fraction of the range; smallest quantisation step
MAX_PERIODS = 1000  # control periods; largest delay, and longest time between two samples


@dataclass(frozen=True, eq=False)
class Flaws:
    """Flaws of an instrument; fractions are fractions of the measurement range of each quantity.

    Attributes:
        noise: standard deviation of the normal noise on each sample, a fraction; truncated at 4 standard deviations.
        bias: largest magnitude of the bias, a fraction; the bias is drawn uniformly once per episode.
        quantisation: quantisation step, a fraction.
        delay: control periods until a sample arrives; before the first arrival the first sample is read.
        every: control periods between two samples.
        dropped: probability of losing a sample, in whose place the previous sample is read.
    """

    noise: float = 0.0
    bias: float = 0.0
    quantisation: float = 0.0
    delay: int = 0
    every: int = 1
    dropped: float = 0.0

    def __post_init__(self) -> None:
        for name in ("noise", "bias", "quantisation", "dropped"):
            part = non_negative(f"sensors.{name}", getattr(self, name))
            if part > 1.0:
                raise value_error(f"sensors.{name}", part, "a fraction from 0 to 1")
            set_fields(self, **{name: part})
        if 0.0 < self.quantisation < MIN_QUANTISATION:
            raise value_error(
                "sensors.quantisation", self.quantisation, f"0, or a fraction from {MIN_QUANTISATION:g} to 1"
            )
        set_fields(self, delay=whole_number("sensors.delay", self.delay, 0, MAX_PERIODS))
        set_fields(self, every=whole_number("sensors.every", self.every, 1, MAX_PERIODS))
        if self.dropped >= 1.0:
            raise value_error("sensors.dropped", self.dropped, "a probability from 0 to below 1")


FLAWS = tuple(each.name for each in fields(Flaws))
"""Names of the flaws of a sensor, see `Flaws`."""


class Instrument:
    """Sensor with flaws: `Instrument(FullState(), noise=0.001, delay=1)`.

    The flaws act on the quantities named in the sensor's attribute `measures`, by default motion, tip and deflection,
    before errors and other quantities are derived from them. Repeated readings in one control period are equal.

    Args:
        sensor: sensor without flaws.
        **flaws: arguments of `Flaws`.

    Raises:
        ValueError: for flaws that are not allowed, and for a sensor without measured quantities.
    """

    state_fields = ("measured", "_held", "_late", "_bias", "_ages", "_noise")

    def __init__(self, sensor: Sensor, **flaws: Any) -> None:
        self.sensor, self.flaws = sensor, Flaws(**flaws)
        self.measures = tuple(getattr(sensor, "measures", DEFAULT_QUANTITIES))
        if not self.measures:
            raise value_error("sensors", sensor, "a sensor that measures: a command has neither noise nor delay")

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Instrument) and self.settings() == other.settings() and self.sensor == other.sensor

    __hash__ = None  # type: ignore[assignment]

    def settings(self) -> Mapping[str, float]:
        """Return the flaws that differ from the defaults, by name."""
        return {name: getattr(self.flaws, name) for name in FLAWS if getattr(self.flaws, name) != getattr(Flaws, name)}

    def copy(self) -> Self:
        """Return an equal instrument without stored samples."""
        return type(self)(self.sensor, **self.settings())

    def entries(self, view: View, limits: Limits) -> Sequence[Entry]:
        """Return the entries of the sensor without flaws, and allocate the stored samples."""
        arms, flaws = len(view.motion), self.flaws
        self.measured = MeasuredView(view, limits, self.measures)
        size = len(self.measured.bound)
        self._held, self._bias = np.zeros((arms, size)), np.zeros((arms, size))
        self._late = np.zeros((flaws.delay, arms, size))  # delayed samples, the oldest first
        self._ages, self._noise = np.zeros(arms, dtype=np.int64), TruncatedNoise(arms, size + 1)
        return self.sensor.entries(self.measured, limits)  # type: ignore[arg-type]

    def begin(self, arm: int, stream: np.random.Generator) -> None:
        """Start an episode of an arm, with two draws from its random stream."""
        self._noise.begin(arm, stream)
        inner = np.random.default_rng(stream.integers(2**63))
        bound = self.measured.bound
        self._bias[arm] = self.flaws.bias * bound * inner.uniform(-1.0, 1.0, len(bound))
        self._ages[arm] = 0

    def sample(self, arms: IntArray) -> None:
        """Sample the arms with the indices (r,): once at the start of an episode and once per control period."""
        if not len(arms):
            return
        measured, flaws = self.measured, self.flaws
        at: Any = slice(None) if len(arms) == len(self._ages) else arms  # a slice avoids a copy
        first = self._ages[at] == 0
        measured.copy_true(at)
        new, taken = measured.values[at], self._ages[at] % flaws.every == 0
        if flaws.bias:
            new = new + self._bias[at]
        if flaws.noise or flaws.dropped:
            drawn = self._noise.sample(arms)
            new = new + flaws.noise * measured.bound * drawn[:, :-1]
            taken &= first | (TruncatedNoise.uniform(drawn[:, -1]) >= flaws.dropped)
        if flaws.quantisation:
            step = flaws.quantisation * measured.bound
            new = np.round(new / step) * step
        self._held[at] = np.where(taken[:, None], new, self._held[at])
        self._ages[at] += 1
        measured.values[at] = self._delayed(at, first)
        measured.clip()

    def _delayed(self, at: Any, first: Array) -> Array:
        """Return the samples (r, size) that arrive in this control period, and store the new samples."""
        late, held = self._late, self._held[at]
        if not self.flaws.delay:
            return held
        if first.any():
            late[:, at] = np.where(first[:, None], held, late[:, at])
        result = late[0, at].copy()
        late[:-1, at] = late[1:, at]
        late[-1, at] = held
        return result

    def read(self, view: View, out: Array) -> None:
        """Write the readings, computed by the sensor from the measured quantities, into out (b, size)."""
        self.sensor.read(self.measured, out)  # type: ignore[arg-type]

    def refresh(self) -> None:
        """Derive quantities again after the state was replaced."""
        self.measured.refresh()

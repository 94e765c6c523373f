"""Instrument: a sensor with the flaws of a real one, which act on what is measured before anything is derived."""

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

MIN_QUANTISATION = 1e-12  # quantisation, a part
MOST_PERIODS = 1000  # of a delay or between two samples


@dataclass(frozen=True, eq=False)
class Flaws:
    """How an instrument differs from a perfect one. Parts are parts of the range of each quantity.

    Attributes:
        noise: standard deviation of normal noise on each sample, a part; numbers beyond 4 of them are drawn again.
        bias: a part up to which, to either side, each quantity is off throughout an episode.
        quantisation: the step between two numbers that it can give, a part.
        delay: control periods after which a sample arrives; until the first has arrived, the first counts.
        every: control periods between two samples.
        dropped: probability that a sample is lost; the one before then counts.

    Raises:
        ValueError: one line with field, value and what is allowed.
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
                raise value_error(f"sensors.{name}", part, "a part from 0 to 1")
            set_fields(self, **{name: part})
        if 0.0 < self.quantisation < MIN_QUANTISATION:
            raise value_error("sensors.quantisation", self.quantisation, f"0, or a part from {MIN_QUANTISATION:g} to 1")
        set_fields(self, delay=whole_number("sensors.delay", self.delay, 0, MOST_PERIODS))
        set_fields(self, every=whole_number("sensors.every", self.every, 1, MOST_PERIODS))
        if self.dropped >= 1.0:
            raise value_error("sensors.dropped", self.dropped, "a probability from 0 to below 1")


FLAWS = tuple(each.name for each in fields(Flaws))
"""Names of the flaws that a sensor may have, see `Flaws`."""


class Instrument:
    """A sensor with flaws: `Instrument(FullState(), noise=0.001, delay=1)`.

    What the sensor names in `measures` passes the instrument; without such a list all that the view has of motion, tip
    and deflection. One that is read several times in a control period gives the same each time.

    Args:
        sensor: a Sensor, perhaps one of your own.
        flaws: see `Flaws`.

    Raises:
        ValueError: one line, for a flaw that there is not, and for a sensor that measures nothing.
    """

    state_fields = ("measured", "_held", "_late", "_bias", "_ages", "_noise")

    def __init__(self, sensor: Sensor, **flaws: Any) -> None:
        self.sensor, self.flaws = sensor, Flaws(**flaws)
        self.measures = tuple(getattr(sensor, "measures", DEFAULT_QUANTITIES))
        if not self.measures:
            raise value_error(
                "sensors", sensor, "a sensor that measures: a command has no noise and does not come late"
            )

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Instrument) and self.settings() == other.settings() and self.sensor == other.sensor

    __hash__ = None  # type: ignore[assignment]

    def settings(self) -> Mapping[str, float]:
        """The flaws that it has, by name."""
        return {name: getattr(self.flaws, name) for name in FLAWS if getattr(self.flaws, name) != getattr(Flaws, name)}

    def fresh(self) -> Self:
        """An instrument alike that remembers nothing."""
        return type(self)(self.sensor, **self.settings())

    def entries(self, view: View, limits: Limits) -> Sequence[Entry]:
        """Says what the sensor reads."""
        arms, flaws = len(view.motion), self.flaws
        self.measured = MeasuredView(view, limits, self.measures)
        size = len(self.measured.bound)
        self._held, self._bias = np.zeros((arms, size)), np.zeros((arms, size))
        self._late = np.zeros((flaws.delay, arms, size))  # samples on their way, the oldest first
        self._ages, self._noise = np.zeros(arms, dtype=np.int64), TruncatedNoise(arms, size + 1)
        return self.sensor.entries(self.measured, limits)  # type: ignore[arg-type]

    def begin(self, arm: int, stream: np.random.Generator) -> None:
        """Starts an episode of an arm by two draws of its stream."""
        self._noise.begin(arm, stream)
        inner = np.random.default_rng(stream.integers(2**63))
        bound = self.measured.bound
        self._bias[arm] = self.flaws.bias * bound * inner.uniform(-1.0, 1.0, len(bound))
        self._ages[arm] = 0

    def sample(self, arms: IntArray) -> None:
        """Measures some arms (r,), once a control period, the first time at the start of their episodes."""
        if not len(arms):
            return
        measured, flaws = self.measured, self.flaws
        at: Any = slice(None) if len(arms) == len(self._ages) else arms  # a slice copies less
        first = self._ages[at] == 0
        measured.take(at)
        new, taken = measured.values[at], self._ages[at] % flaws.every == 0
        if flaws.bias:
            new = new + self._bias[at]
        if flaws.noise or flaws.dropped:
            drawn = self._noise.sample(arms)
            new = new + flaws.noise * measured.bound * drawn[:, :-1]
            taken &= first | (_uniform(drawn[:, -1]) >= flaws.dropped)
        if flaws.quantisation:
            step = flaws.quantisation * measured.bound
            new = np.round(new / step) * step
        self._held[at] = np.where(taken[:, None], new, self._held[at])
        self._ages[at] += 1
        measured.values[at] = self._arriving(at, first)
        measured.settle()

    def _arriving(self, at: Any, first: Array) -> Array:
        """The samples (r, size) that arrive now; those of this period set off."""
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
        """Writes what the sensor reads of what was measured."""
        self.sensor.read(self.measured, out)  # type: ignore[arg-type]

    def renew(self) -> None:
        """Derives anew, after what it keeps was given back."""
        self.measured.renew()


def _uniform(normal: Array) -> Array:
    """Numbers evenly spread from 0 to 1 of normal ones, by their distribution."""
    from scipy.special import ndtr

    result: Array = ndtr(normal)
    return result

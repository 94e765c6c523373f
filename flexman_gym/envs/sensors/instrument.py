"""Instrument: a sensor with noise, bias, quantisation, delay, slow sampling or dropped samples."""

from collections.abc import Mapping, Sequence
from typing import Any, Self

import numpy as np

from flexman_gym.common.arrays import Array, IntArray
from flexman_gym.common.errors import value_error
from flexman_gym.envs.limits import Limits
from flexman_gym.envs.random_streams import TruncatedNoise
from flexman_gym.envs.sensors.flaws import AMOUNTS, FLAWS, Flaws
from flexman_gym.envs.sensors.sensor import DEFAULT_QUANTITIES, Entry, MeasuredView, Sensor
from flexman_gym.envs.view import View


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

    def settings(self) -> Mapping[str, Any]:
        """Return the flaws that differ from the defaults, by name."""
        return {name: getattr(self.flaws, name) for name in FLAWS if getattr(self.flaws, name) != getattr(Flaws, name)}

    def copy(self) -> Self:
        """Return an equal instrument without stored samples."""
        return type(self)(self.sensor, **self.settings())

    def entries(self, view: View, limits: Limits) -> Sequence[Entry]:
        """Return the entries of the sensor without flaws, and allocate the stored samples."""
        arms, flaws = len(view.motion), self.flaws
        self.measured = MeasuredView(view, limits, self.measures)
        size, units, bound = len(self.measured.bound), self.measured.value_units, self.measured.bound
        flaws.check_units(units)
        turns = self.measured.value_turns
        self._errors = {name: flaws.fraction(name, units, bound, turns) * bound for name in AMOUNTS}
        self._held, self._bias = np.zeros((arms, size)), np.zeros((arms, size))
        self._late = np.zeros((flaws.delay, arms, size))  # delayed samples, the oldest first
        self._ages, self._noise = np.zeros(arms, dtype=np.int64), TruncatedNoise(arms, size + 1)
        return self.sensor.entries(self.measured, limits)  # type: ignore[arg-type]

    def begin(self, arm: int, stream: np.random.Generator) -> None:
        """Start an episode of an arm, with two draws from its random stream."""
        self._noise.begin(arm, stream)
        inner = np.random.default_rng(stream.integers(2**63))
        largest = self._errors["bias"]
        self._bias[arm] = largest * inner.uniform(-1.0, 1.0, len(largest))
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
            new = new + self._errors["noise"] * drawn[:, :-1]
            taken &= first | (TruncatedNoise.uniform(drawn[:, -1]) >= flaws.dropped)
        if flaws.quantisation:
            step = self._errors["quantisation"]
            coarse = np.where(step > 0.0, step, 1.0)
            new = np.where(step > 0.0, np.round(new / coarse) * coarse, new)
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

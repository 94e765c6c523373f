"""Sensor array: several sensors side by side, which make up an observation."""

from collections.abc import Sequence
from copy import copy
from typing import Any

import numpy as np

from flexman_gym.common.arrays import Array, IntArray
from flexman_gym.common.checks import check_member_names, value_error
from flexman_gym.envs.limits import Limits
from flexman_gym.envs.random_streams import RandomStreams
from flexman_gym.envs.sensors.instrument import Instrument
from flexman_gym.envs.sensors.sensor import DEFAULT_QUANTITIES, Sensor, derived_quantities
from flexman_gym.envs.view import View


class SensorArray:
    """Sensors side by side.

    Args:
        parts: Sensors, of which it takes copies.
        view: what they read, a View or what is measured of it.
        limits: of the arm.
        label: by which their random streams are known.
        beside: the Sensors of an agent. Perfect sensors here read what instruments here measure, or else those of the
            agent do; an entry that two of them read is that of the first.

    Attributes:
        slices: name -> slice of the observation.
        units: name -> unit.
        bound: (size,) largest magnitude of each number.
        observations: (b, size) of the last reading, which the next one overwrites.
        readings: name -> (b, ...) its part of that entry.
        shared: a view in which each quantity is what the first of the sensors measures of it.

    Raises:
        ValueError: for something else than sensors, and for two entries of one name.
    """

    state_fields = ("_instruments", "_streams")

    def __init__(
        self,
        parts: Sequence[object],
        view: View,
        limits: Limits,
        label: str = "sensors",
        beside: "SensorArray | None" = None,
    ) -> None:
        self.slices: dict[str, slice] = {}
        self.units: dict[str, str] = {}
        self._instruments: list[Instrument] = []
        places: list[tuple[Sensor, slice]] = []
        bounds, end = [np.zeros(0)], 0
        copies = [_own(part) for part in parts]
        seen: Any = view
        if beside:
            seen = _SharedView(beside.shared, [own for own in copies if isinstance(own, Instrument)])
        for own in copies:
            first = end
            for name, size, unit, bound in own.entries(view if isinstance(own, Instrument) else seen, limits):
                if name in self.slices and not beside:
                    raise value_error("sensors", name, "every entry once: two of them read this")
                if name not in self.slices:
                    self.slices[name], self.units[name] = slice(end, end + size), unit
                end += size
                bounds.append(np.ones(size) * np.asarray(bound))
            places.append((own, slice(first, end)))
            self._instruments += [own] if isinstance(own, Instrument) else []
        self.bound: Array = np.concatenate(bounds)
        self.observations = np.zeros((len(view.motion), end))
        self.readings = {name: self.observations[:, place] for name, place in self.slices.items()}
        self.shared: Any = _SharedView(view, [own for own, _ in places])
        self._view, self._outs = seen, [(part, self.observations[:, place]) for part, place in places]
        self._streams = RandomStreams([f"{label}.{i}" for i in range(len(self._instruments))], len(view.motion))

    def begin(self, arms: IntArray, randoms: Sequence[np.random.Generator]) -> None:
        """Starts new episodes of the arms (r,), each with the generator of its environment, and measures them."""
        for arm, random in zip(arms.tolist(), randoms, strict=True):
            streams = self._streams.of(arm, random).values()
            for instrument, stream in zip(self._instruments, streams, strict=True):
                instrument.begin(arm, stream)
        self.sample(arms)

    def sample(self, arms: IntArray) -> None:
        """Measures the arms (r,), once a control period."""
        for instrument in self._instruments:
            instrument.sample(arms)

    def read(self) -> None:
        """Reads all arms, as they were measured."""
        for part, out in self._outs:
            part.read(self._view, out)

    def renew(self, randoms: Sequence[np.random.Generator | None]) -> None:
        """Reads anew, after what instruments keep and the generators of all arms were given back."""
        self._streams.follow(randoms)
        for instrument in self._instruments:
            instrument.renew()
        self.read()


def _own(part: object) -> Any:
    """A copy of a sensor."""
    if not isinstance(part, Sensor):
        raise value_error("sensors", part, "a Sensor: an object with the methods entries and read")
    check_member_names("sensors", part, ("measures",), ("measured",))
    return part.fresh() if isinstance(part, Instrument) else copy(part)


class _SharedView:
    """A view of which the quantities that sensors measure are as their instruments give them, the rest as it is.

    Where two sensors measure a quantity, the first counts.
    """

    def __init__(self, view: View, parts: Sequence[object]) -> None:
        self._view, self._sources = view, dict[str, object]()
        for part in parts:
            source = part if isinstance(part, Instrument) else view
            for name in derived_quantities(getattr(part, "measures", DEFAULT_QUANTITIES), view):
                self._sources.setdefault(name, source)

    def __getattr__(self, name: str) -> Any:
        source = self.__dict__["_sources"].get(name, self.__dict__["_view"])
        return getattr(source.measured if isinstance(source, Instrument) else source, name)


def measured_names(parts: Sequence[object]) -> list[str]:
    """Names of all that sensors measure."""
    return [name for part in parts for name in getattr(part, "measures", DEFAULT_QUANTITIES)]

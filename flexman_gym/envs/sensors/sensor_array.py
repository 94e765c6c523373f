"""Sensor array: several sensors side by side, which form an observation."""

from collections.abc import Sequence
from copy import copy
from typing import Any

import numpy as np

from flexman_gym.common.arrays import Array, IntArray
from flexman_gym.common.checks import check_member_names, value_error
from flexman_gym.envs.limits import Limits
from flexman_gym.envs.random_streams import RandomStreams
from flexman_gym.envs.sensors.instrument import Instrument
from flexman_gym.envs.sensors.sensor import DEFAULT_QUANTITIES, DERIVED, Sensor
from flexman_gym.envs.view import View


class SensorArray:
    """Sensors side by side.

    Args:
        parts: Sensors, which are copied.
        view: a View, or the view of its measured quantities.
        limits: limits of the arm.
        label: name that seeds the random streams of the instruments.
        agent_sensors: sensors of the agent. Ideal sensors here read the quantities measured by an instrument here or,
            if there is none, by the agent's sensors; of two entries with the same name the first counts.

    Attributes:
        slices: name -> slice of the observation.
        units: name -> unit.
        bound: (size,) largest magnitude of each value.
        observations: (b, size) last readings; the next reading overwrites them.
        readings: name -> (b, ...) its part of the observations.
        shared: view in which each quantity is the one measured by the first of the sensors.

    Raises:
        ValueError: for an object that is not a sensor, and for two entries with the same name.
    """

    state_fields = ("_instruments", "_streams")

    def __init__(
        self,
        parts: Sequence[object],
        view: View,
        limits: Limits,
        label: str = "sensors",
        agent_sensors: "SensorArray | None" = None,
    ) -> None:
        self.slices: dict[str, slice] = {}
        self.units: dict[str, str] = {}
        self._instruments: list[Instrument] = []
        places: list[tuple[Sensor, slice]] = []
        bounds, end = [np.zeros(0)], 0
        copies = [_copy_sensor(part) for part in parts]
        seen: Any = view
        if agent_sensors:
            seen = _SharedView(agent_sensors.shared, [own for own in copies if isinstance(own, Instrument)])
        for own in copies:
            first = end
            for name, size, unit, bound in own.entries(view if isinstance(own, Instrument) else seen, limits):
                if name in self.slices and not agent_sensors:
                    raise value_error("sensors", name, "each entry once: two sensors have it")
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
        """Start new episodes of the arms (r,), each with the generator of its environment, and sample them."""
        for arm, random in zip(arms.tolist(), randoms, strict=True):
            streams = self._streams.generators(arm, random).values()
            for instrument, stream in zip(self._instruments, streams, strict=True):
                instrument.begin(arm, stream)
        self.sample(arms)

    def sample(self, arms: IntArray) -> None:
        """Sample the arms (r,), once per control period."""
        for instrument in self._instruments:
            instrument.sample(arms)

    def read(self) -> None:
        """Read the present samples of all arms."""
        for part, out in self._outs:
            part.read(self._view, out)

    def refresh(self, randoms: Sequence[np.random.Generator | None]) -> None:
        """Read again after the stored state and the generators of all arms were replaced."""
        self._streams.set_generators(randoms)
        for instrument in self._instruments:
            instrument.refresh()
        self.read()


def _copy_sensor(part: object) -> Any:
    """Return a copy of a sensor after a check."""
    if not isinstance(part, Sensor):
        raise value_error("sensors", part, "a Sensor: an object with the methods entries and read")
    check_member_names("sensors", part, ("measures",), ("measured",))
    return part.copy() if isinstance(part, Instrument) else copy(part)


class _SharedView:
    """View in which each measured quantity comes from the first instrument that measures it.

    All others come from the true view.
    """

    def __init__(self, view: View, parts: Sequence[object]) -> None:
        self._view, self._sources = view, dict[str, object]()
        for part in parts:
            source = part if isinstance(part, Instrument) else view
            for name in _with_derived(getattr(part, "measures", DEFAULT_QUANTITIES), view):
                self._sources.setdefault(name, source)

    def __getattr__(self, name: str) -> Any:
        source = self.__dict__["_sources"].get(name, self.__dict__["_view"])
        return getattr(source.measured if isinstance(source, Instrument) else source, name)


def measured_names(parts: Sequence[object]) -> list[str]:
    """Return the names of all measured quantities of sensors."""
    return [name for part in parts for name in getattr(part, "measures", DEFAULT_QUANTITIES)]


def _with_derived(names: Sequence[str], view: View) -> list[str]:
    """Return names of quantities together with those derived from them."""
    derived = [each for name in names for each in DERIVED.get(name, ())]
    return [*names, *derived, *(view.slices if "motion" in names else ())]

"""Sensor array: sensors whose concatenated readings form an observation."""

from collections.abc import Sequence
from copy import copy
from typing import Any

import numpy as np

from flexman_gym.common.arrays import Array, IntArray
from flexman_gym.common.checks import check_member_names
from flexman_gym.common.errors import value_error
from flexman_gym.envs.limits import Limits
from flexman_gym.envs.random_streams import RandomStreams
from flexman_gym.envs.sensors.instrument import Instrument
from flexman_gym.envs.sensors.sensor import DEFAULT_QUANTITIES, DERIVED, Sensor
from flexman_gym.envs.view import View


class SensorArray:
    """Sensors of b arms, whose readings are concatenated.

    Args:
        parts: sensors; the array contains copies of them.
        view: a View, or a MeasuredView.
        limits: limits of the arm.
        label: name that seeds the random streams of the instruments.
        agent_sensors: for the sensors of an action mode, the sensor array of the agent. An instrument is a sensor with
            its own noise and delay; an ideal sensor has none. An ideal sensor then reads each quantity from the first
            instrument of this array that measures it, otherwise from the sensors of the agent. Entries may have equal
            names; the first of them is used.

    Attributes:
        slices: name of an entry -> its slice of the observation.
        units: name of an entry -> its unit.
        bound: (size,) largest magnitude of each value.
        observations: (b, size) last readings, overwritten by the next reading.
        readings: name of an entry -> (b, ...) its part of the observations.
        shared: view in which each quantity comes from the first sensor that measures it.

    Raises:
        ValueError: for an object that is not a sensor; without agent_sensors also for two entries with equal names.
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
        columns: list[slice] = []
        bounds, end = [np.zeros(0)], 0
        sensors = [_copy_sensor(part) for part in parts]
        self._instruments = [each for each in sensors if isinstance(each, Instrument)]
        source: Any = _SharedView(agent_sensors.shared, self._instruments) if agent_sensors else view
        for sensor in sensors:
            first = end
            for name, size, unit, bound in sensor.entries(view if isinstance(sensor, Instrument) else source, limits):
                if name in self.slices and not agent_sensors:
                    raise value_error("sensors", name, "each entry once: two sensors have it")
                if name not in self.slices:
                    self.slices[name], self.units[name] = slice(end, end + size), unit
                end += size
                bounds.append(np.ones(size) * np.asarray(bound))
            columns.append(slice(first, end))
        self.bound: Array = np.concatenate(bounds)
        self.observations = np.zeros((len(view.motion), end))
        self.readings = {name: self.observations[:, part] for name, part in self.slices.items()}
        self.shared: Any = _SharedView(view, sensors)
        outputs = [self.observations[:, part] for part in columns]
        self._view, self._sensors = source, list(zip(sensors, outputs, strict=True))
        self._streams = RandomStreams([f"{label}.{i}" for i in range(len(self._instruments))], len(view.motion))

    def begin(self, arms: IntArray, randoms: Sequence[np.random.Generator]) -> None:
        """Start new episodes of the arms (r,), each with its random generator, and sample the arms."""
        for arm, random in zip(arms.tolist(), randoms, strict=True):
            streams = self._streams.generators(arm, random).values()
            for instrument, stream in zip(self._instruments, streams, strict=True):
                instrument.begin(arm, stream)
        self.sample(arms)

    def sample(self, arms: IntArray) -> None:
        """Sample the arms with the indices (r,), once per control period."""
        for instrument in self._instruments:
            instrument.sample(arms)

    def read(self) -> None:
        """Write the current readings of all arms into `observations`."""
        for sensor, output in self._sensors:
            sensor.read(self._view, output)

    def refresh(self, randoms: Sequence[np.random.Generator | None]) -> None:
        """Read again after the state and the random generators of all arms were replaced."""
        self._streams.set_generators(randoms)
        for instrument in self._instruments:
            instrument.refresh()
        self.read()


def _copy_sensor(part: object) -> Any:
    """Return a copy of a sensor after a check of its members."""
    if not isinstance(part, Sensor):
        raise value_error("sensors", part, "a Sensor: an object with the methods entries and read")
    check_member_names("sensors", part, ("measures",), ("measured",))
    return part.copy() if isinstance(part, Instrument) else copy(part)


class _SharedView:
    """View in which each quantity comes from the first sensor that measures it.

    A quantity measured by an ideal sensor, or by no sensor, comes from a given view.
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
    """Return the names of all quantities measured by sensors."""
    return [name for part in parts for name in getattr(part, "measures", DEFAULT_QUANTITIES)]


def _with_derived(names: Sequence[str], view: View) -> list[str]:
    """Return names of measured quantities and of the quantities derived from them."""
    derived = [each for name in names for each in DERIVED.get(name, ())]
    return [*names, *derived, *(view.slices if "motion" in names else ())]

"""Sensor protocol, and the view of quantities measured by instruments."""

from collections.abc import Sequence
from typing import Any, NamedTuple, Protocol, runtime_checkable

import numpy as np

from flexman_gym.common.arrays import Array, IntArray, row_dots
from flexman_gym.envs.limits import Limits
from flexman_gym.envs.view import View


class Entry(NamedTuple):
    """Part of an observation: name, number of values, unit, and largest magnitude (a number, or one per value)."""

    name: str
    size: int
    unit: str
    bound: float | Array


@runtime_checkable
class Sensor(Protocol):
    """Protocol of a sensor; a class with these two methods needs no base class.

    A sensor is a function of the view, without state. Its reading of an arm must not depend on other arms, to the last
    bit (no matrix products over the arms). An environment copies the sensor and first calls `entries`.

    The optional attribute `measures` names the measured quantities, on which noise and other flaws act before the
    sensor derives further quantities from them: () if nothing is measured, by default motion, tip and deflection.
    """

    def entries(self, view: View, limits: Limits) -> Sequence[Entry]:
        """Return the entries in the order of the readings.

        While an arm is within its limits, no reading may exceed the bound of its entry.
        """
        ...

    def read(self, view: View, out: Array) -> None:
        """Write the readings, in the order of the entries, into out (b, size)."""
        ...


DEFAULT_QUANTITIES = ("motion", "tip", "deflection", "deflection_rate")  # `measures` of a sensor without this attribute
DERIVED = {"tip": ("target_error", "tip_error"), "deflection_rate": ("tip_vibration",)}  # measured -> derived ones
STRAIN_RANGE = 2.0  # range of root strains / root strain of a link deflected to its limit by a tip force
ACCELERATION_RANGE = 51.0  # g (500 m/s^2); range of accelerations


class MeasuredView:
    """View of measured quantities with the attributes of a View, so that sensors can read both kinds of views.

    Tip error and tip vibration are derived from the measured quantities, so that a sensor contains no more information
    than the instruments.

    Args:
        view: view of the true quantities.
        limits: limits of the arm.
        names: names of the measured quantities.

    Attributes:
        values: (b, size) measured quantities, concatenated; an instrument overwrites them, then calls `clip`.
        bound: (size,) largest magnitude of each value, the end of its measurement range.
    """

    state_fields = ("values",)

    def __init__(self, view: Any, limits: Limits, names: Sequence[str]) -> None:
        self._view = view
        ranges = measurement_ranges(view, limits)
        if "motion" in names:
            names = ["motion", *(name for name in dict.fromkeys(names) if name not in ("motion", *view.slices))]
        self._names = tuple(dict.fromkeys(names))
        self.bound = np.concatenate([np.zeros(0), *(ranges[name] for name in self._names)])
        self.values = np.zeros((len(view.motion), len(self.bound)))
        self._parts: list[tuple[str, Array]] = []
        end = 0
        for name in self._names:
            first, end = end, end + len(ranges[name])
            part = self.values[:, first:end]
            self._parts.append((name, part))
            setattr(self, name, part)
        if "motion" in self._names:
            for name, place in view.slices.items():
                setattr(self, name, self.motion[:, place])
        self._derive = {"tip": self._errors, "deflection_rate": self._vibration}

    def __getattr__(self, name: str) -> Any:
        return getattr(self.__dict__["_view"], name)

    @property
    def value_units(self) -> tuple[str, ...]:
        """Unit of each value (size,)."""
        return tuple(each for name, _ in self._parts for each in column_units(self._view, name))

    @property
    def value_turns(self) -> Array:
        """Turns (size,) of the shaft of the encoder per turn of each value, see `encoder_turns`."""
        return np.concatenate([np.zeros(0), *(encoder_turns(self._view, name) for name, _ in self._parts)])

    def columns(self, name: str) -> IntArray:
        """Return the indices of a quantity in `values`; (0,) if it is not measured."""
        end = 0
        for each, part in self._parts:
            columns = np.arange(end, end + part.shape[1])
            if each == name:
                return columns
            if each == "motion" and name in self._view.slices:
                return columns[self._view.slices[name]]
            end += part.shape[1]
        return np.zeros(0, dtype=np.int64)

    def instruments(self, parts: Sequence[object]) -> IntArray:
        """Return the index (size,) of the first of some sensors that measures each of the quantities."""
        result = np.zeros(len(self.bound), dtype=np.int64)
        for index, part in reversed(list(enumerate(parts))):
            for name in getattr(part, "measures", DEFAULT_QUANTITIES):
                result[self.columns(name)] = index
        return result

    def copy_true(self, arms: IntArray | slice) -> None:
        """Copy the true quantities of arms, given by their indices or a slice."""
        for name, part in self._parts:
            part[arms] = getattr(self._view, name)[arms]

    def clip(self) -> None:
        """Clip the values to their ranges, and derive tip error and tip vibration from them."""
        np.maximum(self.values, -self.bound, out=self.values)
        np.minimum(self.values, self.bound, out=self.values)
        self.refresh()

    def refresh(self) -> None:
        """Derive tip error and tip vibration from the values, for the current goals."""
        for name, derive in self._derive.items():
            if name in self._names:
                derive()

    def _errors(self) -> None:
        self.target_error = self._view.target - self.tip
        self.tip_error = np.sqrt(row_dots(self.target_error, self.target_error))

    def _vibration(self) -> None:
        self.tip_vibration = np.sqrt(row_dots(self.deflection_rate, self.deflection_rate))


def column_units(view: View, name: str) -> list[str]:
    """Return the unit of each number of a measured quantity."""
    if name == "motion":
        return [view.units[each] for each, place in view.slices.items() for _ in range(place.stop - place.start)]
    return [view.units[name]] * getattr(view, name).shape[1]


def encoder_turns(view: View, name: str) -> Array:
    """Return the turns of the shaft of the encoder per turn, of each number of a measured quantity.

    The encoder of a motor angle is on the shaft of the motor, that of any other angle at the joint.
    """
    if name == "motion":
        return np.concatenate([encoder_turns(view, each) for each in view.slices])
    return view.gear_ratios if name == "motor_angles" else np.ones(getattr(view, name).shape[1])


def measurement_ranges(view: View, limits: Limits) -> dict[str, Array]:
    """Return quantity -> (size,) end of its measurement range, which is its limit for a quantity with a limit."""
    limited, n = limits.bounds(view), view.n_joints
    strain = STRAIN_RANGE * 3.0 * limits.deflection * view.gauge_radii / view.lengths[:, None]
    return {
        **limited,
        "motion": np.concatenate(list(limited.values())),
        "joint_angles": np.full(n, limits.angle + limits.twist),
        "joint_rates": np.full(n, 2.0 * limits.rate),
        "tip": np.full(3, (1.0 + limits.deflection) * view.reach),
        "deflection": np.full(3, 2.0 * view.reach),
        "deflection_rate": np.full(3, 2.0 * limits.tip_speed),
        "root_strains": strain.ravel(),
        "tip_acceleration": np.full(3, 9.81 * ACCELERATION_RANGE),
        "specific_force": np.full(3, 9.81 * ACCELERATION_RANGE),
    }

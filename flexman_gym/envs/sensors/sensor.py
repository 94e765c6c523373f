"""Sensor protocol, and the view of measured quantities with their ranges."""

from collections.abc import Sequence
from typing import Any, NamedTuple, Protocol, runtime_checkable

import numpy as np

from flexman_gym.common.arrays import Array, IntArray, row_dots
from flexman_gym.envs.limits import Limits
from flexman_gym.envs.view import View


class Entry(NamedTuple):
    """A named part of an observation: how many numbers, their unit, and their largest magnitude, one or one of each."""

    name: str
    size: int
    unit: str
    bound: float | Array


@runtime_checkable
class Sensor(Protocol):
    """An instrument. A class with these two methods is one; it needs no base class.

    It reads the view and nothing else, and keeps nothing of one arm: what it reads of an arm must not depend on the
    others, to the last bit (no matrix products over the arms). An environment copies it and asks for its `entries`
    first.

    Noise and other flaws act on what it measures, before it derives anything. `measures`, names of the view, says what
    that is: () for nothing; a sensor without this attribute measures motion, tip and deflection.
    """

    def entries(self, view: View, limits: Limits) -> Sequence[Entry]:
        """What it reads, in order. While an arm is within its limits, no number may be beyond the bound given here."""
        ...

    def read(self, view: View, out: Array) -> None:
        """Writes what it reads into out (b, size), the entries side by side."""
        ...


DEFAULT_QUANTITIES = ("motion", "tip", "deflection", "deflection_rate")  # what a sensor measures that does not say it
DERIVED = {"tip": ("target_error", "tip_error"), "deflection_rate": ("tip_vibration",)}
STRAIN_RANGE = 2.0  # times the root strain of a link that a force on its tip bends to the limit
ACCELERATION_RANGE = 51.0  # largest acceleration that is measured, 500 m/s^2


class MeasuredView:
    """Has all that a View has; sensors read either. What is measured may differ from the truth, within its range.

    Errors of tip and angles follow from what is measured: nothing tells more than the instruments do.

    Attributes:
        values: (b, size) the measured quantities side by side; code that measures overwrites them, then calls `settle`.
        bound: (size,) the largest magnitude that is measured of each.
    """

    state_fields = ("values",)

    def __init__(self, view: Any, limits: Limits, names: Sequence[str]) -> None:
        self._view = view
        ranges = measurement_ranges(view, limits)
        if "motion" in names:
            names = ["motion", *(name for name in dict.fromkeys(names) if name not in ("motion", *view.places))]
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
            for name, place in view.places.items():
                setattr(self, name, self.motion[:, place])
        self._derive = {"tip": self._errors, "deflection_rate": self._vibration}

    def __getattr__(self, name: str) -> Any:
        return getattr(self.__dict__["_view"], name)

    def take(self, arms: IntArray | slice) -> None:
        """Copies the truth of some arms."""
        for name, part in self._parts:
            part[arms] = getattr(self._view, name)[arms]

    def settle(self) -> None:
        """Cuts off what is beyond the range of an instrument and derives what follows from what is measured."""
        np.maximum(self.values, -self.bound, out=self.values)
        np.minimum(self.values, self.bound, out=self.values)
        self.derive()

    def derive(self) -> None:
        """Derives errors and vibration from what is measured, for the present goals."""
        for name, derive in self._derive.items():
            if name in self._names:
                derive()

    def renew(self) -> None:
        """Derives anew, after the values were given back."""
        self.derive()

    def _errors(self) -> None:
        self.target_error = self._view.target - self.tip
        self.tip_error = np.sqrt(row_dots(self.target_error, self.target_error))

    def _vibration(self) -> None:
        self.tip_vibration = np.sqrt(row_dots(self.deflection_rate, self.deflection_rate))


def derived_quantities(names: Sequence[str], view: View) -> list[str]:
    """Names of quantities, and of all that follows from them once they are measured."""
    derived = [each for name in names for each in DERIVED.get(name, ())]
    return [*names, *derived, *(view.places if "motion" in names else ())]


def measurement_ranges(view: View, limits: Limits) -> dict[str, Array]:
    """The largest magnitude that instruments measure of each quantity, by name; that of a limit where there is one."""
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

"""Sensor protocol, and the view of measured quantities with their ranges."""

from collections.abc import Sequence
from typing import Any, NamedTuple, Protocol, runtime_checkable

import numpy as np

from flexman_gym.common.arrays import Array, IntArray, row_dots
from flexman_gym.envs.limits import Limits
from flexman_gym.envs.view import View


class Entry(NamedTuple):
    """Named part of an observation: number of values, unit, and largest magnitude (one number, or one per value)."""

    name: str
    size: int
    unit: str
    bound: float | Array


@runtime_checkable
class Sensor(Protocol):
    """Protocol of a sensor; a class with these two methods needs no base class.

    A sensor reads only the view and stores nothing about an arm. Its reading of one arm must not depend on the other
    arms, to the last bit (no matrix products over the arms). An environment copies the sensor and calls `entries`
    first.

    Noise and other flaws act on the measured quantities before the sensor derives others from them. The optional
    attribute `measures` names these quantities: () for none; without it motion, tip and deflection.
    """

    def entries(self, view: View, limits: Limits) -> Sequence[Entry]:
        """Return the entries in order.

        While an arm is within its limits, no reading may exceed the bound of its entry.
        """
        ...

    def read(self, view: View, out: Array) -> None:
        """Write the readings into out (b, size), the entries side by side."""
        ...


DEFAULT_QUANTITIES = ("motion", "tip", "deflection", "deflection_rate")  # measured by a sensor without `measures`
DERIVED = {"tip": ("target_error", "tip_error"), "deflection_rate": ("tip_vibration",)}
STRAIN_RANGE = 2.0  # ratio to the root strain of a link bent to its limit by a tip force
ACCELERATION_RANGE = 51.0  # g; 500 m/s^2


class MeasuredView:
    """View of measured quantities, with the attributes of a View; sensors can read either.

    Measured quantities may differ from the true ones within their ranges. Errors of tip and angles are derived from the
    measured quantities, so that a sensor contains no more information than the instruments.

    Args:
        view: view of the true quantities.
        limits: limits of the arm.
        names: measured quantities.

    Attributes:
        values: (b, size) measured quantities side by side; an instrument overwrites them, then calls `clip`.
        bound: (size,) largest measured magnitude of each.
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

    def copy_true(self, arms: IntArray | slice) -> None:
        """Copy the true quantities of some arms."""
        for name, part in self._parts:
            part[arms] = getattr(self._view, name)[arms]

    def clip(self) -> None:
        """Clip the values to their ranges and derive other quantities from them."""
        np.maximum(self.values, -self.bound, out=self.values)
        np.minimum(self.values, self.bound, out=self.values)
        self.derive()

    def derive(self) -> None:
        """Derive errors and vibration from the measured quantities, for the present goals."""
        for name, derive in self._derive.items():
            if name in self._names:
                derive()

    def refresh(self) -> None:
        """Derive quantities again after the values were replaced."""
        self.derive()

    def _errors(self) -> None:
        self.target_error = self._view.target - self.tip
        self.tip_error = np.sqrt(row_dots(self.target_error, self.target_error))

    def _vibration(self) -> None:
        self.tip_vibration = np.sqrt(row_dots(self.deflection_rate, self.deflection_rate))


def measurement_ranges(view: View, limits: Limits) -> dict[str, Array]:
    """Return the largest measured magnitude of each quantity, by name; its limit where it has one."""
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

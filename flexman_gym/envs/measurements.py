"""Measurements: readings of the sensors of the agent and of those of its action mode, of many arms."""

from collections.abc import Sequence

import numpy as np

from flexman_gym.common.arrays import Array, IntArray
from flexman_gym.envs.active_effects import ActiveEffects
from flexman_gym.envs.limits import Limits
from flexman_gym.envs.sensors import SensorArray, measured_names
from flexman_gym.envs.sensors.sensor import MeasuredView
from flexman_gym.envs.view import View


class Measurements:
    """Sensors of b arms, sampled once a control period and read at most once in it.

    Args:
        view: of the arms.
        limits: of the arms.
        observed: sensors of the agent, with those of the task.
        inner: sensors of the action mode and its base controller.
        effects: disturbances of what is measured; None without any.

    Attributes:
        sensors: of the agent; their `observations` are the newest alone.
    """

    state_fields = ("_measured", "sensors", "_base_sensors")

    def __init__(
        self,
        view: View,
        limits: Limits,
        observed: Sequence[object],
        inner: Sequence[object],
        effects: ActiveEffects | None,
    ) -> None:
        self._effects, self._all = effects, np.arange(len(view.motion))
        self._measured = None
        if effects is not None and effects.measures:
            self._measured = MeasuredView(view, limits, measured_names([*observed, *inner]))
        source = self._measured or view
        self.sensors = SensorArray(observed, source, limits)  # type: ignore[arg-type]
        self._base_sensors = SensorArray(inner, source, limits, "base", self.sensors)  # type: ignore[arg-type]
        self._read, self._base_read = False, False  # in this control period

    def begin(self, arms: IntArray, randoms: Sequence[np.random.Generator]) -> None:
        """Start new episodes of the arms (r,), each with its generator, and read them."""
        self._measure(arms)
        self.sensors.begin(arms, randoms)
        self._base_sensors.begin(arms, randoms)
        self.read()

    def sample(self, arms: IntArray | None) -> None:
        """Sample the arms (r,), None for all, at the end of a control period."""
        arms = self._all if arms is None else arms
        self._measure(arms)
        self.sensors.sample(arms)
        self._base_sensors.sample(arms)

    def _measure(self, arms: IntArray) -> None:
        self._read, self._base_read = False, False
        if self._measured is not None and self._effects is not None:
            self._measured.take(arms)
            self._measured.values[arms] = self._effects.measure(self._measured.values[arms], arms)
            self._measured.settle()

    def read(self) -> Array:
        """Return the readings (b, size) of the agent's sensors side by side."""
        if not self._read:
            self.sensors.read()
            self._read = True
        return self.sensors.observations

    @property
    def readings(self) -> dict[str, Array]:
        """Readings of the action mode and its base, name -> (b, size)."""
        if not self._base_read:
            self._base_sensors.read()
            self._base_read = True
        return self._base_sensors.readings

    def renew(self, randoms: Sequence[np.random.Generator | None]) -> None:
        """Read again, after the state and the generators of all arms were set."""
        if self._measured is not None:
            self._measured.renew()
        self.sensors.renew(randoms)
        self._base_sensors.renew(randoms)
        self._read, self._base_read = True, True

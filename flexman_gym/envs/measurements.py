"""Measurements: readings of the sensors of the agent and of its action mode, for b arms.

To sample is to store the quantities that the sensors measure now; to read is to compute observations from the samples.
"""

from collections.abc import Sequence

import numpy as np

from flexman_gym.common.arrays import Array, IntArray
from flexman_gym.envs.active_effects import ActiveEffects
from flexman_gym.envs.limits import Limits
from flexman_gym.envs.sensors.sensor import MeasuredView
from flexman_gym.envs.sensors.sensor_array import SensorArray, measured_names
from flexman_gym.envs.view import View


class Measurements:
    """Sensors of b arms, sampled once and read at most once per control period.

    Args:
        view: named quantities of the arms, see `View`.
        limits: limits of the arms.
        own_sensors: sensors of the agent and of the task.
        mode_sensors: sensors of the action mode and its base controller.
        effects: disturbances of the measurements; None without disturbances.

    Attributes:
        sensors: sensors of the agent; their `observations` are the current ones, without history.
    """

    state_fields = ("_measured", "sensors", "_base_sensors")

    def __init__(
        self,
        view: View,
        limits: Limits,
        own_sensors: Sequence[object],
        mode_sensors: Sequence[object],
        effects: ActiveEffects | None,
    ) -> None:
        self._effects, self._all = effects, np.arange(len(view.motion))
        self._measured = None
        if effects is not None and effects.measures:
            self._measured = MeasuredView(view, limits, measured_names([*own_sensors, *mode_sensors]))
        source = self._measured or view
        self.sensors = SensorArray(own_sensors, source, limits)  # type: ignore[arg-type]
        self._base_sensors = SensorArray(mode_sensors, source, limits, "base", self.sensors)  # type: ignore[arg-type]
        self._read, self._base_read = False, False  # True if the sensors were read in this control period

    def begin(self, arms: IntArray, randoms: Sequence[np.random.Generator]) -> None:
        """Start new episodes of the arms (r,), one random generator per arm, and read all sensors of the agent."""
        self._measure(arms)
        self.sensors.begin(arms, randoms)
        self._base_sensors.begin(arms, randoms)
        self.read()

    def sample(self, arms: IntArray | None) -> None:
        """Sample the sensors of the arms with the indices (r,), None for all arms, at the end of a control period."""
        arms = self._all if arms is None else arms
        self._measure(arms)
        self.sensors.sample(arms)
        self._base_sensors.sample(arms)

    def _measure(self, arms: IntArray) -> None:
        self._read, self._base_read = False, False
        if self._measured is not None and self._effects is not None:
            self._measured.copy_true(arms)
            self._measured.values[arms] = self._effects.measure(self._measured.values[arms], arms)
            self._measured.clip()

    def read(self) -> Array:
        """Return the readings (b, size) of the agent's sensors, concatenated."""
        if not self._read:
            self.sensors.read()
            self._read = True
        return self.sensors.observations

    @property
    def readings(self) -> dict[str, Array]:
        """Readings for the action mode and its base controller, name -> (b, size)."""
        if not self._base_read:
            self._base_sensors.read()
            self._base_read = True
        return self._base_sensors.readings

    def refresh(self, randoms: Sequence[np.random.Generator | None]) -> None:
        """Read all sensors again after the state and the random generators of all arms were replaced."""
        if self._measured is not None:
            self._measured.refresh()
        self.sensors.refresh(randoms)
        self._base_sensors.refresh(randoms)
        self._read, self._base_read = True, True

"""Sight: what is measured of the arms, and what an agent and a base see of that."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from flexman_gym.common.arrays import Array, IntArray
from flexman_gym.control.actions import LARGEST, ActionMode, mode_observation_size
from flexman_gym.control.policy import History
from flexman_gym.envs.active_effects import ActiveEffects
from flexman_gym.envs.config.configuration import Configuration
from flexman_gym.envs.sensors import Sensors, find_sensors, measured_names
from flexman_gym.envs.sensors.sensor import MeasuredView
from flexman_gym.envs.view import View

Observations = NDArray[np.float32]


class Sight:
    """Measurements and sensors of b arms.

    Attributes:
        sensors: of the agent, with those of the task; their `observations` are the newest alone.
        readings: of the base, name -> (b, size).
        bound: (size,) float32 largest magnitude of each entry of an observation, with its history.
        seen: (b, size) float32 observations; those of an arm that failed are the last ones within the bounds.
    """

    kept = ("_measured", "sensors", "_base_sensors", "_history", "seen")

    def __init__(self, setup: Configuration, view: View, acting: ActionMode, effects: ActiveEffects | None) -> None:
        self._effects, arms = effects, len(view.motion)
        parts, own = sight_parts(setup, acting)
        self._measured = None
        if effects is not None and effects.measures:
            self._measured = MeasuredView(view, setup.limits, measured_names([*parts, *own]))
        source = self._measured or view
        self.sensors = Sensors(parts, source, setup.limits)  # type: ignore[arg-type]
        self._base_sensors = Sensors(own, source, setup.limits, "base", self.sensors)  # type: ignore[arg-type]
        self._history: History | None = None
        self._shown = np.zeros((arms, mode_observation_size(acting)))
        bound = np.concatenate([self.sensors.bound, np.full(self._shown.shape[1], LARGEST)])
        size, parts_of_history = len(bound), 1
        if setup.history != 1:
            self._history = History(setup.history, setup.action_repeat * setup.control_period, arms, size)
            parts_of_history = self._history.parts
        self.bound = np.tile(bound, parts_of_history).astype(np.float32)
        self.seen: Observations = np.zeros((arms, len(self.bound)), dtype=np.float32)
        self._all = np.arange(arms)

    def begin(self, arms: IntArray, randoms: Sequence[np.random.Generator]) -> None:
        """Starts new episodes of the arms (r,), each with its generator, and reads them."""
        self._measure(arms)
        self.sensors.begin(arms, randoms)
        self._base_sensors.begin(arms, randoms)
        self.sensors.read()

    def measure(self, arms: IntArray | None) -> None:
        """Measures the arms (r,), None for all, at the end of a control period."""
        arms = self._all if arms is None else arms
        self._measure(arms)
        self.sensors.sample(arms)
        self._base_sensors.sample(arms)

    def _measure(self, arms: IntArray) -> None:
        if self._measured is not None and self._effects is not None:
            self._measured.take(arms)
            self._measured.values[arms] = self._effects.measure(self._measured.values[arms], arms)
            self._measured.settle()

    def first(self, arms: IntArray) -> None:
        """Lets the arms (r,) see the first observation of their episodes."""
        now = self._now[arms]
        self.seen[arms] = now if self._history is None else self._history.begin(now, arms)

    def next(self, good: IntArray | None) -> None:
        """Lets the arms (r,) that have not failed, None for all, see what the sensors have read."""
        now = self._now
        if self._history is not None:
            arms = self._all if good is None else good
            self.seen[arms] = self._history.add(now[arms], arms)
        elif good is None:
            self.seen[:] = now
        else:
            self.seen[good] = now[good]

    def show(self, shown: Array) -> None:
        """Takes what the mode of the actions shows the agent now, (b, size)."""
        self._shown[:] = shown

    @property
    def _now(self) -> Array:
        """What sensors observe and the mode shows, (b, size)."""
        if not self._shown.shape[1]:
            return self.sensors.observations
        return np.concatenate([self.sensors.observations, self._shown], axis=1)

    @property
    def readings(self) -> dict[str, Array]:
        """What the base reads now."""
        self._base_sensors.read()
        return self._base_sensors.readings

    def renew(self, randoms: Sequence[np.random.Generator | None]) -> None:
        """Reads anew, after what it keeps and the generators of all arms were given back."""
        if self._measured is not None:
            self._measured.renew()
        self.sensors.renew(randoms)
        self._base_sensors.renew(randoms)


def sight_parts(setup: Configuration, acting: ActionMode) -> tuple[list[object], tuple[object, ...]]:
    """The sensors of the agent, with those of the task, and those of what acts beside it."""
    return [*setup.sensors, *setup.task.sensors], find_sensors(acting.sensors)

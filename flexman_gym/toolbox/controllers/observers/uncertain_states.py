"""Sources of uncertain states: true states, or estimates with their confidence regions."""

from typing import Protocol

import numpy as np

from flexman_gym.agent.controller import Controller, EpisodeInfo, Plant, Readings
from flexman_gym.common.arrays import Array, BoolArray, IntArray
from flexman_gym.toolbox.controllers.observers.estimator import Estimator
from flexman_gym.toolbox.controllers.observers.observer import UncertainStates

CONFIDENCE = 3.0  # standard deviations of the parameters of an estimate


class StateSource(Protocol):
    """Source of uncertain states, from readings of its `sensors`."""

    @property
    def sensors(self) -> tuple[str, ...]:
        """Names of the sensors that the source reads."""
        ...

    def reset(self, arms: IntArray, episode: EpisodeInfo, count: int) -> None:
        """Start new episodes; arguments as in `Controller.reset`."""

    def update(self, readings: Readings, applied: Array, active: BoolArray) -> None:
        """Process the readings of a control period; arguments as in `Controller.act`."""

    def read(self, arms: IntArray) -> UncertainStates:
        """Return the uncertain states of arms (r,) in this control period."""
        ...


class TrueState:
    """True state of an arm with the parameters and the delay of its model.

    Args:
        plant: plant model.
    """

    sensors: tuple[str, ...] = ("state",)

    def __init__(self, plant: Plant) -> None:
        self._delay, self._states = plant.delay[1], np.zeros((0, 2 * plant.model.n_dof))

    def reset(self, arms: IntArray, episode: EpisodeInfo, count: int) -> None:
        """Do nothing: the true state needs no memory."""

    def update(self, readings: Readings, applied: Array, active: BoolArray) -> None:
        """Store the true states."""
        self._states = np.asarray(readings["state"], dtype=float)

    def read(self, arms: IntArray) -> UncertainStates:
        """Return the true states."""
        return UncertainStates(self._states[arms, None], {}, np.full((len(arms), 1), self._delay), 0)


class EstimatedState:
    """State, parameters and delay estimated from the readings of an `Estimator`, within its confidence region.

    Args:
        estimator: estimator with a consistent covariance, see `Estimator.consistent_copy`.
    """

    state_fields: tuple[str, ...] = ("_estimator",)

    def __init__(self, estimator: Estimator) -> None:
        self._estimator = estimator.consistent_copy()
        self.sensors: tuple[str, ...] = estimator.sensors

    def reset(self, arms: IntArray, episode: EpisodeInfo, count: int) -> None:
        """Start new episodes; arguments as in `Controller.reset`."""
        self._estimator.reset(arms, episode, count)

    def update(self, readings: Readings, applied: Array, active: BoolArray) -> None:
        """Update the estimator."""
        self._estimator.estimate(readings, applied, active)

    def read(self, arms: IntArray) -> UncertainStates:
        """Return the estimates, with a deviation of CONFIDENCE along each parameter, and the likely delays."""
        return self._estimator.confidence_region(arms, CONFIDENCE)


def find_state_source(plant: Plant, base: Controller | None) -> StateSource:
    """Return the source of states of the safety filter: the true state only for an arm without uncertain parameters."""
    observer = getattr(base, "observer", None)
    if isinstance(observer, Estimator):
        return EstimatedState(observer)
    if plant.unknown or plant.delay[0] < plant.delay[1]:
        return EstimatedState(Estimator(plant))
    return TrueState(plant)

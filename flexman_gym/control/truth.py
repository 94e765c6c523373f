"""Truth: an observer that is told the state, the parameters and the delay of each arm, the yardstick of all others."""

import numpy as np

from flexman_gym.arrays import Array, Flags, IntArray, grown
from flexman_gym.control.controller import Episode, Readings
from flexman_gym.control.observer import Estimate
from flexman_gym.control.plant import Plant
from flexman_gym.control.prediction import Prediction
from flexman_gym.simulation.parameters import PARAMETERS


class Truth:
    """True state, moved on through the delay by the true arm. It is privileged: nobody could build it.

    Args:
        plant: the arm, whose parameters each episode tells.
    """

    sensors: tuple[str, ...] = ("state",)
    kept = ("_prediction",)

    def __init__(self, plant: Plant) -> None:
        self._prediction, self._delays = Prediction(plant), np.zeros(0, dtype=np.int64)
        self._parameters: dict[str, Array] = {}

    def reset(self, arms: IntArray, episode: Episode) -> None:
        """Takes parameters and delays of new episodes of the arms (r,)."""
        self._prediction.reset(arms)
        count = len(self._prediction.past)
        drawn = {name: values.astype(float) for name, values in episode.drawn.items() if name in PARAMETERS}
        for name, values in drawn.items():
            self._parameters[name] = grown(self._parameters.get(name, values[:0]), count)
            self._parameters[name][arms] = values
        self._prediction.vary(arms, drawn)
        self._delays = grown(self._delays, count)
        self._delays[arms] = episode.drawn.get("delay", 0)

    def estimate(self, readings: Readings, applied: Array, playing: Flags) -> Estimate:
        """Gives what is true when torques that are asked for now begin to act; see `Observer`."""
        states, arms = np.array(readings["state"], dtype=float), np.flatnonzero(playing)
        self._prediction.take(arms, applied[arms])
        states[arms] = self._prediction(arms, states[arms], self._delays[arms])
        return Estimate(states, self._delays, dict(self._parameters))

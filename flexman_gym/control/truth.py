"""Truth: an observer that is told the state, the parameters and the delay of each arm, the yardstick of all others."""

import numpy as np

from flexman_gym.arrays import Array, Flags, IntArray, grown
from flexman_gym.control.bases import Plant
from flexman_gym.control.controller import Episode, Readings
from flexman_gym.control.observer import Estimate
from flexman_gym.simulation.batch import Batch
from flexman_gym.simulation.parameters import PARAMETERS


class Truth:
    """True state, moved on through the delay by the true arm. It is privileged: nobody could build it.

    Args:
        plant: the arm, whose parameters each episode tells.
    """

    sensors: tuple[str, ...] = ("state",)
    kept = ("_past",)

    def __init__(self, plant: Plant) -> None:
        self._plant, n = plant, plant.model.n_joints
        self._limits, self._past = np.zeros((0, n)), np.zeros((0, plant.delay[1] + 1, n))
        self._delays, self._parameters = np.zeros(0, dtype=np.int64), dict[str, Array]()
        self._ahead: Batch | None = None

    def reset(self, arms: IntArray, episode: Episode) -> None:
        """Takes parameters and delays of new episodes of the arms (r,)."""
        count, model = int(arms.max(initial=-1)) + 1, self._plant.model
        if count > len(self._past):
            self._past, self._delays, self._limits = (
                grown(each, count) for each in (self._past, self._delays, self._limits)
            )
            self._ahead = Batch(model, *self._plant.moved, self._plant.period, arms=count)
        drawn = {name: values for name, values in episode.drawn.items() if name in PARAMETERS}
        for name, values in drawn.items():
            self._parameters[name] = grown(self._parameters.get(name, values[:0]).astype(float), len(self._past))
            self._parameters[name][arms] = values
        self._limits[arms] = episode.drawn.get("torque_limit", self._plant.torque_limit)
        self._delays[arms], self._past[arms] = episode.drawn.get("delay", 0), 0.0
        if drawn and self._ahead is not None:
            self._ahead.vary(np.arange(len(self._past))[arms], **{name: self._parameters[name][arms] for name in drawn})

    def estimate(self, readings: Readings, applied: Array, playing: Flags) -> Estimate:
        """Gives what is true when torques that are asked for now begin to act; see `Observer`."""
        states, arms = np.array(readings["state"], dtype=float), np.flatnonzero(playing)
        self._past[arms, 1:] = self._past[arms, :-1]
        self._past[arms, 0] = applied[arms] * self._limits[arms]
        drive, moving = np.zeros((len(states), self._limits.shape[1] + 6)), np.zeros(len(states), dtype=bool)
        for period in range(int(self._delays[arms].max(initial=0))):
            assert self._ahead is not None
            lag = self._delays - 1 - period
            moving[:] = False
            moving[arms] = lag[arms] >= 0
            drive[:, : self._limits.shape[1]] = self._past[np.arange(len(states)), np.maximum(lag, 0)]
            if period == 0:
                self._ahead.place(arms, states[arms])
            self._ahead.step(drive, moving)
        if self._delays[arms].any() and self._ahead is not None:
            states[arms] = self._ahead.state[arms]
        return Estimate(states, self._delays, dict(self._parameters))

"""Learned policy as a controller: sensors, observation history, action repeat, network and base controller."""

from typing import Any

import numpy as np

from flexman_gym.common.arrays import Array, Flags, IntArray, pad_rows
from flexman_gym.common.checks import positive, sequence, value_error, whole_number
from flexman_gym.control.actions import ActionMode, TorqueMode, make_action_mode, mode_observation_size
from flexman_gym.control.base_controllers import make_base
from flexman_gym.control.controller import Controller, EpisodeInfo, Plant, Readings
from flexman_gym.control.network import Network

MOST = 1000  # observations


class History:
    """The last k observations of b arms, the newest first, or the present one and exponential averages of all.

    In an episode that has just begun the first observation stands for those before it.

    Args:
        kind: k, or the times (s) of the averages: an observation counts 1/e of a new one so long after it was made.
        interval: between two observations, s.
        arms: b.
        size: of an observation.
    """

    kept = ("_memory",)

    def __init__(self, kind: int | tuple[float, ...], interval: float, arms: int, size: int) -> None:
        self._gains = None if isinstance(kind, int) else 1.0 - np.exp(-interval / np.array(kind))[:, None]
        self.parts = history_length(kind)
        self._memory = np.zeros((arms, self.parts, size))

    def following(self, earlier: "History") -> "History":
        """Gives itself with what an earlier one of fewer arms remembers."""
        self._memory[: len(earlier._memory)] = earlier._memory
        return self

    def begin(self, observations: Array, arms: IntArray) -> Array:
        """Starts with the first observations (r, size) of the arms (r,); returns what is seen, (r, parts size)."""
        self._memory[arms] = observations[:, None]
        return self.seen(arms)

    def add(self, observations: Array, arms: IntArray) -> Array:
        """Adds observations (r, size) of the arms (r,); returns what is seen, (r, parts size)."""
        memory = self._memory
        if self._gains is None:
            memory[arms, 1:] = memory[arms, :-1]
        else:
            memory[arms, 1:] += self._gains * (observations[:, None] - memory[arms, 1:])
        memory[arms, 0] = observations
        return self.seen(arms)

    def seen(self, arms: IntArray) -> Array:
        """Gives what is seen of the arms (r,), (r, parts size)."""
        result: Array = self._memory[arms].reshape(len(arms), self._memory[0].size)  # of no arm too
        return result


def history_length(kind: int | tuple[float, ...]) -> int:
    """How many observations a history shows."""
    return kind if isinstance(kind, int) else 1 + len(kind)


def checked_history(value: object) -> int | tuple[float, ...]:
    """A number of observations, or the times of averages; raises ValueError for anything else."""
    if not isinstance(value, list | tuple) and not (isinstance(value, np.ndarray) and value.ndim):
        return whole_number("history", value, 1, MOST)
    times = sequence("history", value, "times (s)")
    if not 0 < len(times) <= MOST:
        raise value_error("history", value, f"a whole number, or 1 to {MOST} times (s)")
    return tuple(positive(f"history[{i}]", time, "s") for i, time in enumerate(times))


class Policy:
    """Actions of a network on what its sensors read, each for `hold` control periods, added to those of a base.

    Args:
        network: gives actions (b, n) for observations (b, size).
        sensors: that it learned with, in their order, those of its task included.
        history: observations, or times (s) of averages, see `History`.
        hold: control periods for which an action is kept (action repeat).
        base: what acts beside it, so that its actions are a residual; None for nothing.
        mode: what its actions mean, made for the same base; None for torques.
    """

    kept = ("_ages", "actions", "_past", "base", "mode")

    def __init__(
        self,
        network: Network,
        sensors: tuple[object, ...],
        history: int | tuple[float, ...] = 1,
        hold: int = 1,
        base: Controller | None = None,
        mode: ActionMode | None = None,
    ) -> None:
        self.network, self._kind, self._hold, self.base = network, history, hold, base
        self.mode = mode or TorqueMode(network.joints, base)
        if network.joints != len(self.mode.names):
            raise value_error("actions", self.mode.names, f"a mode of {network.joints} numbers, which the policy gives")
        self.sensors = (*sensors, *self.mode.sensors)
        self._parts, self._shown = history_length(history), mode_observation_size(self.mode)
        self._ages, self.actions = np.zeros(0, dtype=np.int64), np.zeros((0, network.joints), dtype=np.float32)
        self._past = self._history(0, 1.0)

    def _history(self, arms: int, period: float) -> History:
        return History(self._kind, self._hold * period, arms, self.network.size // self._parts)

    def reset(self, arms: IntArray, episode: EpisodeInfo) -> None:
        """Starts new episodes of the arms (r,)."""
        if episode.start.shape[1] != self.mode.joints:
            raise value_error("base", f"a policy of {self.mode.joints} motors", f"one of {episode.start.shape[1]}")
        count = int(arms.max(initial=-1)) + 1
        if count > len(self._ages):
            self._ages, self.actions = pad_rows(self._ages, count), pad_rows(self.actions, count)
            self._past = self._history(count, episode.period).following(self._past)
        self._ages[arms] = 0
        self.mode.reset(arms, episode)

    def due(self, playing: Flags) -> Flags:
        """Gives the arms (b,) among those playing whose actions begin anew in this period."""
        result: Flags = playing & (self._ages % self._hold == 0)
        return result

    def seen(self) -> Array:
        """Gives what the network saw last of each arm, (b, size)."""
        return self._past.seen(np.arange(len(self._ages)))

    def act(self, readings: Readings, applied: Array, playing: Flags) -> Array:
        """Gives the actions (b, n); the network is asked anew where an action has lasted.

        Raises:
            ValueError: for readings of another size than it learned with.
        """
        due = self.due(playing)
        if due.any():
            now = self._observed(readings)
            if self._shown:
                now = np.concatenate([now, self.mode.look(readings, applied, due)], axis=1)  # type: ignore[attr-defined]
            for arms, see in ((due & (self._ages == 0), self._past.begin), (due & (self._ages > 0), self._past.add)):
                rows = np.flatnonzero(arms)
                if len(rows):
                    self.actions[rows] = self.network(see(now[rows], rows).astype(np.float32))
        self._ages += playing
        return self.mode.act(self.actions.astype(np.float64), readings, applied, playing)

    def _observed(self, readings: Readings) -> Array:
        """What its own sensors read (b, size), which stands before what those of the base do."""
        parts: list[Array] = []
        size, wanted = 0, self.network.size // self._parts - self._shown
        for values in readings.values():
            if size >= wanted:
                break
            parts.append(values)
            size += values.shape[1]
        if size != wanted:
            raise value_error(
                "base", f"a policy of {wanted} observed numbers", f"one of {size}, which its sensors read here"
            )
        return np.concatenate([np.zeros((len(self._ages), 0)), *parts], axis=1)


class PolicyFactory:
    """A policy whose base is made for the arm on which it acts.

    Args:
        network: as of a `Policy`.
        sensors: as of a `Policy`.
        history: as of a `Policy`.
        hold: as of a `Policy`.
        **made: "base" as `make_base` takes it, and "actions" as `make_action_mode` takes it.
    """

    def __init__(self, network: Network, sensors: tuple[object, ...], history: Any, hold: int, **made: Any) -> None:
        self.network, self._policy, self._made = network, (network, sensors, history, hold), made

    def made_for(self, plant: Plant) -> Policy:
        """Gives the policy for a plant.

        Raises:
            ValueError: one line, for a mode of another number of actions.
        """
        base = make_base(self._made["base"], plant)
        return Policy(*self._policy, base, make_action_mode(self._made["actions"], plant, base))

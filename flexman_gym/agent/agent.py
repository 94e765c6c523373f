"""Agent: sensors, observation history, action repeat, policy or control law, and action mode with base controller."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from flexman_gym.agent.action_modes import MAX_OBSERVATION, ActionMode
from flexman_gym.agent.controller import Controller, EpisodeInfo, Readings
from flexman_gym.common.arrays import Array, BoolArray, IntArray, pad_rows
from flexman_gym.common.errors import value_error

Law = Callable[[NDArray[np.float32]], NDArray[Any]]  # observations (b, size) -> commands (b, k) from -1 to 1
MAX_HISTORY = 1000  # largest number of observations in a history


class History:
    """Observation history of b arms: the last k observations, or the current one and exponential moving averages.

    At the start of an episode the first observation is repeated in place of earlier observations.

    Args:
        kind: number k of observations, or time constants (s) of the averages.
        interval: time between two observations, s.
        arms: b, number of arms.
        size: number of values of one observation.
    """

    state_fields = ("_memory",)

    def __init__(self, kind: int | tuple[float, ...], interval: float, arms: int, size: int) -> None:
        self._gains = None if isinstance(kind, int) else 1.0 - np.exp(-interval / np.array(kind))[:, None]
        self._memory = np.zeros((arms, history_length(kind), size))

    def copy_from(self, earlier: "History") -> "History":
        """Return this history after copying the content of a history with fewer arms."""
        self._memory[: len(earlier._memory)] = earlier._memory
        return self

    def begin(self, observations: Array, arms: IntArray) -> Array:
        """Fill the histories of the arms (r,) with first observations (r, size); return the histories (r, k size)."""
        self._memory[arms] = observations[:, None]
        return self._read(arms)

    def add(self, observations: Array, arms: IntArray) -> Array:
        """Add observations (r, size) of the arms (r,); return the histories (r, k size)."""
        memory = self._memory
        if self._gains is None:
            memory[arms, 1:] = memory[arms, :-1]
        else:
            memory[arms, 1:] += self._gains * (observations[:, None] - memory[arms, 1:])
        memory[arms, 0] = observations
        return self._read(arms)

    def _read(self, arms: IntArray) -> Array:
        """Return the histories (r, k size) of the arms (r,), the newest observation first."""
        result: Array = self._memory[arms].reshape(len(arms), self._memory[0].size)  # for zero arms too
        return result


def history_length(kind: int | tuple[float, ...]) -> int:
    """Return the number of entries in a history of k observations, or of the present one and moving averages."""
    return kind if isinstance(kind, int) else 1 + len(kind)


class Agent:
    """Agent of b arms with n joints: a mapping from sensor readings to torques.

    An observation is taken every `action_repeat` control periods, and the law maps it to a command (k,), which is held
    in between. In every control period the action mode converts the command into torques and adds the torques of the
    base controller. An environment observes at the end of a control period and calls `decide`, or sets `command` to the
    action of a trainer, and `torques`; as a `Controller` and as base controller of another agent, an agent does all of
    this in `act`.

    Args:
        sensors: observed sensors in their order, including the sensors of the task.
        size: number of values of these sensors for one arm.
        mode: action mode, constructed with the base.
        base: base controller of the mode; None for no base controller.
        history: number of observations, or time constants (s) of moving averages.
        action_repeat: control periods for which a command is held.
        law: function from observations (b, size) to commands (b, k) from -1 to 1, such as a `Network`; None for
            commands of zero, and for those of a trainer.

    Attributes:
        observations: (b, size) float32, including history and the quantities of the mode; unchanged between two
            commands.
        command: (b, k) latest commands, from -1 to 1.
    """

    state_fields = ("base", "mode", "_history", "observations", "command", "_ages")

    def __init__(
        self,
        sensors: Sequence[object],
        size: int,
        mode: ActionMode,
        base: Controller | None = None,
        history: int | tuple[float, ...] = 1,
        action_repeat: int = 1,
        law: Law | None = None,
    ) -> None:
        self.mode, self.base, self.action_repeat = mode, base, action_repeat
        self.sensors: Any = (*sensors, *mode.sensors)
        mode_size = sum(getattr(mode, "observation_sizes", {}).values())
        self.mode_observes = mode_size > 0
        self._size, self.history, self._counts_periods = size, history, action_repeat > 1 or history != 1
        self._row = size + mode_size
        self._history: History | None = None
        self.observations: NDArray[np.float32] = np.zeros((0, history_length(history) * self._row), dtype=np.float32)
        self.command, self._ages = np.zeros((0, len(mode.names))), np.zeros(0, dtype=np.int64)
        self.set_law(law)

    @property
    def estimates(self) -> Mapping[str, Array]:
        """Estimates of the base controller, name -> (b, ...)."""
        return getattr(self.base, "estimates", {})

    def bound(self, sensors: Array) -> NDArray[np.float32]:
        """Return the bounds (k size,) of an observation with history, from the bounds of the sensors (size,)."""
        row = np.append(sensors, np.full(self._row - self._size, MAX_OBSERVATION))
        return np.tile(row, history_length(self.history)).astype(np.float32)

    def set_law(self, law: Law | None) -> None:
        """Set the law, see the class; raise a ValueError if its optional attributes differ from the sizes of the agent.

        These attributes, `size` and `joints`, are the numbers of its inputs and outputs.
        """
        length, mode_size = history_length(self.history), self._row - self._size
        size = getattr(law, "size", length * self._row) // length - mode_size
        if size != self._size:
            allowed = f"one with {self._size}, the number of values of its sensors here"
            raise value_error("base", f"a policy with {size} inputs", allowed)
        commands = getattr(law, "joints", len(self.mode.names))
        if commands != len(self.mode.names):
            raise value_error(
                "actions", self.mode.names, f"an action mode of {commands} numbers, the number of outputs of the policy"
            )
        self.law = law

    def allocate(self, count: int, period: float) -> None:
        """Allocate memory for `count` arms with a control period (s)."""
        if count <= len(self._ages):
            return
        for name in ("observations", "command", "_ages"):
            setattr(self, name, pad_rows(getattr(self, name), count))
        if self.history != 1:
            longer = History(self.history, self.action_repeat * period, count, self._row)
            self._history = longer.copy_from(self._history) if self._history else longer

    def reset(self, arms: IntArray, episode: EpisodeInfo, count: int) -> None:
        """Start new episodes; arguments as in `Controller.reset`.

        Raises:
            ValueError: for arms whose number of joints differs from the number of joints of the action mode.
        """
        if episode.start.shape[1] != self.mode.joints:
            raise value_error("base", f"a policy for {self.mode.joints} motors", f"one for {episode.start.shape[1]}")
        self.allocate(count, episode.period)
        self._ages[arms] = 0
        self.mode.reset(arms, episode, count)

    def due(self, active: BoolArray) -> BoolArray:
        """Return flags (b,) of the active arms whose next command starts in this control period."""
        result: BoolArray = active if self.action_repeat == 1 else active & (self._ages % self.action_repeat == 0)
        return result

    def observe(self, observed: Array, readings: Readings, applied: Array, due: BoolArray) -> None:
        """Update the observations of the arms whose next command is due.

        Args:
            observed: (b, size) sensor readings, concatenated.
            readings: readings of the action mode, as in `Controller.act`; unused for modes without observed quantities.
            applied: as in `Controller.act`.
            due: (b,) flags of arms whose next command is due.
        """
        now = observed
        if self.mode_observes:
            now = np.concatenate([observed, self.mode.observe(readings, applied, due)], axis=1)  # type: ignore[attr-defined]
        if self._history is None:
            rows: Any = slice(None) if np.count_nonzero(due) == len(due) else due
            self.observations[rows] = now[rows]
            return
        first = self._ages == 0
        for flags, update in ((due & first, self._history.begin), (due & ~first, self._history.add)):
            arms = np.flatnonzero(flags)
            if len(arms):
                self.observations[arms] = update(now[arms], arms)

    def decide(self, arms: IntArray | slice = slice(None)) -> NDArray[np.float32]:
        """Return the commands (r, k) of the law for the present observations of arms (r,); zeros without a law."""
        observations = self.observations[arms].copy()
        if self.law is None:
            return np.zeros((len(observations), len(self.mode.names)), dtype=np.float32)
        return np.asarray(self.law(observations), dtype=np.float32)

    def act(self, readings: Readings, applied: Array, active: BoolArray) -> Array:
        """Observe, decide where a command is due, and return `torques`; arguments as in `Controller.act`.

        Raises:
            ValueError: for readings whose size differs from the size of the agent's sensors.
        """
        if self.law is not None and (due := self.due(active)).any():
            self.observe(self._observed(readings), readings, applied, due)
            arms = np.flatnonzero(due)
            self.command[arms] = self.decide(arms)
        return self.torques(readings, applied, active)

    def torques(self, readings: Readings, applied: Array, active: BoolArray) -> Array:
        """Return the torques (b, n) of the present command as fractions of the torque limits; see `Controller.act`."""
        if self._counts_periods:
            self._ages += active
        return np.asarray(self.mode.act(self.command, readings, applied, active))

    def prepare(self, applied: Array, active: BoolArray) -> None:
        """Compute what the next `act` needs besides its readings, if the action mode can; see `Controller`."""
        if hasattr(self.mode, "prepare"):
            self.mode.prepare(applied, active)

    def skip(self, active: BoolArray) -> None:
        """Advance the references of the base controller by a control period without readings, see `Controller`.

        History, held command and the phase of the action repeat remain unchanged: a due command stays due.
        """
        if hasattr(self.mode, "skip"):
            self.mode.skip(active)

    def _observed(self, readings: Readings) -> Array:
        """Return the readings (b, size) of the agent's sensors, which precede the readings for the action mode."""
        parts: list[Array] = [np.zeros((len(self._ages), 0))]
        size = 0
        for values in readings.values():
            if size >= self._size:
                break
            parts.append(values)
            size += values.shape[1]
        if size != self._size:
            allowed = f"one with {size}, the number of values of its sensors here"
            raise value_error("base", f"a policy with {self._size} inputs", allowed)
        return np.concatenate(parts, axis=1)

"""CPU time of an agent, measured by a wrapper of its action mode and of its policy function."""

from collections.abc import Callable
from time import process_time
from typing import Any, Self

from flexman_gym.agent.action_modes import ActionMode
from flexman_gym.agent.controller import EpisodeInfo, Readings
from flexman_gym.agent.mode_wrapper import ModeWrapper
from flexman_gym.common.arrays import Array, BoolArray, IntArray


class ActionClock:
    """CPU time of an agent: of its actions with its policy function, and of the starts of its episodes, s."""

    def __init__(self) -> None:
        self.action_seconds = self.start_seconds = 0.0

    def __deepcopy__(self, memo: object) -> Self:
        return self  # a rollout copies its agent, but all copies add to the same times

    def timed(self, function: Callable[..., Any], name: str = "action_seconds") -> Callable[..., Any]:
        """Return a function whose CPU time is added to the attribute `name`."""

        def call(*arguments: Any) -> Any:
            start = process_time()
            result = function(*arguments)
            setattr(self, name, getattr(self, name) + process_time() - start)
            return result

        return call


class TimedMode(ModeWrapper):
    """Action mode that measures the CPU time of its calls.

    Args:
        mode: action mode of the agent, with its base controller.
        clock: clock to which the times are added.
    """

    def __init__(self, mode: ActionMode, clock: ActionClock) -> None:
        super().__init__(mode)
        self._clock = clock

    def __getattr__(self, name: str) -> Any:
        member = super().__getattr__(name)
        return self._clock.timed(member) if callable(member) else member

    def reset(self, arms: IntArray, episode: EpisodeInfo, count: int) -> None:
        """Start new episodes; arguments as in `Controller.reset`."""
        self._clock.timed(self._mode.reset, "start_seconds")(arms, episode, count)

    def act(self, actions: Array, readings: Readings, applied: Array, active: BoolArray) -> Array:
        """Return the torques (b, n) of the other mode; arguments as in `ActionMode.act`."""
        result: Array = self._clock.timed(self._mode.act)(actions, readings, applied, active)
        return result

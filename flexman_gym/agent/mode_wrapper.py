"""Base class of action modes that change or measure the torques of another action mode."""

from typing import Any, ClassVar

from flexman_gym.agent.action_modes import OPTIONAL_MEMBERS, ActionMode
from flexman_gym.agent.controller import EpisodeInfo, Readings
from flexman_gym.common.arrays import Array, BoolArray, IntArray


class ModeWrapper:
    """Action mode with all members of another action mode; a subclass replaces some of them.

    An optional member of `ActionMode` is missing if the other mode does not have it, or if `withheld` lists it.

    Args:
        mode: the other action mode.
    """

    state_fields: tuple[str, ...] = ("_mode",)
    withheld: ClassVar[tuple[str, ...]] = ()  # optional members that do not hold for the torques of the wrapper

    def __init__(self, mode: ActionMode) -> None:
        self._mode: Any = mode

    def __getattr__(self, name: str) -> Any:
        if name in OPTIONAL_MEMBERS and name not in self.withheld:
            return getattr(self.__dict__["_mode"], name)
        raise AttributeError(f"{type(self).__name__} has no attribute {name}")

    @property
    def joints(self) -> int:
        """Number of joints of an arm."""
        return int(self._mode.joints)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the entries of an action."""
        return tuple(self._mode.names)

    @property
    def sensors(self) -> tuple[object, ...]:
        """Names of the sensors that the mode and its base read."""
        return tuple(self._mode.sensors)

    def reset(self, arms: IntArray, episode: EpisodeInfo, count: int) -> None:
        """Start new episodes; arguments as in `Controller.reset`."""
        self._mode.reset(arms, episode, count)

    def act(self, actions: Array, readings: Readings, applied: Array, active: BoolArray) -> Array:
        """Return the torques (b, n) of the other mode; arguments as in `ActionMode.act`."""
        result: Array = self._mode.act(actions, readings, applied, active)
        return result

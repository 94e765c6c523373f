"""Action mode of an arm on a foundation that an agent moves: the last entries of an action are its commands."""

from typing import ClassVar

import numpy as np

from flexman_gym.agent.action_modes import ActionMode
from flexman_gym.agent.controller import Controller, EpisodeInfo, Readings
from flexman_gym.agent.mode_wrapper import ModeWrapper
from flexman_gym.common.arrays import Array, BoolArray, IntArray, pad_rows

BRAKING_SHARE = 0.5  # fraction of the largest acceleration with which the default law brakes before its goal


class FoundationMode(ModeWrapper):
    """Action mode whose actions also command the velocity of the foundation along an axis.

    With a base controller, its command is added: that of its method `travel(readings, active)`, (b, 1) as fractions of
    the speed, or by default the velocity from which half of the largest acceleration stops at the goal.

    Args:
        mode: action mode of the motors.
        base: base controller of this mode; None without.
        names: names of the commands.
        speed: largest speed, m/s.
        acceleration: largest acceleration, m/s^2.

    Attributes:
        commands: (b, 1) commands of the present control period, as fractions of the largest speed.
    """

    withheld: ClassVar[tuple[str, ...]] = ("derivatives", "strength")
    state_fields: tuple[str, ...] = ("_mode", "commands")

    def __init__(
        self, mode: ActionMode, base: Controller | None, names: tuple[str, ...], speed: float, acceleration: float
    ) -> None:
        super().__init__(mode)
        self._base, self._own, self._speed, self._acceleration = base, names, speed, acceleration
        self.commands = np.zeros((0, len(names)))
        self._period = 0.0

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the entries of an action."""
        return (*self._mode.names, *self._own)

    @property
    def sensors(self) -> tuple[object, ...]:
        """Names of the sensors that the mode and its base read."""
        return (*self._mode.sensors, "foundation")

    def reset(self, arms: IntArray, episode: EpisodeInfo, count: int) -> None:
        """Start new episodes; arguments as in `Controller.reset`."""
        self.commands, self._period = pad_rows(self.commands, count), episode.period
        self.commands[arms] = 0.0
        super().reset(arms, episode, count)

    def act(self, actions: Array, readings: Readings, applied: Array, active: BoolArray) -> Array:
        """Return the torques (b, n) of the motors, and set `commands`; arguments as in `ActionMode.act`."""
        motors, own = np.split(actions, [actions.shape[1] - len(self._own)], axis=1)
        if self._base is not None:
            law = getattr(self._base, "travel", None)
            own = own + (self._approach(readings["travel_error"]) if law is None else law(readings, active))
        self.commands[:] = np.clip(own, -1.0, 1.0)
        return super().act(np.ascontiguousarray(motors), readings, applied, active)

    def _approach(self, errors: Array) -> Array:
        """Return the velocities (b, 1), as fractions of the largest, that stop at the goal at distances (b, 1), m."""
        distance, braking = np.abs(errors), BRAKING_SHARE * self._acceleration
        lost = 0.5 * braking * self._period  # m/s; the servo reaches a velocity at the end of a period
        speed = np.minimum(np.sqrt(lost**2 + 2.0 * braking * distance) - lost, distance / self._period)
        result: Array = np.sign(errors) * speed / self._speed
        return result

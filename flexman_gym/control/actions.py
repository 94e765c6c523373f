"""Actions: what the numbers of an agent mean for the motors; the protocol of such a mode, and those with a name."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any, Protocol

import numpy as np

from flexman_gym.arrays import Array, Flags, IntArray
from flexman_gym.checks import refusal
from flexman_gym.control.controller import Controller, Episode, Readings
from flexman_gym.control.kind import checked_kind
from flexman_gym.control.plant import Plant
from flexman_gym.control.servo import make_servo
from flexman_gym.control.shape import Authority
from flexman_gym.control.shaping import Shaping


class ActionMode(Protocol):
    """The protocol of what k numbers from -1 to 1 of an agent mean for b arms of n joints, in every control period.

    What it does to an arm must not depend on the others, to the last bit. An optional member is `kept`, as of a
    Controller; the base is not among it. A mode that shows its agent something beside what its sensors see has two
    more: `shown`, name -> how many numbers, and `look(readings, applied, playing)`, which gives them side by side,
    (b, size), of the arms that are playing anew. It is asked before an agent acts, in the same control period. A mode
    of torques says as `strength` which part of the torque limits an action of 1 adds, of all joints or of each (n,).

    Attributes:
        joints: n.
        names: (k,) of the numbers of an action.
        sensors: names of the sensors that it and its base read.
    """

    @property
    def joints(self) -> int:
        """How many joints the arms have."""
        ...

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the numbers of an action."""
        ...

    @property
    def sensors(self) -> tuple[object, ...]:
        """Names of the sensors that it and its base read."""
        ...

    def reset(self, arms: IntArray, episode: Episode) -> None:
        """Starts new episodes of the arms with the indices (r,), of its base too."""
        ...

    def act(self, actions: Array, readings: Readings, applied: Array, playing: Flags) -> Array:
        """Gives what the motors (b, n) are asked for, parts of the torque limits from -1 to 1.

        Args:
            actions: (b, k) of the agent, which holds each for one control period or several.
            readings: as of `Controller.act`.
            applied: as of `Controller.act`.
            playing: as of `Controller.act`.
        """
        ...


class Torque:
    """Torques of the motors as parts of their limits, added to those of a base; the sum ends at -1 and 1.

    Args:
        joints: n, of the arm.
        base: what acts beside the agent; None for nothing.
    """

    def __init__(self, joints: int, base: Controller | None = None) -> None:
        self._base, self.joints = base, joints
        self.strength: float | Array = 1.0
        self.names = tuple(f"torque_{joint + 1}" for joint in range(joints))
        self.sensors: tuple[object, ...] = tuple(base.sensors) if base else ()

    def reset(self, arms: IntArray, episode: Episode) -> None:
        """Starts new episodes of the arms (r,)."""
        if self._base:
            self._base.reset(arms, episode)

    def act(self, actions: Array, readings: Readings, applied: Array, playing: Flags) -> Array:
        """Gives the sum (b, n) of actions (b, n) and what the base asks for."""
        if self._base is None:
            return actions
        beside = np.asarray(self._base.act(readings, applied, playing), dtype=np.float64)
        result: Array = np.clip(beside + actions, -1.0, 1.0)
        return result


class Current(Torque):
    """Currents of the motors as parts of their limits, which are torques by gear and torque constant.

    Args:
        joints: as of `Torque`.
        base: as of `Torque`.
        largest: (n,) torque at the current limit, a part of the torque limit, at which it is cut off.
    """

    def __init__(self, joints: int, base: Controller | None, largest: Array) -> None:
        super().__init__(joints, base)
        self._largest = self.strength = largest
        self.names = tuple(f"current_{joint + 1}" for joint in range(joints))

    def act(self, actions: Array, readings: Readings, applied: Array, playing: Flags) -> Array:
        """Gives the torques (b, n) of currents (b, n), with those of a base."""
        return super().act(np.clip(actions * self._largest, -1.0, 1.0), readings, applied, playing)


@dataclass(frozen=True)
class Mode:
    """A mode with a name.

    Attributes:
        make: gives it for a Plant, the base beside the agent or None, and its arguments.
        takes: names of the arguments that a mapping may give.
    """

    make: Callable[..., ActionMode]
    takes: tuple[str, ...] = ()


def _make_current(plant: Plant, base: Controller | None) -> Current:
    """The mode for currents; raises ValueError for an arm of which a motor is missing, or has no current limit."""
    motors = [joint.motor for joint in plant.model.arm.joints]
    limits = [motor.joint_torque_limit if motor else None for motor in motors]
    if None in limits:
        allowed = "it for an arm each of whose joints has a motor (fm.Motor) with a current_limit"
        raise refusal("actions", "current", allowed)
    return Current(len(limits), base, np.array(limits) / plant.torque_limit)


SERVO = ("stiffness", "damping", "range")
ACTIONS: dict[str, Mode] = {
    "torque": Mode(lambda plant, base: Torque(len(plant.torque_limit), base)),
    "current": Mode(_make_current),
    "velocity": Mode(partial(make_servo, "velocity"), SERVO),
    "position": Mode(partial(make_servo, "position"), SERVO),
    "shaping": Mode(Shaping, Authority._fields),
}


def shown_size(mode: ActionMode) -> int:
    """Gives how many numbers a mode shows its agent."""
    return sum(getattr(mode, "shown", {}).values())


def checked_action_mode(value: object) -> tuple[str, dict[str, Any]]:
    """Gives name and arguments of a mode that is a name, or a mapping with one at "kind" and its arguments.

    Raises:
        ValueError: one line with field, value and what is allowed.
    """
    return checked_kind("actions", value, {name: mode.takes for name, mode in ACTIONS.items()})


def make_action_mode(value: object, plant: Plant, base: Controller | None) -> ActionMode:
    """Makes a mode for a plant and what acts beside the agent; see `checked_action_mode`.

    Raises:
        ValueError: one line with field, value and what is allowed.
    """
    name, arguments = checked_action_mode(value)
    return ACTIONS[name].make(plant, base, **arguments)

"""Action modes: protocol, mode of torques, currents and voltages, and the table of all modes."""

from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass
from functools import partial
from typing import Protocol, runtime_checkable

import numpy as np

from flexman_gym.agent.base_controllers import parse_kind
from flexman_gym.agent.controller import Controller, EpisodeInfo, Plant, Readings, saturated
from flexman_gym.common.arrays import Array, BoolArray, IntArray
from flexman_gym.common.errors import value_error
from flexman_gym.common.registry import Registry

MAX_OBSERVATION = 100.0  # bound on the magnitude of observed quantities
OPTIONAL_MEMBERS = (
    "state_fields", "strength", "observation_sizes", "observe", "derivatives", "gain_units", "prepare", "skip", "info",
    "commands",
)  # fmt: skip
"""Members that an action mode may omit."""


@runtime_checkable
class ActionMode(Protocol):
    """Protocol of action modes, which convert actions (b, k) from -1 to 1 into torques of b arms with n joints.

    The torques of an arm must not depend on the other arms, to the last bit. Optional members: `state_fields`, as in
    `Controller`, without the base; `strength`, for modes of torques, the fraction of the torque limits that an action
    of 1 adds, for all joints or for each joint (n,). A mode with observed quantities beyond the sensors has
    `observation_sizes`, name -> number of values, and `observe(readings, applied, active)`, which updates the
    quantities of the active arms and returns the quantities of all arms, concatenated to (b, size). `observe` is called
    before the agent acts, in the same control period. `derivatives(actions, readings, changes)` and `gain_units` are
    those of `Controller`, with the actions (1, k), and their derivatives (p, k) in `changes["actions"]`; the result is
    the derivatives (p, n) only. `prepare(applied, active)` and `skip(active)` are those of `Controller`. `info()`
    returns name -> (b, ...), which environments add to their info. `commands` (b, m) are those of a foundation, see
    `FoundationMode`. A mode that changes or measures the torques of another one extends `ModeWrapper`.

    Attributes:
        joints: n, number of joints.
        names: (k,) names of the entries of an action.
        sensors: names of the sensors that the mode and its base read.
    """

    @property
    def joints(self) -> int:
        """Number of joints of an arm."""
        ...

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the entries of an action."""
        ...

    @property
    def sensors(self) -> tuple[object, ...]:
        """Names of the sensors that the mode and its base read."""
        ...

    def reset(self, arms: IntArray, episode: EpisodeInfo, count: int) -> None:
        """Start new episodes, also in the base controller; arguments as in `Controller.reset`."""
        ...

    def act(self, actions: Array, readings: Readings, applied: Array, active: BoolArray) -> Array:
        """Return the commanded torques (b, n) as fractions of the torque limits, from -1 to 1.

        Args:
            actions: (b, k) actions of the agent, each constant for `action_repeat` control periods.
            readings: as in `Controller.act`.
            applied: as in `Controller.act`.
            active: as in `Controller.act`.
        """
        ...


class TorqueMode:
    """Action mode of motor torques, added to the torques of a base controller; the sum is saturated at -1 and 1.

    Args:
        joints: n, number of joints.
        base: controller whose torques are added; None for no base controller.
        strength: fraction of the torque limits at an action of 1, for all joints or for each joint (n,).
        quantity: "torque"; "current" or "voltage" for motor currents or voltages as fractions of their limits.
        passive: indices of the joints without motor, for which an action has no entry.
    """

    def __init__(
        self,
        joints: int,
        base: Controller | None = None,
        strength: float | Array = 1.0,
        quantity: str = "torque",
        passive: Collection[int] = (),
    ) -> None:
        self._base, self.joints, self.strength = base, joints, strength
        self.motors = [joint for joint in range(joints) if joint not in passive]
        self.names = tuple(f"{quantity}_{joint + 1}" for joint in self.motors)
        self.sensors: tuple[object, ...] = tuple(base.sensors) if base else ()

    def reset(self, arms: IntArray, episode: EpisodeInfo, count: int) -> None:
        """Start new episodes; arguments as in `Controller.reset`."""
        if self._base:
            self._base.reset(arms, episode, count)

    def act(self, actions: Array, readings: Readings, applied: Array, active: BoolArray) -> Array:
        """Return the commanded torques (b, n): the sum of actions (b, k) and torques of the base controller.

        Raises:
            ValueError: for a base controller that returns actions of another shape than (b, n).
        """
        actions = self._of_joints(actions)
        if isinstance(self.strength, np.ndarray):
            actions = np.clip(actions * self.strength, -1.0, 1.0)
        if self._base is None:
            return actions
        base_torques = np.asarray(self._base.act(readings, applied, active), dtype=np.float64)
        if base_torques.shape != actions.shape:  # would be broadcast to all arms
            returned = f"an array of shape {base_torques.shape}"
            raise value_error("base.act", returned, f"actions of shape {actions.shape}, a row for each arm")
        result: Array = np.clip(base_torques + actions, -1.0, 1.0)
        return result

    def _of_joints(self, actions: Array) -> Array:
        """Return actions (b, n) with zeros for passive joints."""
        if len(self.motors) == self.joints:
            return actions
        result = np.zeros((len(actions), self.joints))
        result[:, self.motors] = actions
        return result

    def prepare(self, applied: Array, active: BoolArray) -> None:
        """Prepare the next action of the base controller, see `Controller`."""
        if hasattr(self._base, "prepare"):
            self._base.prepare(applied, active)  # type: ignore[union-attr]

    def skip(self, active: BoolArray) -> None:
        """Advance the references of the base controller by a control period without readings, see `Controller`."""
        if hasattr(self._base, "skip"):
            self._base.skip(active)  # type: ignore[union-attr]

    @property
    def gain_units(self) -> Mapping[str, str]:
        """Units of the gains of the base controller, by name, see `Controller`."""
        return getattr(self._base, "gain_units", {})

    def derivatives(self, actions: Array, readings: Readings, changes: Readings) -> Array:
        """Return the derivatives (p, n) of the torques, see `ActionMode`."""
        actions, change = self._of_joints(actions), self._of_joints(changes["actions"])
        if isinstance(self.strength, np.ndarray):
            actions, change = saturated(actions * self.strength, change * self.strength)
        if self._base is None:
            return change
        base_torques, base_change = self._base.derivatives(readings, changes)  # type: ignore[attr-defined]
        return saturated(base_torques + actions, base_change + change)[1]


@dataclass(frozen=True)
class ActionModeEntry:
    """Entry of the table of action modes.

    Attributes:
        make: function of a Plant, the base controller or None, and the arguments that returns the mode.
        arguments: names of the arguments that a mapping may contain.
    """

    make: Callable[..., ActionMode]
    arguments: tuple[str, ...] = ()


def _make_motor_input(quantity: str, plant: Plant, base: Controller | None) -> TorqueMode:
    """Make the mode of motor currents or voltages.

    Args:
        quantity: "current" or "voltage".
        plant: plant model.
        base: controller whose torques are added; None for no base controller.

    Raises:
        ValueError: for an arm with a joint without a motor of this input, or without its limit.
    """
    motors, voltage = [joint.motor for joint in plant.model.arm.joints], quantity == "voltage"
    given = [motor if motor and (motor.resistance is not None) == voltage else None for motor in motors]
    limits = [(motor.stall_torque if voltage else motor.joint_torque_limit) if motor else None for motor in given]
    if None in limits:
        needed = "resistance and voltage_limit" if voltage else "current_limit, without resistance,"
        raise value_error(
            "actions", quantity, f"{quantity} for an arm with a motor (fm.Motor) with {needed} at each joint"
        )
    return TorqueMode(len(limits), base, np.array(limits) / plant.torque_limit, quantity)


def _make_torques(plant: Plant, base: Controller | None) -> TorqueMode:
    """Make the mode of motor torques."""
    passive = np.flatnonzero(plant.model.constants.passive).tolist()
    return TorqueMode(len(plant.torque_limit), base, passive=passive)


TORQUE = ActionModeEntry(_make_torques)
CURRENT = ActionModeEntry(partial(_make_motor_input, "current"))
VOLTAGE = ActionModeEntry(partial(_make_motor_input, "voltage"))
ACTIONS: Registry[ActionModeEntry] = Registry("action-mode", {
    "torque": f"{__name__}:TORQUE",
    "current": f"{__name__}:CURRENT",
    "voltage": f"{__name__}:VOLTAGE",
    "velocity": "flexman_gym.toolbox.controllers.servo:VELOCITY",
    "position": "flexman_gym.toolbox.controllers.servo:POSITION",
    "shaping": "flexman_gym.toolbox.controllers.arm_shaping_mode:ENTRY",
})  # fmt: skip
"""Action modes: name -> construction and arguments."""


def make_action_mode(value: object, plant: Plant, base: Controller | None) -> ActionMode:
    """Make an action mode for a plant and a base; see `parse_kind`. An `ActionMode` is returned unchanged."""
    if isinstance(value, ActionMode):
        return value
    name, arguments = parse_kind("actions", value, ACTIONS)
    return ACTIONS[name].make(plant, base, **arguments)

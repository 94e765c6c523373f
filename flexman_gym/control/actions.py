"""Action modes: torques, currents, servo references and reference shaping as actions of an agent."""

import warnings
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from typing import Any, Protocol, runtime_checkable

import numpy as np

from flexman_gym.common.arrays import Array, BoolArray, IntArray, Vector, pad_rows
from flexman_gym.common.checks import non_negative, physical, value_error, vector
from flexman_gym.control.base_controllers import make_base, parse_kind
from flexman_gym.control.controller import Controller, EpisodeInfo, Plant, Readings, saturated
from flexman_gym.control.margins import describe_stuck_motors, sampled_loops
from flexman_gym.control.observers.observer import Estimate
from flexman_gym.control.pd import PD
from flexman_gym.control.reference_shaping import ReferenceShaping, ShapingLimits
from flexman_gym.control.tracking import OutputFeedback
from flexman_gym.model.linearization import LinearMeasurements

UNSTABLE_RADIUS = 1.0 + 1e-6  # dimensionless; spectral radius of an unstable loop; undamped uncontrollable modes have 1


class _ServoMode:
    """Joint servo: torque = stiffness (reference - angle) + damping (reference rate - rate).

    The servo runs in every control period and reads the motor encoders only. With kind="position" an action is the
    reference as a fraction of an angle range (rad), with zero reference rate. With kind="velocity" an action is the
    reference rate as a fraction of a speed range (rad/s); the reference is the integral of this rate from the start,
    so that stiffness is the integral gain of the speed loop. Anti-windup: the integral is clamped to the distance from
    the measured angle at which stiffness alone commands the torque limit. A position servo has no integral action and,
    under gravity, a steady-state error of weight / stiffness.

    Args:
        kind: "position" or "velocity".
        gains: PD with gains and torque limits.
        span: (n,) reference angle (rad) or rate (rad/s) at an action of 1.
        period: control period, s.
    """

    state_fields = ("_reference",)
    sensors: tuple[object, ...] = ("motor_encoders",)
    gain_units: Mapping[str, str] = PD.gain_units

    def __init__(self, kind: str, gains: PD, span: Vector, period: float) -> None:
        self._integrates, self._gains, self._span, self._period = kind == "velocity", gains, np.array(span), period
        self.joints = len(self._span)
        self.names = tuple(f"{kind}_{joint + 1}" for joint in range(self.joints))
        self._reference = np.zeros((1, self.joints))  # rad; reference of each arm
        self._reference_changes = np.zeros((1, self.joints))  # (p, n) derivatives of the reference of an arm
        zero = gains.stiffness == 0.0
        self._max_error = np.where(zero, np.inf, gains.torque_limit / np.where(zero, 1.0, gains.stiffness))

    def reset(self, arms: IntArray, episode: EpisodeInfo, count: int) -> None:
        """Start new episodes, with the reference at the joint angles; arguments as in `Controller.reset`."""
        self._reference = pad_rows(self._reference, count)
        self._reference[arms], self._reference_changes = episode.start, np.zeros((1, self.joints))

    def act(self, actions: Array, readings: Readings, applied: Array, active: BoolArray) -> Array:
        """Return the torques (b, n) for reference actions (b, n), as fractions of the torque limits from -1 to 1."""
        angles, command = readings["motor_angles"], actions * self._span
        if self._integrates:
            error, target_rate = self._reference - angles, command
            low, high = angles - self._max_error, angles + self._max_error
            integral = np.clip(self._reference + command * self._period, low, high)
            self._reference[active] = integral[active]
        else:
            error, target_rate = command - angles, 0.0
        torque = self._gains.stiffness * error + self._gains.damping * (target_rate - readings["motor_rates"])
        result: Array = np.clip(torque / self._gains.torque_limit, -1.0, 1.0)
        return result

    def derivatives(self, actions: Array, readings: Readings, changes: Readings) -> Array:
        """Return the derivatives (p, n) of the torques, and advance those of the reference; see `ActionMode`."""
        gains, angles, turned = self._gains, readings["motor_angles"], changes["motor_angles"]
        command, change = actions * self._span, changes["actions"] * self._span
        if self._integrates:
            error, error_change, rate = self._reference - angles, self._reference_changes - turned, command
            integral = self._reference + command * self._period - angles
            step = np.square(np.where(gains.stiffness > 0.0, gains.stiffness, np.inf))
            clamped = turned - np.sign(integral) * gains.torque_limit / step * changes["stiffness"]
            free = np.abs(integral) < self._max_error
            self._reference_changes = np.where(free, self._reference_changes + change * self._period, clamped)
        else:
            error, error_change, rate, change = command - angles, change - turned, 0.0, 0.0
        slip, slip_change = rate - readings["motor_rates"], change - changes["motor_rates"]
        torque = gains.stiffness * error + gains.damping * slip
        torque_change = gains.stiffness * error_change + gains.damping * slip_change
        torque_change += changes["stiffness"] * error + changes["damping"] * slip
        return saturated(torque / gains.torque_limit, torque_change / gains.torque_limit)[1]


def _make_servo(kind: str, plant: Plant, base: Controller | None, **given: Any) -> _ServoMode:
    """Make a servo with the given gains, or with the gains tuned for the plant.

    A UserWarning is issued if the sampled loop, with delay and drive lag, is unstable at zero joint angles for any set
    of sticking motors.

    Args:
        kind: "position" or "velocity".
        plant: plant model.
        base: None; a base controller raises ValueError.
        **given: "stiffness" (N m/rad) and "damping" (N m s/rad), (n,) each; "range", the angle (rad) or rate (rad/s) at
            an action of 1, for all joints or for each joint (n,). The default range is pi, for kind="velocity" the
            speed limit of the motor.
    """
    if base is not None:
        raise value_error("base", base, f'None: with actions="{kind}" the servo commands the motors')
    n, span = len(plant.torque_limit), given.pop("range", None)
    if span is None:
        motors = [joint.motor for joint in plant.model.arm.joints]
        speeds = [motor.joint_speed_limit if motor else None for motor in motors]
        spans = [speed if speed and kind == "velocity" else np.pi for speed in speeds]
    else:
        ranges = span if isinstance(span, list | tuple | np.ndarray) else [span] * n
        numbers = vector("actions.range", ranges, n)
        spans = [physical(f"actions.range[{i}]", number) for i, number in enumerate(numbers)]
    gains = make_base({"kind": "pd", **given}, plant)
    assert isinstance(gains, PD)
    loops = sampled_loops(plant.model, np.zeros(n), plant.period, plant.delay[1], plant.bandwidth)
    radii = [loop.spectral_radius(gains.stiffness, gains.damping) for loop in loops]
    radius, stuck = max(radii), loops[int(np.argmax(radii))].stuck
    if radius > UNSTABLE_RADIUS:
        warnings.warn(
            f"actions: a servo with stiffness {gains.stiffness.tolist()} and damping {gains.damping.tolist()} is not "
            f"stable with a period of {plant.period:g} s{describe_stuck_motors(stuck)} (spectral "
            f"radius {radius:.4g}); give smaller gains, or a shorter control_period with a larger action_repeat",
            stacklevel=2,
        )
    return _ServoMode(kind, gains, spans, plant.period)


DEVIATION_SCALE = 1.0 / 30.0  # fraction of a range; deviation from the reference with an arcsinh of 0.88
ANGLE_SCALE = 0.01  # rad; error of a motor angle with an arcsinh of 0.88
MAX_OBSERVATION = 100.0  # bound on the magnitude of observed quantities


class _ReferenceShapingMode:
    """Action mode of reference shaping: time scaling and joint offsets of the base reference, and added torques.

    The mode adds to the observation: measured quantities of the estimated state, arcsinh of their deviations from the
    reference, errors of motor angles, the reference with its clock and its shaping, the last torques and actions, and
    the estimates of payload and stiffness with their standard deviations.

    Args:
        plant: plant model.
        base: OutputFeedback with an observer and a tracking law.
        **authority: "pace", "offset", "torque" and "fading", see `ShapingLimits`.
    """

    def __init__(self, plant: Plant, base: Controller | None, **authority: object) -> None:
        if not isinstance(base, OutputFeedback):
            allowed = "torque, or shaping with a base that estimates and tracks: adaptive-lqr, lqg or privileged-lqr"
            raise value_error("actions", "shaping", allowed)
        self._base, self._law, self._plant = base, base.law, plant
        limits = ShapingLimits(**{name: non_negative(f"actions.{name}", value) for name, value in authority.items()})
        self.strength = limits.torque if limits.fading == 0.0 else None
        n = self.joints = len(plant.torque_limit)
        self._shaping = self._law.shaping = ReferenceShaping(self._law.slews, self._law.limits, plant.period, limits)
        names = ("pace", *(f"{part}_{joint + 1}" for part in ("offset", "torque") for joint in range(n)))
        self._columns = np.flatnonzero(np.repeat([limits.pace, limits.offset, limits.torque], [1, n, n]) > 0.0)
        self.names = tuple(names[column] for column in self._columns)
        self.sensors: tuple[object, ...] = tuple(base.sensors)
        self._quantities = LinearMeasurements(plant.model)
        self._ranges = np.concatenate([plant.measured()[name][0] for name in self._quantities.columns])
        # the names are stored in files of policies
        sizes = {"estimate": 8 * n, "departures": 8 * n, "angle_errors": 2 * n, "reference": 2 * n, "way": 3 * n}
        sizes |= {"clock": 6, "offsets": 2 * n, "applied": n, "action": len(self.names)}
        sizes |= {"parameters": 1 + 2 * n, "deviations": 1 + 2 * n}
        self.observation_sizes: Mapping[str, int] = sizes
        self._observed = np.zeros((0, sum(sizes.values())))

    def reset(self, arms: IntArray, episode: EpisodeInfo, count: int) -> None:
        """Start new episodes; arguments as in `Controller.reset`.

        Raises:
            ValueError: for a moving goal.
        """
        if episode.reference is not None:
            raise value_error("actions", "shaping", "torque: the goal of this task moves, and only slews can be shaped")
        self._shaping.reset(arms, count)
        self._base.reset(arms, episode, count)

    def act(self, actions: Array, readings: Readings, applied: Array, active: BoolArray) -> Array:
        """Return the commanded torques (b, n) as fractions of the torque limits."""
        arms = np.flatnonzero(active)
        self._shaping.action[arms[:, None], self._columns] = actions[arms]
        return self._base.act(readings, applied, active)

    def prepare(self, applied: Array, active: BoolArray) -> None:
        """Prepare the next estimate of the base controller, see `Controller`."""
        self._base.prepare(applied, active)

    def observe(self, readings: Readings, applied: Array, active: BoolArray) -> Array:
        """Return the observed quantities of all arms (b, size), updated for the active arms (b,)."""
        if len(self._observed) < len(active):
            self._observed = np.zeros((len(active), self._observed.shape[1]))
        if active.any():
            estimate, arms = self._base.update_estimate(readings, applied, active), np.flatnonzero(active)
            self._law.plan(estimate, active)
            observed = np.concatenate(list(self._parts(estimate, applied, arms).values()), axis=1)
            self._observed[arms] = np.clip(np.nan_to_num(observed), -MAX_OBSERVATION, MAX_OBSERVATION)
        return self._observed

    def _parts(self, estimate: Estimate, applied: Array, arms: IntArray) -> dict[str, Array]:
        """Return the observed quantities of the arms (r,), by name."""
        law, slews, model, d = self._law, self._law.slews, self._plant.model, self._plant.model.n_dof
        states, reference, times = estimate.states[arms], law.reference(estimate, arms), law.clock(estimate, arms)
        motors, (progress, speed, acceleration) = model.motor_columns, slews.at(times, arms)
        displacement, end_time = slews.displacement[arms], slews.start_time[arms] + slews.duration[arms]
        errors = slews.start[arms] + displacement + slews.shift[arms] - states[:, motors]
        deviations = np.arcsinh(self._read(states - reference) / (DEVIATION_SCALE * self._ranges))
        path = [displacement * each[:, None] for each in (1.0 - progress, speed, acceleration)]
        remaining = np.maximum(end_time - times, 0.0)
        clock = [progress, speed, acceleration, remaining, slews.time_scaling[arms], end_time]
        return {
            "estimate": self._read(states),
            "departures": deviations,
            "angle_errors": np.concatenate([errors, np.arcsinh(errors / ANGLE_SCALE)], axis=1),
            "reference": np.concatenate([reference[:, motors], reference[:, d + motors]], axis=1),
            "way": np.concatenate(path, axis=1),
            "clock": np.stack(clock, axis=1),
            "offsets": self._shaping.offsets[arms].reshape(len(arms), 2 * self.joints),
            "applied": applied[arms],
            "action": self._shaping.action[arms][:, self._columns],
            "parameters": self._parameters(estimate, arms),
            "deviations": self._deviations(arms),
        }

    def _read(self, states: Array) -> Array:
        """Return the measured quantities (r, 8 n) of states (r, 2 d), see `LinearMeasurements`."""
        named = self._quantities.measure(states)
        return np.concatenate([named[name] for name in self._quantities.columns], axis=1)

    def _parameters(self, estimate: Estimate, arms: IntArray) -> Array:
        """Return payload (kg) and stiffness factors of joints and links, (r, 1 + 2 n)."""
        constants, estimated = self._plant.model.constants, estimate.parameters
        stiffness = np.where(constants.motor >= 0, constants.joint_stiffness, 1.0)
        ones = np.ones((len(arms), self.joints))
        payload = self._law.slews.payloads(estimated, arms)
        joints = estimated["joint_stiffness"][arms] / stiffness if "joint_stiffness" in estimated else ones
        links = estimated["link_stiffness_factor"][arms] if "link_stiffness_factor" in estimated else ones
        return np.concatenate([payload[:, None], joints, links], axis=1)

    def _deviations(self, arms: IntArray) -> Array:
        """Return the standard deviations (r, 1 + 2 n) of payload (kg) and stiffness factors; 0 for known parameters."""
        constants, estimates = self._plant.model.constants, self._base.estimates
        result, n = np.zeros((len(arms), 1 + 2 * self.joints)), self.joints
        if "payload_mass_deviation" in estimates:
            result[:, 0] = estimates["payload_mass_deviation"][arms]
        if "joint_stiffness_deviation" in estimates:
            flexible = constants.motor >= 0
            relative = estimates["joint_stiffness_deviation"][arms] / constants.joint_stiffness[flexible]
            result[:, 1 : 1 + n][:, flexible] = relative  # rigid joints keep 0
        if "link_stiffness_factor_deviation" in estimates:
            result[:, 1 + n :] = estimates["link_stiffness_factor_deviation"][arms]
        return result


OPTIONAL_MEMBERS = (
    "state_fields", "strength", "observation_sizes", "observe", "derivatives", "gain_units", "prepare", "skip",
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
    the derivatives (p, n) only. `prepare(applied, active)` and `skip(active)` are those of `Controller`. A mode
    that changes or measures the torques of another one extends `ModeWrapper`.

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
    """

    def __init__(
        self, joints: int, base: Controller | None = None, strength: float | Array = 1.0, quantity: str = "torque"
    ) -> None:
        self._base, self.joints, self.strength = base, joints, strength
        self.names = tuple(f"{quantity}_{joint + 1}" for joint in range(joints))
        self.sensors: tuple[object, ...] = tuple(base.sensors) if base else ()

    def reset(self, arms: IntArray, episode: EpisodeInfo, count: int) -> None:
        """Start new episodes; arguments as in `Controller.reset`."""
        if self._base:
            self._base.reset(arms, episode, count)

    def act(self, actions: Array, readings: Readings, applied: Array, active: BoolArray) -> Array:
        """Return the commanded torques (b, n): the sum of actions (b, n) and torques of the base controller."""
        if isinstance(self.strength, np.ndarray):
            actions = np.clip(actions * self.strength, -1.0, 1.0)
        if self._base is None:
            return actions
        base_torques = np.asarray(self._base.act(readings, applied, active), dtype=np.float64)
        result: Array = np.clip(base_torques + actions, -1.0, 1.0)
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
        change: Array = changes["actions"]
        if isinstance(self.strength, np.ndarray):
            actions, change = saturated(actions * self.strength, change * self.strength)
        if self._base is None:
            return change
        base_torques, base_change = self._base.derivatives(readings, changes)  # type: ignore[attr-defined]
        return saturated(base_torques + actions, base_change + change)[1]


@dataclass(frozen=True)
class _ActionModeEntry:
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
    limits = [motor.joint_torque_limit if motor else None for motor in given]
    if None in limits:
        needed = "resistance and voltage_limit" if voltage else "current_limit, without resistance,"
        raise value_error(
            "actions", quantity, f"{quantity} for an arm with a motor (fm.Motor) with {needed} at each joint"
        )
    return TorqueMode(len(limits), base, np.array(limits) / plant.torque_limit, quantity)


SERVO_ARGUMENTS = ("stiffness", "damping", "range")
ACTIONS: dict[str, _ActionModeEntry] = {
    "torque": _ActionModeEntry(lambda plant, base: TorqueMode(len(plant.torque_limit), base)),
    "current": _ActionModeEntry(partial(_make_motor_input, "current")),
    "voltage": _ActionModeEntry(partial(_make_motor_input, "voltage")),
    "velocity": _ActionModeEntry(partial(_make_servo, "velocity"), SERVO_ARGUMENTS),
    "position": _ActionModeEntry(partial(_make_servo, "position"), SERVO_ARGUMENTS),
    "shaping": _ActionModeEntry(_ReferenceShapingMode, ShapingLimits._fields),
}


def make_action_mode(value: object, plant: Plant, base: Controller | None) -> ActionMode:
    """Make an action mode for a plant and a base; see `parse_kind`. An `ActionMode` is returned unchanged."""
    if isinstance(value, ActionMode):
        if hasattr(value, "shown") and not hasattr(value, "observation_sizes"):
            message = f"{type(value).__name__}.shown and look are deprecated; name them observation_sizes and observe"
            warnings.warn(message, DeprecationWarning, stacklevel=2)
            value.observation_sizes, value.observe = value.shown, value.look  # type: ignore[attr-defined]
        return value
    name, arguments = parse_kind("actions", value, ACTIONS)
    return ACTIONS[name].make(plant, base, **arguments)

"""Action modes of joint servos: an action is the reference of the angles or of the rates of the motors."""

import warnings
from collections.abc import Mapping
from functools import partial
from typing import Any

import numpy as np

from flexman_gym.agent.action_modes import ActionModeEntry
from flexman_gym.agent.controller import Controller, EpisodeInfo, Plant, Readings, saturated
from flexman_gym.agent.pd import PD, make_pd
from flexman_gym.common.arrays import Array, BoolArray, IntArray, Vector, pad_rows
from flexman_gym.common.checks import physical, vector
from flexman_gym.common.errors import value_error
from flexman_gym.toolbox.controllers.margins import describe_stuck_motors, sampled_loops

UNSTABLE_RADIUS = 1.0 + 1e-6  # dimensionless; spectral radius of an unstable loop; undamped uncontrollable modes have 1


class ServoMode:
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


def _make_servo(kind: str, plant: Plant, base: Controller | None, **given: Any) -> ServoMode:
    """Make a servo with the given gains, or with the gains tuned for the plant.

    A UserWarning is issued if the sampled loop, with delay and drive lag, is unstable at zero joint angles for any set
    of sticking motors.

    Args:
        kind: "position" or "velocity".
        plant: plant model.
        base: None; a base controller raises ValueError.
        **given: "stiffness" (N m/rad) and "damping" (N m s/rad), (n,) each; "range", the angle (rad) or rate (rad/s) at
            an action of 1, for all joints or for each joint (n,). The default range is pi, for kind="velocity" the
            speed limit of the joint.
    """
    if base is not None:
        raise value_error("base", base, f'None: with actions="{kind}" the servo commands the motors')
    n, span = len(plant.torque_limit), given.pop("range", None)
    if span is None:
        speeds = [joint.speed_limit for joint in plant.model.arm.joints]
        spans = [speed if speed and kind == "velocity" else np.pi for speed in speeds]
    else:
        ranges = span if isinstance(span, list | tuple | np.ndarray) else [span] * n
        numbers = vector("actions.range", ranges, n)
        spans = [physical(f"actions.range[{i}]", number) for i, number in enumerate(numbers)]
    gains = make_pd(plant, **given)
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
    return ServoMode(kind, gains, spans, plant.period)


_ARGUMENTS = ("stiffness", "damping", "range")
POSITION = ActionModeEntry(partial(_make_servo, "position"), _ARGUMENTS)
VELOCITY = ActionModeEntry(partial(_make_servo, "velocity"), _ARGUMENTS)

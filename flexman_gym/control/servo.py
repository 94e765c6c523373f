"""Servo: drives of joints that follow an angle or a speed, which is then what actions of an agent mean."""

import warnings
from typing import Any

import numpy as np

from flexman_gym.arrays import Array, Flags, IntArray, Vector, grown
from flexman_gym.checks import physical, refusal, vector
from flexman_gym.control.bases import make_base
from flexman_gym.control.controller import Controller, Episode, Readings
from flexman_gym.control.margins import sampled_loops, spectral_radius, stuck_motors
from flexman_gym.control.pd import PD
from flexman_gym.control.plant import Plant

UNSTABLE = 1.0 + 1e-6  # spectral radius; modes without damping that no motor moves have 1, to rounding


class Servo:
    """A servo of each joint: torque = stiffness (reference - angle) + damping (reference rate - rate).

    It acts in every control period, and measures its motor alone. With kind="position" an action is the reference, a
    part of a range of angles (rad), and the reference rate is 0. With kind="velocity" an action is the reference rate,
    a part of a range of speeds (rad/s), and the reference is its integral from the start on: stiffness is then the
    integral gain of the speed loop. That integral stays where the torque of the stiffness is within the limits, so
    that it does not wind up. There is no other integral action: in a field of gravity a position servo rests beside its
    reference, by the weight over the stiffness.

    Args:
        kind: "position" or "velocity".
        gains: PD with the gains and torque limits.
        span: (n,) rad or rad/s, of an action of 1.
        period: of control, s.
    """

    kept = ("_reference",)
    sensors: tuple[object, ...] = ("motor_encoders",)

    def __init__(self, kind: str, gains: PD, span: Vector, period: float) -> None:
        self._moves, self._gains, self._span, self._period = kind == "velocity", gains, np.array(span), period
        self.joints = len(self._span)
        self.names = tuple(f"{kind}_{joint + 1}" for joint in range(self.joints))
        self._reference = np.zeros((1, self.joints))  # of each arm, rad
        soft = gains.stiffness == 0.0
        self._most = np.where(soft, np.inf, gains.torque_limit / np.where(soft, 1.0, gains.stiffness))

    def reset(self, arms: IntArray, episode: Episode) -> None:
        """Starts new episodes of the arms (r,) with the reference where they are."""
        self._reference = grown(self._reference, int(arms.max(initial=-1)) + 1)
        self._reference[arms] = episode.start

    def act(self, actions: Array, readings: Readings, applied: Array, playing: Flags) -> Array:
        """Gives the torques (b, n) for references (b, n), parts of the torque limits from -1 to 1."""
        angles, asked = readings["motor_angles"], actions * self._span
        if self._moves:
            error, wanted = self._reference - angles, asked
            onward = np.clip(self._reference + asked * self._period, angles - self._most, angles + self._most)
            self._reference[playing] = onward[playing]
        else:
            error, wanted = asked - angles, 0.0
        torque = self._gains.stiffness * error + self._gains.damping * (wanted - readings["motor_rates"])
        result: Array = np.clip(torque / self._gains.torque_limit, -1.0, 1.0)
        return result


def make_servo(kind: str, plant: Plant, base: Controller | None, **given: Any) -> Servo:
    """Makes a servo with gains that are given, or those that were tuned for the plant.

    It warns (UserWarning) where its sampled loop, with delay and drive, is unstable at zero angles, whichever of its
    motors slide or stick.

    Args:
        kind: "position" or "velocity".
        plant: of the joints.
        base: None.
        given: "stiffness" (N m/rad) and "damping" (N m s/rad), (n,) each; "range", rad or rad/s of an action of 1, one
            number or one for each joint: pi, or the speed limits of the motors, where none is given.

    Raises:
        ValueError: one line with field, value and what is allowed.
    """
    if base is not None:
        raise refusal("base", base, f'None: with actions="{kind}" the servo acts on the motors')
    n, span = len(plant.torque_limit), given.pop("range", None)
    if span is None:
        motors = [joint.motor for joint in plant.model.arm.joints]
        speeds = [motor.joint_speed_limit if motor else None for motor in motors]
        spans = [speed if speed and kind == "velocity" else np.pi for speed in speeds]
    else:
        several = span if isinstance(span, list | tuple | np.ndarray) else [span] * n
        numbers = vector("actions.range", several, n)
        spans = [physical(f"actions.range[{i}]", number) for i, number in enumerate(numbers)]
    gains = make_base({"kind": "pd", **given}, plant)
    assert isinstance(gains, PD)
    loops = sampled_loops(plant.model, np.zeros(n), plant.period, plant.delay[1], plant.bandwidth)
    radii = [spectral_radius(loop, gains.stiffness, gains.damping) for loop in loops]
    radius, stuck = max(radii), loops[int(np.argmax(radii))].stuck
    if radius > UNSTABLE:
        warnings.warn(
            f"actions: a servo with stiffness {gains.stiffness.tolist()} and damping {gains.damping.tolist()} is not "
            f"stable with a period of {plant.period:g} s{stuck_motors(stuck)} (spectral radius {radius:.4g}); give "
            "smaller gains, or a shorter control_period with a larger hold",
            stacklevel=2,
        )
    return Servo(kind, gains, spans, plant.period)

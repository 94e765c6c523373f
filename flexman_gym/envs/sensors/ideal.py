"""Ideal sensors: measured quantities, full state, scaled state, servo errors, model state, goal and last action."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import ClassVar

import numpy as np

from flexman_gym.common.arrays import Array
from flexman_gym.common.checks import one_of, sequence, set_fields
from flexman_gym.common.errors import value_error
from flexman_gym.envs.limits import Limits
from flexman_gym.envs.sensors.sensor import Entry, measurement_ranges
from flexman_gym.envs.view import View
from flexman_gym.kernels.control_period import full_observation
from flexman_gym.kernels.layout import LARGEST_STATE


@dataclass(frozen=True)
class Quantities:
    """Measured quantities of the view, concatenated, such as ("motor_angles", "motor_rates").

    The range of a quantity with a limit ends at this limit. Quantities without a limit saturate at their range: tip and
    root strains at values that an arm within its limits hardly reaches, accelerations at 500 m/s^2.

    Attributes:
        names: names in `View.units`.
    """

    names: Sequence[str]

    def __post_init__(self) -> None:
        names = sequence("Quantities.names", self.names, "names of measured quantities, such as motor_angles")
        set_fields(self, names=tuple(names))

    @property
    def measures(self) -> tuple[str, ...]:
        """Names of the measured quantities."""
        return tuple(self.names)

    def entries(self, view: View, limits: Limits) -> Sequence[Entry]:
        """Return the entries, one for each quantity."""
        ranges = measurement_ranges(view, limits)
        for name in self.names:
            one_of("Quantities.names", name, view.units)
        bounds = [ranges[name] for name in self.names]
        ends = np.cumsum([0, *map(len, bounds)]).tolist()
        columns = [slice(*pair) for pair in pairwise(ends)]
        # a quantity with a limit is not clipped, because beyond its limit the episode terminates
        clipped = [None if name in view.slices else bound for name, bound in zip(self.names, bounds, strict=True)]
        set_fields(self, _columns=list(zip(self.names, columns, clipped, strict=True)))
        return [Entry(name, len(each), view.units[name], each) for name, each in zip(self.names, bounds, strict=True)]

    def read(self, view: View, out: Array) -> None:
        """Write the quantities into out (b, size)."""
        for name, columns, bound in self._columns:  # type: ignore[attr-defined]
            if bound is None:
                out[:, columns] = getattr(view, name)
            else:
                np.maximum(getattr(view, name), -bound, out=out[:, columns])
                np.minimum(out[:, columns], bound, out=out[:, columns])


NEARNESS_LENGTH = 0.1 / 8.5  # fraction of the reach; tip error at which the nearness has the length 1/2


@dataclass
class FullState:
    """Full mechanical state as physical quantities; its size does not depend on the fidelity of the model.

    For n joints: motor angles and rates, joint twists and their rates, deflections of the links and their rates, then
    the goal: angle errors, target error, target nearness and tip velocity. `FlexManEnv` lists units and bounds. The
    nearness is e / (NEARNESS_LENGTH reach + |e|) with the target error e (3,). It resolves millimetres even if
    observations are normalised by their standard deviation, which is metres in a slew.
    """

    measures: ClassVar[tuple[str, ...]] = ("motion", "tip")

    def entries(self, view: View, limits: Limits) -> Sequence[Entry]:
        """Return the entries of the state and of the goal."""
        bounds, n = limits.bounds(view), view.n_joints
        speed = bounds.pop("tip_velocity")
        return [
            *(Entry(name, len(bound), view.units[name], bound) for name, bound in bounds.items()),
            Entry("angle_errors", n, "rad", 2 * limits.angle),
            Entry("target_error", 3, "m", 2 * view.span),
            Entry("target_nearness", 3, "1", 1.0),
            Entry("tip_velocity", 3, "m/s", speed),
        ]

    def read(self, view: View, out: Array) -> None:
        """Write the state and the goal into out (b, 9 n + 9)."""
        full_observation(
            view.motion, view.motor_angles, view.tip_velocity, view.goal_angles, view.target_error, view.tip_error,
            NEARNESS_LENGTH * view.reach, out,
        )  # fmt: skip


# Scales of FineScale: fractions of the limits of motors and joints; fractions of the reach, or of the reach per second.
ANGLE, RATE, TWIST, DEFLECTION, LENGTH, SPEED = 1 / 400, 1 / 500, 1 / 250, 1 / 2125, 1 / 425, 1 / 170


@dataclass
class FineScale:
    """State as arcsinh(quantity / scale), linear for values below the scale and logarithmic for larger values.

    The logarithm lets a network resolve small and large values. For n joints: motor rates, joint twists and their
    rates, deflections of the links and their rates, angle errors, target error and tip velocity. For `FlexRRR-v0` their
    scales are 0.02 rad/s, 0.004 rad, 0.02 rad/s, 0.004 m, 0.02 m/s, 0.01 rad, 0.02 m and 0.05 m/s; in general they
    follow from the limits and the reach of the arm.
    """

    measures: ClassVar[tuple[str, ...]] = ("motion", "tip")

    def entries(self, view: View, limits: Limits) -> Sequence[Entry]:
        """Return the entries and compute their scales."""
        bounds = limits.bounds(view)
        largest = {
            **{name: bounds[name] for name in view.slices if name not in ("motor_angles", "tip_velocity")},
            "angle_errors": np.full(view.n_joints, 2 * limits.angle),
            "target_error": np.full(3, 2 * view.span),
            "tip_velocity": bounds["tip_velocity"],
        }
        self._scales = np.concatenate([np.full(len(largest[name]), scale) for name, scale in _scales(view, limits)])
        fine = np.arcsinh(np.concatenate(list(largest.values())) / self._scales)
        ends = np.cumsum([0, *map(len, largest.values())])
        # the factor leaves a margin for rounding of a quantity at its bound
        return [
            Entry(f"fine_{name}", len(bound), "1", 1.0000001 * fine[first : first + len(bound)])
            for (name, bound), first in zip(largest.items(), ends, strict=False)
        ]

    def read(self, view: View, out: Array) -> None:
        """Write the scaled quantities into out (b, 8 n + 6)."""
        n = view.n_joints
        out[:, : 7 * n] = view.motion[:, n : 8 * n]
        np.subtract(view.goal_angles, view.motor_angles, out=out[:, 7 * n : 8 * n])
        out[:, -6:-3], out[:, -3:] = view.target_error, view.tip_velocity
        out /= self._scales
        np.arcsinh(out, out=out)


def _scales(view: View, limits: Limits) -> list[tuple[str, float]]:
    """Return pairs of name and scale of the quantities of `FineScale`, in the order of its entries."""
    reach = view.reach
    return [
        ("motor_rates", RATE * limits.rate),
        ("joint_twists", TWIST * limits.twist),
        ("joint_twist_rates", RATE * limits.rate),
        ("link_deflections", DEFLECTION * reach),
        ("link_deflection_rates", LENGTH * reach),
        ("angle_errors", ANGLE * limits.angle),
        ("target_error", LENGTH * reach),
        ("tip_velocity", SPEED * reach),
    ]


@dataclass
class ServoErrors:
    """Servo errors: goal angles - motor angles, motor rates, and the rates of a moving goal."""

    measures: ClassVar[tuple[str, ...]] = ("motor_angles", "motor_rates")

    def entries(self, view: View, limits: Limits) -> Sequence[Entry]:
        """Return the entries of the angle errors, the motor rates and the goal rates."""
        return [
            Entry("angle_errors", view.n_joints, "rad", 2 * limits.angle),
            Entry("motor_rates", view.n_joints, "rad/s", limits.rate),
            Entry("goal_rates", view.n_joints, "rad/s", limits.rate),
        ]

    def read(self, view: View, out: Array) -> None:
        """Write angle errors, motor rates and goal rates into out (b, 3 n)."""
        n = view.n_joints
        np.subtract(view.goal_angles, view.motor_angles, out=out[:, :n])
        out[:, n : 2 * n], out[:, 2 * n :] = view.motor_rates, view.goal_rates


@dataclass
class ModelState:
    """State (2 d,) of the model in the order of `kernels.layout`; its size depends on the fidelity of the model."""

    measures: ClassVar[tuple[str, ...]] = ()

    def entries(self, view: View, limits: Limits) -> Sequence[Entry]:
        """Return the entry of the state."""
        return [Entry("state", view.state.shape[-1], "rad, m, rad/s, m/s", LARGEST_STATE)]

    def read(self, view: View, out: Array) -> None:
        """Write the state into out (b, 2 d)."""
        out[:] = view.state


@dataclass
class GoalCommand:
    """Current goal: motor angles and rates, and position and velocity of the target in the base frame.

    A task may add further sensors of its goal, such as the preview of `Track`.
    """

    measures: ClassVar[tuple[str, ...]] = ()

    def entries(self, view: View, limits: Limits) -> Sequence[Entry]:
        """Return the entries of the goal."""
        return [
            Entry("angle_command", view.n_joints, "rad", limits.angle),
            Entry("rate_command", view.n_joints, "rad/s", limits.rate),
            Entry("tip_command", 3, "m", (1.0 + limits.deflection) * view.reach + 2.0 * (view.span - view.reach)),
            Entry("tip_velocity_command", 3, "m/s", limits.tip_speed),
        ]

    def read(self, view: View, out: Array) -> None:
        """Write the goal into out (b, 2 n + 6)."""
        n = view.n_joints
        out[:, :n], out[:, n : 2 * n] = view.goal_angles, view.goal_rates
        out[:, -6:-3], out[:, -3:] = view.target, view.target_velocity


@dataclass
class FoundationState:
    """Foundation: position, velocity and error of the position on a servo, or attitude and motion of a base."""

    measures: ClassVar[tuple[str, ...]] = ()

    def entries(self, view: View, limits: Limits) -> Sequence[Entry]:
        """Return the entries; raise ValueError for an arm whose foundation does not move."""
        if view.foundation is None:
            raise value_error("sensors", "foundation", "a sensor for an environment with the setting foundation")
        result: Sequence[Entry] = view.foundation.entries()
        return result

    def read(self, view: View, out: Array) -> None:
        """Write the readings into out (b, size)."""
        out[:] = view.foundation.readings


@dataclass
class LastAction:
    """Commanded torques of the last control period as fractions of the torque limits; 0 at the start of an episode.

    They are the clipped sum of the torques of agent and base controller, before delay, lag and torque limits of the
    motors.
    """

    measures: ClassVar[tuple[str, ...]] = ()

    def entries(self, view: View, limits: Limits) -> Sequence[Entry]:
        """Return the entry of the action."""
        return [Entry("action", view.n_joints, "1", 1.0)]

    def read(self, view: View, out: Array) -> None:
        """Write the action into out (b, n)."""
        out[:] = view.action

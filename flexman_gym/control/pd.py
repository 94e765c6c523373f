"""PD: proportional-derivative control of the motors."""

import numpy as np
from numpy.typing import NDArray

from flexman_gym.common.arrays import Array, BoolArray, IntArray, Vector, pad_rows
from flexman_gym.common.checks import non_negative, physical, vector
from flexman_gym.control.controller import EpisodeInfo, Readings
from flexman_gym.model.dynamics import mass_matrix
from flexman_gym.model.model import Model, check_model
from flexman_gym.model.statics import holding_torques


class PD:
    """Proportional-derivative control of the motors: torque = stiffness (posture - angle) - damping rate, saturated.

    Where the posture moves, the rate is that relative to it.

    It measures the motors only, as an industrial arm does. Sensors and motors are collocated, so in continuous time it
    is stable for any gains.

    Args:
        stiffness: (n,) N m/rad.
        damping: (n,) N m s/rad. Sampled with the period T it must stay below about 2 rotor_inertia / T.
        torque_limit: N m, where the motors saturate; one number or one for each joint.
        gravity_model: of the arm whose holding torques at the goal posture are added from each reset on; None for none.

    Raises:
        ValueError: one line with field, value and what is allowed.
    """

    sensors: tuple[str, ...] = ("servo",)

    def __init__(
        self,
        stiffness: Vector,
        damping: Vector,
        torque_limit: float | Vector,
        gravity_model: Model | None = None,
    ) -> None:
        checked = vector("PD.stiffness", stiffness, unit="N m/rad")
        n = len(checked)
        self.stiffness, self.damping = np.array(checked), np.array(vector("PD.damping", damping, n, "N m s/rad"))
        for name in ("stiffness", "damping"):
            for i, gain in enumerate(getattr(self, name).tolist()):
                non_negative(f"PD.{name}[{i}]", gain)
        self.torque_limit = np.array(torque_limits("PD.torque_limit", torque_limit, n))
        self.gravity_model = None if gravity_model is None else check_model(gravity_model)
        self._holding = np.zeros((1, n))  # torques of each arm

    def reset(self, arms: IntArray, episode: EpisodeInfo, count: int) -> None:
        """Takes the torques that hold the arms (r,) at their goals."""
        if self.gravity_model is None:
            return
        self._holding = pad_rows(self._holding, count)
        for arm, angles in zip(arms, episode.goal, strict=True):
            self._holding[arm] = holding_torques(self.gravity_model, angles)

    def unstable(self, model: Model, period: float, delay: int = 0) -> str:
        """Says what makes the sampled loop unstable for certain, "" where nothing does.

        Within a period a motor turns on its own inertia J, whatever hangs on its spring. Sampled with the period T and
        late by k periods its rate r then follows r' = r - (damping T / J) r of k periods ago, which grows from
        damping T / J = 2 sin(pi / (4 k + 2)) on: 2 without a delay, 1 with one period, 0.62 with two (Levin and May,
        Theoretical Population Biology 9, 1976, 178). Below it stiffness and bending links may still make it unstable.

        Args:
            model: of the arm.
            period: of control, s.
            delay: whole periods by which torques come late.
        """
        limit = stability_limit(delay)
        inertia = 1.0 / np.diag(np.linalg.inv(mass_matrix(model, np.zeros(2 * model.n_dof))))[model.motor_columns]
        shares = self.damping * period / inertia
        late = f" and a delay of {delay} periods" if delay else ""
        for i in np.flatnonzero(shares >= limit):
            return (
                f"PD.damping[{i}]: {self.damping[i]:.4g} N m s/rad is not stable with a period of {period:g} s{late}: "
                f"damping x period / inertia of the motor is {shares[i]:.3g}; give less than {limit:.3g}, "
                f"which is {limit * inertia[i] / period:.4g} N m s/rad"
            )
        return ""

    def act(
        self, readings: Readings, applied: Array | None = None, playing: BoolArray | None = None
    ) -> NDArray[np.float32]:
        """Gives the action (n,), or (b, n), for angle_errors, motor_rates and, where there are any, goal_rates."""
        error, rate = readings["angle_errors"], readings["motor_rates"]
        if "goal_rates" in readings:
            rate = rate - readings["goal_rates"]
        torque = self.stiffness * error - self.damping * rate
        if self.gravity_model is not None:
            torque = torque + (self._holding if error.ndim > 1 else self._holding[0])
        return np.clip(torque / self.torque_limit, -1.0, 1.0).astype(np.float32)


def stability_limit(delay: int) -> float:
    """Gives damping x period / inertia from which on a sampled motor is unstable, see `PD.unstable`.

    Args:
        delay: whole periods by which torques come late.
    """
    return float(2.0 * np.sin(np.pi / (4 * delay + 2)))


def torque_limits(name: str, value: object, joints: int) -> tuple[float, ...]:
    """Gives one limit for each joint, N m.

    Args:
        name: of the field, for the error.
        value: one number for all joints, or one for each.
        joints: number of joints.

    Raises:
        ValueError: for another number of limits, or a limit that is not a number from 1e-30 to 1e30.
    """
    if not isinstance(value, list | tuple | np.ndarray):
        return (physical(name, value, "N m"),) * joints
    limits = vector(name, value, joints, "N m")
    return tuple(physical(f"{name}[{i}]", limit, "N m") for i, limit in enumerate(limits))

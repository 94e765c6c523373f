"""PD: proportional-derivative control of the motors."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from flexman_gym.arrays import Array, IntArray
from flexman_gym.checks import non_negative, positive, store, vector


@dataclass(frozen=True)
class PD:
    """Proportional-derivative control of the motors: torque = stiffness (posture - angle) - damping rate, saturated.

    It measures the motors only, as an industrial arm does; collocated, so stable for any gains in continuous time.

    Attributes:
        stiffness: (n,) N m/rad.
        damping: (n,) N m s/rad. Sampled with the period T it must stay below about 2 rotor_inertia / T.
        torque_limit: N m, where the motors saturate; one number or one for each joint.

    Raises:
        ValueError: one line with field, value and what is allowed.
    """

    stiffness: Sequence[float]
    damping: Sequence[float]
    torque_limit: float | Sequence[float]
    sensors: ClassVar[tuple[str, ...]] = ("full",)

    def __post_init__(self) -> None:
        stiffness = vector("PD.stiffness", self.stiffness, unit="N m/rad")
        damping = vector("PD.damping", self.damping, len(stiffness), "N m s/rad")
        for name, gains in (("stiffness", stiffness), ("damping", damping)):
            for i, gain in enumerate(gains):
                non_negative(f"PD.{name}[{i}]", gain)
        limit = torque_limits("PD.torque_limit", self.torque_limit, len(stiffness))
        store(self, stiffness=stiffness, damping=damping, torque_limit=limit)

    def reset(self, arms: IntArray, start: Array, posture: Array) -> None:
        """Nothing: it keeps nothing of an episode."""

    def act(self, readings: Mapping[str, NDArray[np.floating]]) -> NDArray[np.float32]:
        """Action (n,), or (b, n), for posture_errors and motor_rates."""
        error, rate = readings["posture_errors"], readings["motor_rates"]
        torque = np.array(self.stiffness) * error - np.array(self.damping) * rate
        return np.clip(torque / np.array(self.torque_limit), -1.0, 1.0).astype(np.float32)


def torque_limits(name: str, value: object, joints: int) -> tuple[float, ...]:
    """One limit > 0 (N m) for each joint, from one number for all or one for each; raises ValueError otherwise."""
    if not isinstance(value, list | tuple | np.ndarray):
        return (positive(name, value, "N m"),) * joints
    limits = vector(name, value, joints, "N m")
    return tuple(positive(f"{name}[{i}]", limit, "N m") for i, limit in enumerate(limits))

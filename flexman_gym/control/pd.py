"""Controllers: from an observation to an action, with one call signature."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from flexman_gym.checks import non_negative, positive, store, vector


@dataclass(frozen=True)
class PD:
    """Proportional-derivative control of the motors: torque = stiffness (posture - angle) - damping rate, saturated.

    It measures the motors only, as an industrial arm does; collocated, so stable for any gains in continuous time.

    Attributes:
        stiffness: (n,) N m/rad.
        damping: (n,) N m s/rad. Sampled with the period T it must stay below about 2 rotor_inertia / T.
        torque_limit: N m, where the motors saturate.

    Raises:
        ValueError: one line with field, value and what is allowed.
    """

    stiffness: tuple[float, ...]
    damping: tuple[float, ...]
    torque_limit: float

    def __post_init__(self) -> None:
        stiffness = vector("PD.stiffness", self.stiffness, unit="N m/rad")
        damping = vector("PD.damping", self.damping, len(stiffness), "N m s/rad")
        for name, gains in (("stiffness", stiffness), ("damping", damping)):
            for i, gain in enumerate(gains):
                non_negative(f"PD.{name}[{i}]", gain)
        limit = positive("PD.torque_limit", self.torque_limit, "N m")
        store(self, stiffness=stiffness, damping=damping, torque_limit=limit)

    def act(self, observation: NDArray[np.floating], slices: Mapping[str, slice]) -> NDArray[np.float32]:
        """Action (n,), or (b, n), for an observation (size,), or (b, size), with the named slices of `FullState`."""
        error, rate = observation[..., slices["posture_errors"]], observation[..., slices["motor_rates"]]
        torque = np.array(self.stiffness) * error - np.array(self.damping) * rate
        return np.clip(torque / self.torque_limit, -1.0, 1.0).astype(np.float32)

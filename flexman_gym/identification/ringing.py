"""Ringing: measured frequencies and damping ratios of an arm, and their exact derivatives by its physical
parameters.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from flexman_gym.common.arrays import Array, Vector
from flexman_gym.common.checks import flag, positive, sequence, set_fields, value_error, vector, whole_number
from flexman_gym.model.dynamics import damping_matrix, mass_matrix, stiffness_matrix
from flexman_gym.model.model import Model
from flexman_gym.model.vibration import EquilibriumMatrices, equilibrium_matrices, oscillatory_modes
from flexman_gym.simulation.parameters import varied_model

FREQUENCY_DEVIATION, DAMPING_DEVIATION = 0.005, 0.1  # parts of a measured frequency and of a damping ratio
KEYS = ("frequencies", "damping", "joint_angles", "lock_joints", "numbers", "deviation", "damping_deviation")


@dataclass(frozen=True)
class Ringing:
    """Frequencies and damping ratios that were measured at one posture.

    Attributes:
        frequencies: (k,) Hz, as a ring-down or a spectrum shows them (damped).
        damping: (k,) damping ratios z of the same, or None; of a logarithmic decrement D, z = D / sqrt(4 pi^2 + D^2).
        joint_angles: (n,) rad; None for zero.
        lock_joints: whether the motors were held, else free.
        numbers: (k,) which vibrations of the model these are, from 0, the lowest first; None for the lowest k.
        deviation: standard deviation of the frequencies, a part of them.
        damping_deviation: standard deviation of the damping ratios, a part of them.

    Raises:
        ValueError: one line with field, value and what is allowed.
    """

    frequencies: Vector
    damping: Vector | None = None
    joint_angles: Vector | None = None
    lock_joints: bool = True
    numbers: Vector | None = None
    deviation: float = FREQUENCY_DEVIATION
    damping_deviation: float = DAMPING_DEVIATION

    def __post_init__(self) -> None:
        values = vector("frequencies", self.frequencies, unit="Hz")
        count = len(values)
        if not values or min(values) <= 0.0:
            raise value_error("frequencies", self.frequencies, "numbers > 0 (Hz)")
        set_fields(self, frequencies=values, deviation=positive("deviation", self.deviation))
        flag("lock_joints", self.lock_joints)
        if self.damping is not None:
            damping = vector("damping", self.damping, count)
            if not all(0.0 < ratio < 1.0 for ratio in damping):
                raise value_error("damping", self.damping, "damping ratios > 0 and < 1, one for each frequency")
            set_fields(self, damping=damping, damping_deviation=positive("damping_deviation", self.damping_deviation))
        numbers = range(count) if self.numbers is None else sequence("numbers", self.numbers)
        set_fields(self, numbers=tuple(whole_number("numbers", each, 0, 10**4) for each in numbers))
        if len(self.numbers) != count:  # type: ignore[arg-type]
            raise value_error("numbers", self.numbers, f"{count}, one for each frequency")

    @property
    def measured(self) -> Array:
        """Frequencies, then damping ratios where there are, (k,) or (2 k,)."""
        return np.array([*self.frequencies, *(self.damping or ())])

    @property
    def deviations(self) -> Array:
        """Standard deviations of `measured`."""
        parts = [self.deviation] * len(self.frequencies) + [self.damping_deviation] * len(self.damping or ())
        return self.measured * parts

    def computed(self, model: Model, parameters: Mapping[str, Array], h: float) -> tuple[Array, Array]:
        """Gives the same numbers of a model, and their slopes.

        A change of mass, damping and stiffness moves an eigenvalue s with shape y by -y (s^2 dM + s dC + dK) y, where
        y (2 s M + C) y = 1. Masses and stiffness are linear in most parameters, so that their differences are exact.

        Args:
            model: the model.
            parameters: values (1 + 2 p, ...) by name: the model's, then p parameters each a little larger and smaller.
            h: half the distance between these two, in the unit of the slopes.
        """
        count = len(next(iter(parameters.values())))
        rows = [{name: values[i] for name, values in parameters.items()} for i in range(count)]
        lanes = [self._resting(varied_model(model, **row)) for row in rows]
        kept = lanes[0].free if self.lock_joints else np.arange(model.n_dof)
        found = oscillatory_modes(lanes[0], kept)
        chosen = list(self.numbers or ())
        if len(found.values) <= max(chosen):
            raise value_error(
                "frequencies", self.frequencies, f"at most {len(found.values)}, as this model has no more"
            )
        s, y = found.values[chosen], found.shapes[chosen]
        slopes = []
        for ahead, behind in zip(lanes[1::2], lanes[2::2], strict=True):
            pairs = zip(ahead[:3], behind[:3], strict=True)
            mass, damping, stiffness = ((a - b)[np.ix_(kept, kept)] / (2.0 * h) for a, b in pairs)
            moved = -(y * (s[:, None] ** 2 * (y @ mass) + s[:, None] * (y @ damping) + y @ stiffness)).sum(axis=1)
            ratio = -(moved * np.abs(s) - s * (np.conj(s) * moved).real / np.abs(s)).real / np.abs(s) ** 2
            slopes.append(self._of(moved.imag / (2.0 * np.pi), ratio))
        return self._of(s.imag / (2.0 * np.pi), -s.real / np.abs(s)), np.transpose(slopes)

    def _of(self, frequencies: Array, ratios: Array) -> Array:
        """Frequencies, with damping ratios where they were measured."""
        return np.append(frequencies, ratios) if self.damping else np.asarray(frequencies)

    def _resting(self, model: Model) -> EquilibriumMatrices:
        """The arm at rest; without weight it needs not be looked for."""
        angles = np.zeros(model.n_joints) if self.joint_angles is None else self.joint_angles
        if any(model.arm.gravity):
            return equilibrium_matrices(model, angles)
        matrices = mass_matrix(model, model.initial_state(angles)), damping_matrix(model), stiffness_matrix(model)
        return EquilibriumMatrices(*matrices, np.zeros((3, model.n_dof)), model.motor_columns)

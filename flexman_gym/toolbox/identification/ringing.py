"""Ringing: frequencies and damping ratios, measured at a posture, and their exact derivatives."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from flexman_gym.common.arrays import Array, Vector
from flexman_gym.common.checks import flag, positive, sequence, set_fields, vector, whole_number
from flexman_gym.common.errors import value_error, warn_caller
from flexman_gym.common.time_series import read_time_series
from flexman_gym.model.dynamics import damping_matrix, mass_matrix, stiffness_matrix
from flexman_gym.model.model import Model
from flexman_gym.model.vibration import EquilibriumMatrices
from flexman_gym.simulation.physical_parameters import varied_model
from flexman_gym.toolbox.identification.ring_down import RingDown

FREQUENCY_DEVIATION = 0.005  # relative standard deviation of a measured frequency
DAMPING_DEVIATION = 0.1  # relative standard deviation of a measured damping ratio
KEYS = ("frequencies", "damping", "joint_angles", "lock_joints", "numbers", "deviation", "damping_deviation")


def _positive(name: str, value: float | Vector, count: int) -> float | Vector:
    """Return a checked number > 0 for all modes, or (count,) numbers."""
    if np.ndim(value) == 0:
        return positive(name, value)
    return tuple(positive(f"{name}[{i}]", each) for i, each in enumerate(vector(name, value, count)))


@dataclass(frozen=True)
class Ringing:
    """Natural frequencies and damping ratios with given deviations, measured at one posture.

    Attributes:
        frequencies: damped natural frequencies (k,) from a ring-down or a spectrum, Hz.
        damping: damping ratios (k,) of the modes with these frequencies, or None. A logarithmic decrement D corresponds
            to a damping ratio D / sqrt(4 pi^2 + D^2).
        joint_angles: joint angles (n,) of the measurement, rad; None for zeros.
        lock_joints: True if the motors, not the links, were locked in the measurement; False if they were free.
        numbers: indices (k,) of these modes among the modes of the model, from 0 for the lowest frequency; None for the
            k lowest frequencies.
        deviation: relative standard deviation of the frequencies, 1, for all or (k,).
        damping_deviation: relative standard deviation of the damping ratios, 1, for all or (k,).

    Examples:
        >>> ringing = fm.Ringing(frequencies=(1.3, 11.2), damping=(0.008, 0.007), joint_angles=(0.5,))
        >>> found = fm.fit(fm.catalog.one_joint(), "joint_stiffness", ringing, elements=1)
        >>> found.frequencies.shape
        (4, 3)
    """

    frequencies: Vector
    damping: Vector | None = None
    joint_angles: Vector | None = None
    lock_joints: bool = True
    numbers: Vector | None = None
    deviation: float | Vector = FREQUENCY_DEVIATION
    damping_deviation: float | Vector = DAMPING_DEVIATION

    def __post_init__(self) -> None:
        values = vector("frequencies", self.frequencies, unit="Hz")
        count = len(values)
        if not values or min(values) <= 0.0:
            raise value_error("frequencies", self.frequencies, "numbers > 0 (Hz)")
        set_fields(self, frequencies=values, deviation=_positive("deviation", self.deviation, count))
        flag("lock_joints", self.lock_joints)
        if self.damping is not None:
            damping = vector("damping", self.damping, count)
            if not all(0.0 < ratio < 1.0 for ratio in damping):
                raise value_error("damping", self.damping, "damping ratios > 0 and < 1, one for each frequency")
            deviation = _positive("damping_deviation", self.damping_deviation, count)
            set_fields(self, damping=damping, damping_deviation=deviation)
        numbers = range(count) if self.numbers is None else sequence("numbers", self.numbers)
        set_fields(self, numbers=tuple(whole_number("numbers", each, 0, 10**4) for each in numbers))
        if len(self.numbers) != count:  # type: ignore[arg-type]
            raise value_error("numbers", self.numbers, f"{count} mode numbers, one for each frequency")

    @property
    def measured(self) -> Array:
        """Measured frequencies (k,), Hz; with damping (2 k,), followed by the damping ratios."""
        return np.array([*self.frequencies, *(self.damping or ())])

    @property
    def deviations(self) -> Array:
        """Standard deviations (k,) of the frequencies, Hz; with damping (2 k,), then those of the damping ratios."""
        parts = [np.broadcast_to(self.deviation, len(self.frequencies))]
        return self.measured * np.append(parts, np.broadcast_to(self.damping_deviation, len(self.damping or ())))

    @classmethod
    def estimate(cls, times: Vector, values: Array, names: Sequence[str] | None = None) -> "Ringing":
        """Estimate frequencies and damping ratios of one or two modes from a record of free vibration.

        The record is fitted by least squares with damped sinusoids, an offset and a drift, as many as the Bayesian
        information criterion accepts. A mode is a sinusoid whose decay is proven: its damping ratio exceeds PROOF
        standard deviations, and its amplitude falls by MIN_DECAY or more. Tones of a motor or a fan, readings at a
        limit of the sensor, repeated readings, and columns with another frequency are named in UserWarnings. The
        standard deviations are the larger ones of those of white noise and those of blocks of the residuals.

        Args:
            times: (T,) increasing times, s.
            values: (T,) or (T, c) readings, in any unit.
            names: (c,) names of the columns, for warnings; None for their numbers.

        Raises:
            ValueError: for a record of less than MIN_CYCLES cycles, and for one without a vibration that decays.
        """
        found = RingDown.of(times, values, names)
        for note in found.notes:
            warn_caller(f"ringing: {note}")
        order = np.argsort(found.poles[:, 0])
        (frequencies, damping), (first, second) = found.poles[order].T, found.deviations[order].T
        return cls(frequencies, damping, deviation=first / frequencies, damping_deviation=second / damping)

    @classmethod
    def from_csv(cls, path: str | Path, columns: Sequence[str] | None = None) -> "Ringing":
        """Estimate frequencies and damping ratios from a CSV file; see `read_time_series` and `estimate`.

        Args:
            path: path of the file; its columns need no units.
            columns: names of the columns; None for all but commands, set points and temperatures.

        Raises:
            FileNotFoundError: if the file does not exist.
        """
        record = read_time_series(path, columns).warn()
        return cls.estimate(record.times, record.table, list(record.columns))

    def predict(self, model: Model, parameters: Mapping[str, Array], h: float) -> tuple[Array, Array]:
        """Compute the frequencies and damping ratios of a model, and their Jacobian.

        A change of mass, damping and stiffness matrices M, C and K changes an eigenvalue s with eigenvector y by
        -y^T (s^2 dM + s dC + dK) y, if y^T (2 s M + C) y = 1. M and K are linear in most parameters, so that their
        differences are exact.

        Args:
            model: the model.
            parameters: values (1 + p, ...) by name: unperturbed values, then for each of p free scalars the values
                with this scalar increased.
            h: increase of the values, absolute or as a fraction, for the Jacobian.

        Returns:
            Frequencies (k,) or frequencies and damping ratios (2 k,), and their Jacobian with p columns.
        """
        count = len(next(iter(parameters.values())))
        rows = [{name: values[i] for name, values in parameters.items()} for i in range(count)]
        matrices = [self._equilibrium(varied_model(model, **row)) for row in rows]
        columns = matrices[0].free if self.lock_joints else np.arange(model.n_dof)
        found = matrices[0].oscillatory_modes(columns)
        chosen = list(self.numbers or ())
        if len(found.values) <= max(chosen):
            raise value_error(
                "frequencies", self.frequencies, f"at most {len(found.values)}, the number of modes of this model"
            )
        s, y = found.values[chosen], found.shapes[chosen]
        jacobian = []
        for perturbed in matrices[1:]:
            pairs = zip(perturbed[:3], matrices[0][:3], strict=True)
            mass, damping, stiffness = ((a - b)[np.ix_(columns, columns)] / h for a, b in pairs)
            change = -(y * (s[:, None] ** 2 * (y @ mass) + s[:, None] * (y @ damping) + y @ stiffness)).sum(axis=1)
            ratio = -(change * np.abs(s) - s * (np.conj(s) * change).real / np.abs(s)).real / np.abs(s) ** 2
            jacobian.append(self._join(change.imag / (2.0 * np.pi), ratio))
        return self._join(s.imag / (2.0 * np.pi), -s.real / np.abs(s)), np.transpose(jacobian)

    def _join(self, frequencies: Array, ratios: Array) -> Array:
        """Return frequencies, followed by damping ratios if these were measured."""
        return np.append(frequencies, ratios) if self.damping else np.asarray(frequencies)

    def _equilibrium(self, model: Model) -> EquilibriumMatrices:
        """Return the matrices at the equilibrium, which is the undeformed arm if there is no gravity."""
        angles = np.zeros(model.n_joints) if self.joint_angles is None else self.joint_angles
        if any(model.arm.gravity):
            return EquilibriumMatrices.of(model, angles)
        matrices = mass_matrix(model, model.initial_state(angles)), damping_matrix(model), stiffness_matrix(model)
        return EquilibriumMatrices(*matrices, np.zeros((3, model.n_dof)), model.motor_columns)

"""Vibration modes about a static equilibrium, with the motors held or free, and frequencies of a rotating arm."""

from dataclasses import dataclass, field, replace
from typing import NamedTuple, Self

import numpy as np

from flexman_gym.common.arrays import Array, IntArray, Vector
from flexman_gym.common.checks import check_solvable, one_of, vector
from flexman_gym.common.errors import value_error
from flexman_gym.model.dynamics import elastic_forces, inertial_forces, mass_matrix, stiffness_matrix
from flexman_gym.model.linearization import continuous_model
from flexman_gym.model.model import Model, check_model
from flexman_gym.model.state_space import natural_modes
from flexman_gym.model.statics import free_joints, holding_torques, rest_state

RIGID_BODY_LIMIT = 1e-6  # magnitude of an eigenvalue / lowest natural frequency, up to which it is rigid-body motion
OVERDAMPED_LIMIT = 1e-7  # dimensionless; imaginary part of an eigenvalue / its magnitude, up to which it is overdamped
ZERO_DAMPING = 1e-12  # dimensionless; damping ratio below which it is a rounded zero
SHOWN_MODES = 3  # number of modes in the repr
MAX_ITERATIONS = 200  # for the equilibrium of a rotating arm
MAX_COORDINATE = 1e3  # m or rad; a larger coordinate ends the iteration without an equilibrium


class Eigenpairs(NamedTuple):
    """Complex eigenvalues with positive imaginary part, by which they are sorted, and their eigenvectors.

    Attributes:
        values: (k,) eigenvalues s, 1/s.
        shapes: (k, d) complex mode shapes, normalised to shape^T (2 s M + C) shape = 1 with mass matrix M and damping
            matrix C. An initial state q, v then has the modal amplitude shape^T (s M q + C q + M v).
    """

    values: Array
    shapes: Array


class EquilibriumMatrices(NamedTuple):
    """Matrices of an arm linearised about a static equilibrium: mass a + damping v + stiffness q = forces.

    q (d,) are deviations of the coordinates, v speeds and a accelerations; all matrices are in SI units.

    Attributes:
        mass: (d, d).
        damping: (d, d).
        stiffness: (d, d), including the contribution of gravity.
        tip: (3, d) displacement of the tip per unit coordinate, base frame.
        motors: (n,) indices of the motor angles; for rigid joints, indices of the joint angles.
    """

    mass: Array
    damping: Array
    stiffness: Array
    tip: Array
    motors: IntArray

    @classmethod
    def of(cls, model: Model, motor_angles: Vector) -> Self:
        """Return the matrices of an arm linearised about its static equilibrium.

        Args:
            model: model of the arm.
            motor_angles: (n,) rad.

        Raises:
            ValueError: if no equilibrium is found, see `rest_state`.
        """
        linear = continuous_model(model, rest_state(model, motor_angles), holding_torques(model, motor_angles))
        d, second_order = model.n_dof, linear.balance
        assert second_order is not None
        stiffness = -second_order.forces[:, :d]
        damping = -second_order.forces[:, d : 2 * d]
        return cls(
            second_order.mass,
            (damping + damping.T) / 2.0,
            (stiffness + stiffness.T) / 2.0,
            linear.C[:, :d],
            model.driven_columns,
        )

    @property
    def free(self) -> IntArray:
        """Indices (d - n,) of the coordinates other than the motor angles."""
        return np.setdiff1d(np.arange(len(self.mass)), self.motors)

    def oscillatory_modes(self, moving: IntArray) -> Eigenpairs:
        """Return the oscillatory modes of an arm with some of its coordinates fixed.

        The eigenvalues are computed in the modal coordinates of the undamped arm, so that low frequencies are accurate
        even if the arm also has very high ones.

        Args:
            moving: (m,) indices of the coordinates that are not fixed.

        Returns:
            Eigenvalues (k,), and shapes (k, m) over the moving coordinates.
        """
        block = np.ix_(moving, moving)
        mass, damping = self.mass[block], self.damping[block]
        if not len(mass):
            return Eigenpairs(np.zeros(0, dtype=complex), np.zeros((0, 0), dtype=complex))
        squares, natural = natural_modes(mass, self.stiffness[block])
        lowest = np.sqrt(squares[squares > 0.0].min(initial=np.inf))
        sizes = np.sqrt(np.maximum(np.abs(squares), lowest**2 if np.isfinite(lowest) else 1.0))
        with check_solvable("modes"):
            modal_damping = natural.T @ damping @ natural
            values, vectors = np.linalg.eig(
                np.block([[np.zeros_like(modal_damping), np.diag(sizes)], [-np.diag(squares / sizes), -modal_damping]])
            )
        oscillatory = (values.imag > OVERDAMPED_LIMIT * np.abs(values)) & (np.abs(values) > RIGID_BODY_LIMIT * lowest)
        rows = np.flatnonzero(oscillatory)
        rows = rows[np.argsort(values[rows].imag, kind="stable")]
        values, modal = values[rows], (vectors[: len(mass), rows] / sizes[:, None]).T
        norm = 2.0 * values * (modal**2).sum(axis=1) + np.einsum("ka,ab,kb->k", modal, modal_damping, modal)
        return Eigenpairs(values, (modal / np.sqrt(norm)[:, None]) @ natural.T)


@dataclass(frozen=True, eq=False)
class Modes:
    """Vibration modes of an arm about a posture: k conjugate pairs of eigenvalues s of its linear model, lowest first.

    Attributes:
        frequencies: (k,) damped natural frequencies Im s / (2 pi), Hz.
        damping_ratios: (k,) -Re s / |s|, 1.
        shapes: (k, d) complex mode shapes in the coordinates of `kernels.layout`, with shape^H M shape = 1 (SI units)
            for the mass matrix M, and with their largest entry real.
        shares: (k, 2 n) fractions of the elastic energy in the n links, then in the n joints, 0 to 1.
        parts: (2 n,) names of these links and joints.
        motors: "held" or "free".
        eigenvalues: (k,) complex eigenvalues s, 1/s.

    Examples:
        >>> vibration = fm.modes(fm.build_model(fm.catalog.one_joint()))
        >>> len(vibration), vibration.parts
        (13, ('link 1', 'joint 1'))
    """

    frequencies: Array
    damping_ratios: Array
    shapes: Array
    shares: Array
    parts: tuple[str, ...]
    motors: str
    eigenvalues: Array = field(repr=False)

    def __len__(self) -> int:
        return len(self.frequencies)

    def __repr__(self) -> str:
        lines = [f"<Modes: {len(self)} with motors {self.motors}"]
        for frequency, ratio, shares in zip(self.frequencies, self.damping_ratios, self.shares, strict=True):
            largest = [i for i in np.argsort(-shares)[:2] if shares[i] > 0.005]
            energies = ", ".join(f"{100 * shares[i]:.0f} % in {self.parts[i]}" for i in largest)
            lines.append(f"  {frequency:.6g} Hz, damping ratio {ratio:.3g}" + (f", {energies}" if energies else ""))
        return "\n".join(lines[: SHOWN_MODES + 1] + ["  ..."] * (len(self) > SHOWN_MODES)) + ">"


def modes(model: Model, joint_angles: Vector | None = None, motors: str = "held") -> Modes:
    """Return the damped vibration modes of an arm about its static equilibrium under gravity.

    They are modes of the linear model (see `linearize`). Non-oscillatory solutions are left out: rigid-body motion and
    overdamped modes. Coulomb friction of free motors does not contribute to the damping; for motors that stick, use
    "held".

    Args:
        model: model of the arm.
        joint_angles: (n,) motor angles, rad, zero by default.
        motors: "held" locks the motors, and rigid joints; "free" applies constant holding torques.

    Raises:
        ValueError: if no equilibrium is found, see `rest_state`.

    Examples:
        >>> vibration = fm.modes(fm.build_model(fm.catalog.one_joint()), motors="held")
        >>> vibration.frequencies[:2].round(2), vibration.damping_ratios[:2].round(3)
        (array([ 1.41, 11.26]), array([0.004, 0.007]))
    """
    held = one_of("motors", motors, ("held", "free")) == "held"
    n = check_model(model).n_joints
    resting = EquilibriumMatrices.of(model, np.zeros(n) if joint_angles is None else joint_angles)
    moving = resting.free if held else np.arange(model.n_dof)
    pairs = resting.oscillatory_modes(moving)
    shapes = np.zeros((len(pairs.values), model.n_dof), dtype=complex)
    shapes[:, moving] = pairs.shapes
    masses = np.einsum("ka,ab,kb->k", shapes.conj(), resting.mass, shapes).real
    largest = (
        np.take_along_axis(shapes, np.abs(shapes).argmax(axis=1)[:, None], axis=1) if shapes.size else shapes[:, :1]
    )
    shapes = shapes * (np.abs(largest) / largest) / np.sqrt(masses)[:, None]
    energies = elastic_energies(model, shapes)
    total = energies.sum(axis=1, keepdims=True)
    ratios = -pairs.values.real / np.abs(pairs.values)
    ratios[np.abs(ratios) < ZERO_DAMPING] = 0.0
    return Modes(
        frequencies=pairs.values.imag / (2.0 * np.pi),
        damping_ratios=ratios,
        shapes=shapes,
        shares=np.divide(energies, total, out=np.zeros_like(energies), where=total > 0.0),
        parts=tuple(f"{kind} {i}" for kind in ("link", "joint") for i in range(1, n + 1)),
        motors=motors,
        eigenvalues=pairs.values,
    )


def elastic_energies(model: Model, coordinates: Array) -> Array:
    """Return twice the elastic energies (k, 2 n), J, of the n links, then of the n joints, at coordinates (k, d).

    For complex amplitudes of an oscillation the result is four times the mean elastic energy over a cycle.
    """
    n, constants, stiffness = model.n_joints, model.constants, stiffness_matrix(model)
    energies = np.zeros((len(coordinates), 2 * n))
    for i in range(n):
        columns = model.elastic_columns(i)
        deflection, twist = coordinates[:, columns], coordinates[:, model.motor_columns[i]] - coordinates[:, i]
        energies[:, i] = np.einsum("ka,ab,kb->k", deflection.conj(), stiffness[columns, columns], deflection).real
        energies[:, n + i] = constants.joint_stiffness[i] * np.abs(twist) ** 2
        energies[:, n + i] += constants.passive_stiffness[i] * np.abs(coordinates[:, i]) ** 2
    return energies


def rotating_frequencies(model: Model, rates: Vector) -> Array:
    """Return the natural frequencies (r, k), Hz, ascending, of an arm in steady rotation about its first joint.

    The first motor rotates at a constant rate, all others are held at an angle of zero, and there is no gravity. The
    arm is linearised about its steady deformation; `stiffening` of the model includes the stiffening of the links by
    centrifugal forces. A row is NaN if no steady deformation is found; non-oscillatory modes give NaN at the end of a
    row.

    Args:
        model: model of the arm.
        rates: (r,) angular velocities of the first motor, rad/s.

    Raises:
        ValueError: for a passive joint without spring.
    """
    for i in free_joints(check_model(model)):
        allowed = "a number > 0 (N m/rad): the steady rotation is computed from springs at all passive joints"
        raise value_error(f"arm.joints[{i}].stiffness", model.arm.joints[i].stiffness, allowed)
    d, result = model.n_dof, []
    weightless = replace(model, constants=model.constants._replace(gravity=np.zeros(3)))
    free = np.setdiff1d(np.arange(d), model.driven_columns)
    columns, k = np.concatenate([free, d + free]), len(free)
    for rate in vector("rates", rates, unit="rad/s"):
        row = np.full(k, np.nan)
        equilibrium = _rotating_equilibrium(weightless, rate)
        if equilibrium is not None:
            state, torque = equilibrium
            mass = mass_matrix(weightless, state)
            with np.errstate(over="ignore"):  # the slope of Coulomb friction, which may overflow, is negligible
                acceleration_jacobian = continuous_model(weightless, state, torque).A[d:]
            forces = (mass @ acceleration_jacobian)[np.ix_(free, columns)]
            jacobian = np.linalg.solve(mass[np.ix_(free, free)], forces)  # with the motions of the motors prescribed
            imaginary = np.linalg.eigvals(np.block([[np.zeros((k, k)), np.eye(k)], [jacobian]])).imag
            frequencies = np.sort(imaginary[imaginary > 0.0]) / (2 * np.pi)  # one eigenvalue of each conjugate pair
            row[: len(frequencies)] = frequencies
        result.append(row)
    return np.array(result).reshape(-1, k)


def _rotating_equilibrium(model: Model, rate: float) -> tuple[Array, Array] | None:
    """Return state (2 d,) and motor torques (n,), N m, of a steady rotation at a rate (rad/s); None if not found."""
    d, n = model.n_dof, model.n_joints
    state, motors = model.initial_state(np.zeros(n), np.eye(n)[0] * rate), model.motor_columns
    free, stiffness, forces = np.setdiff1d(np.arange(d), motors), stiffness_matrix(model), inertial_forces(model)
    free_stiffness = stiffness[np.ix_(free, free)]
    for _ in range(MAX_ITERATIONS):
        balance = forces(state[:d], state[d:], np.zeros(d)) + elastic_forces(model, state[:d])
        change = np.linalg.solve(free_stiffness, balance[free])
        state[free] -= change
        if not np.isfinite(state).all() or np.abs(state).max() > MAX_COORDINATE:
            return None
        if np.abs(change).max(initial=0.0) < 1e-12 * max(1.0, float(np.abs(state).max())):
            return state, balance[motors]
    return None

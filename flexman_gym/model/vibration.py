"""Vibration modes of an arm about a static equilibrium, with its motors held or free, and of a spinning arm."""

from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np

from flexman_gym.common.arrays import Array, IntArray, Vector
from flexman_gym.common.checks import check_solvable, one_of, vector
from flexman_gym.model.dynamics import inertial_forces, mass_matrix, stiffness_matrix
from flexman_gym.model.linearization import linearize
from flexman_gym.model.model import Model, check_model
from flexman_gym.model.natural_modes import natural_modes
from flexman_gym.model.statics import holding_torques, rest_state

RIGID_BODY_LIMIT = 1e-6  # of the lowest natural frequency; slower eigenvalues are rigid-body motion
OVERDAMPED_LIMIT = 1e-7  # smallest imaginary part of an oscillatory eigenvalue, relative to its magnitude
ZERO_DAMPING = 1e-12  # damping ratio below which it is a rounded zero
SHOWN_MODES = 3  # number of modes in the repr
SPIN_ITERATIONS = 200  # limit of the iteration for the equilibrium of a spin
MAX_COORDINATE = 1e3  # m or rad; the iteration stops beyond it


class EquilibriumMatrices(NamedTuple):
    """Linearised arm about its static equilibrium, for small deviations q (d,) of its coordinates.

    Its equation of motion is mass a + damping v + stiffness q = forces.

    Attributes:
        mass: (d, d).
        damping: (d, d).
        stiffness: (d, d), including the part of gravity.
        tip: (3, d) displacement of the tip per unit coordinate.
        motors: (n,) indices of the motor coordinates.
    """

    mass: Array
    damping: Array
    stiffness: Array
    tip: Array
    motors: IntArray

    @property
    def free(self) -> IntArray:
        """Columns (d - n,) of the coordinates that move when the motors are held."""
        return np.setdiff1d(np.arange(len(self.mass)), self.motors)


class Eigenpairs(NamedTuple):
    """Complex eigenvalues with positive imaginary part and their shapes, in order of rising frequency.

    Attributes:
        values: (k,) 1/s.
        shapes: (k, d) complex coordinates, normalised to shape^T (2 s M + C) shape = 1 for an eigenvalue s, so that an
            initial state q, v excites a mode by shape^T (s M q + C q + M v).
    """

    values: Array
    shapes: Array


@dataclass(frozen=True, eq=False)
class Modes:
    """Vibration modes of an arm about a posture: k conjugate pairs of eigenvalues s of its linear model, lowest first.

    Attributes:
        frequencies: (k,) of the damped oscillation, Im s / (2 pi), Hz.
        damping_ratios: (k,) -Re s / |s|.
        shapes: (k, d) complex mode shapes in the coordinates of `kernels.layout`, normalised to unit modal mass (kg m^2
            or kg, depending on the coordinates), with their largest entry real.
        shares: (k, 2 n) shares of the n links, then of the n joints, in the elastic energy, 0 to 1.
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
            carried = ", ".join(f"{100 * shares[i]:.0f} % in {self.parts[i]}" for i in largest)
            lines.append(f"  {frequency:.6g} Hz, damping ratio {ratio:.3g}" + (f", {carried}" if carried else ""))
        return "\n".join(lines[: SHOWN_MODES + 1] + ["  ..."] * (len(self) > SHOWN_MODES)) + ">"


def modes(model: Model, joint_angles: Vector | None = None, motors: str = "held") -> Modes:
    """Return the damped vibration modes of an arm at rest under its weight.

    They are those of the linear model about the sagged equilibrium. Solutions without oscillation are left out: the
    rigid motion of a freely turning arm, and overdamped modes. Free motors slide, and their Coulomb friction does not
    damp a small oscillation (see `linearize`); a sticking motor is a held one.

    Args:
        model: model of the arm.
        joint_angles: (n,) angles of the motors, rad, zero by default.
        motors: "held" clamps the motors (the joints where they are rigid); "free" applies only their holding torques.

    Raises:
        ValueError: for an arm too compliant for its equilibrium to be found.

    Examples:
        >>> vibration = fm.modes(fm.build_model(fm.catalog.one_joint()), motors="held")
        >>> vibration.frequencies[:2].round(2), vibration.damping_ratios[:2].round(3)
        (array([ 1.41, 11.26]), array([0.004, 0.007]))
    """
    held = one_of("motors", motors, ("held", "free")) == "held"
    n = check_model(model).n_joints
    resting = equilibrium_matrices(model, np.zeros(n) if joint_angles is None else joint_angles)
    moving = resting.free if held else np.arange(model.n_dof)
    pairs = oscillatory_modes(resting, moving)
    shapes = np.zeros((len(pairs.values), model.n_dof), dtype=complex)
    shapes[:, moving] = pairs.shapes
    masses = np.einsum("ka,ab,kb->k", shapes.conj(), resting.mass, shapes).real
    largest = (
        np.take_along_axis(shapes, np.abs(shapes).argmax(axis=1)[:, None], axis=1) if shapes.size else shapes[:, :1]
    )
    shapes = shapes * (np.abs(largest) / largest) / np.sqrt(masses)[:, None]
    ratios = -pairs.values.real / np.abs(pairs.values)
    ratios[np.abs(ratios) < ZERO_DAMPING] = 0.0
    return Modes(
        frequencies=pairs.values.imag / (2.0 * np.pi),
        damping_ratios=ratios,
        shapes=shapes,
        shares=_shares(model, shapes),
        parts=tuple(f"{kind} {i}" for kind in ("link", "joint") for i in range(1, n + 1)),
        motors=motors,
        eigenvalues=pairs.values,
    )


def equilibrium_matrices(model: Model, motor_angles: Vector) -> EquilibriumMatrices:
    """Return the linearised arm about its equilibrium with the motors at angles (n,) rad.

    Args:
        model: model of the arm.
        motor_angles: (n,) rad.

    Raises:
        ValueError: for an arm too compliant for its equilibrium to be found.
    """
    linear = linearize(model, state=rest_state(model, motor_angles), torque=holding_torques(model, motor_angles))
    d, balance = model.n_dof, linear.balance
    assert balance is not None
    stiffness = -balance.forces[:, :d]
    damping = -balance.forces[:, d : 2 * d]
    return EquilibriumMatrices(
        balance.mass, (damping + damping.T) / 2.0, (stiffness + stiffness.T) / 2.0, linear.C[:, :d], model.motor_columns
    )


def oscillatory_modes(resting: EquilibriumMatrices, moving: IntArray) -> Eigenpairs:
    """Return the oscillatory modes of an arm in which only some coordinates move.

    The eigenvalues are computed in the coordinates of the undamped modes, so that low frequencies stay accurate next to
    very high ones.

    Args:
        resting: linearised arm.
        moving: (m,) columns of the coordinates that move.

    Returns:
        Eigenvalues, and shapes (k, m) over the moving coordinates.
    """
    block = np.ix_(moving, moving)
    mass, damping = resting.mass[block], resting.damping[block]
    if not len(mass):
        return Eigenpairs(np.zeros(0, dtype=complex), np.zeros((0, 0), dtype=complex))
    squares, natural = natural_modes(mass, resting.stiffness[block])
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


def elastic_energies(model: Model, coordinates: Array) -> Array:
    """Return twice the elastic energies (k, 2 n), in J, of the n links, then of the n joints, at coordinates (k, d).

    For the complex coordinates of an oscillation it is four times the mean over a cycle.
    """
    n, constants, stiffness = model.n_joints, model.constants, stiffness_matrix(model)
    energies = np.zeros((len(coordinates), 2 * n))
    for i in range(n):
        columns = model.elastic_columns(i)
        deflection, twist = coordinates[:, columns], coordinates[:, model.motor_columns[i]] - coordinates[:, i]
        energies[:, i] = np.einsum("ka,ab,kb->k", deflection.conj(), stiffness[columns, columns], deflection).real
        energies[:, n + i] = constants.joint_stiffness[i] * np.abs(twist) ** 2
    return energies


def _shares(model: Model, shapes: Array) -> Array:
    """Return the shares (k, 2 n) of links and joints in the elastic energy of shapes (k, d)."""
    energies = elastic_energies(model, shapes)
    total = energies.sum(axis=1, keepdims=True)
    return np.divide(energies, total, out=np.zeros_like(energies), where=total > 0.0)


def spin_frequencies(model: Model, rates: Vector, joint_angles: Vector | None = None) -> Array:
    """Return the natural frequencies (r, k) in Hz, ascending, of an arm that spins about its first joint.

    The motors keep their rates: the first turns, the others are at rest; gravity is left out. The model is linearised
    about the equilibrium of the spin, in which its links stiffen if it has foreshortening. A row without an equilibrium
    is NaN, and so are the last entries of a row with modes that do not oscillate.

    Args:
        model: model of the arm.
        rates: (r,) spin rates, rad/s.
        joint_angles: (n,) rad, zero by default.
    """
    d, n, result = check_model(model).n_dof, model.n_joints, []
    weightless = replace(model, constants=model.constants._replace(gravity=np.zeros(3)))
    free = np.setdiff1d(np.arange(d), model.motor_columns)
    columns, k = np.concatenate([free, d + free]), len(free)
    for rate in vector("rates", rates, unit="rad/s"):
        row = np.full(k, np.nan)
        equilibrium = _spin_equilibrium(weightless, np.zeros(n) if joint_angles is None else joint_angles, rate)
        if equilibrium is not None:
            state, torque = equilibrium
            mass = mass_matrix(weightless, state)
            with np.errstate(over="ignore"):  # of the friction slope, which is negligible in a spin
                rates_jacobian = linearize(weightless, state=state, torque=torque).A[d:]
            forces = (mass @ rates_jacobian)[np.ix_(free, columns)]
            jacobian = np.linalg.solve(mass[np.ix_(free, free)], forces)  # for any torques that hold the motors
            imaginary = np.linalg.eigvals(np.block([[np.zeros((k, k)), np.eye(k)], [jacobian]])).imag
            frequencies = np.sort(imaginary[imaginary > 0.0]) / (2 * np.pi)  # the upper half of each conjugate pair
            row[: len(frequencies)] = frequencies
        result.append(row)
    return np.array(result).reshape(-1, k)


def _spin_equilibrium(model: Model, angles: Vector, rate: float) -> tuple[Array, Array] | None:
    """Return the equilibrium state (2 d,) of a spin and its motor torques (n,) in N m, or None if there is none."""
    d, n = model.n_dof, model.n_joints
    state, motors = model.initial_state(angles, np.eye(n)[0] * rate), model.motor_columns
    free, stiffness, forces = np.setdiff1d(np.arange(d), motors), stiffness_matrix(model), inertial_forces(model)
    free_stiffness = stiffness[np.ix_(free, free)]
    for _ in range(SPIN_ITERATIONS):
        balance = forces(state[:d], state[d:], np.zeros(d)) + stiffness @ state[:d]
        change = np.linalg.solve(free_stiffness, balance[free])
        state[free] -= change
        if not np.isfinite(state).all() or np.abs(state).max() > MAX_COORDINATE:
            return None
        if np.abs(change).max(initial=0.0) < 1e-12 * max(1.0, float(np.abs(state).max())):
            return state, balance[motors]
    return None

"""Vibration: how an arm rings about a posture, with its motors held or free."""

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

SLOWEST = 1e-6  # of the lowest natural frequency: what is slower only turns
TURNING = 1e-7  # part of an eigenvalue that must be imaginary for it to ring
ROUNDING = 1e-12  # of a damping ratio
SHOWN = 3  # modes in the repr
SPIN_ITERATIONS, MAX_COORDINATE = 200, 1e3  # of the search for the equilibrium of a spin; m and rad, where it stops


class EquilibriumMatrices(NamedTuple):
    """An arm at rest under its weight, mass a + damping v + stiffness q = forces, for d small departures q from there.

    Attributes:
        mass, damping, stiffness: (d, d); the stiffness has the part of gravity.
        tip: (3, d) displacement of the tip per unit coordinate.
        motors: (n,) columns of the motors.
    """

    mass: Array
    damping: Array
    stiffness: Array
    tip: Array
    motors: IntArray

    @property
    def others(self) -> IntArray:
        """Columns (d - n,) of what does not stand still when the motors are held."""
        return np.setdiff1d(np.arange(len(self.mass)), self.motors)


class Eigenpairs(NamedTuple):
    """Pairs of complex eigenvalues of a vibration: their upper half, the slowest oscillation first.

    Attributes:
        values: (k,) 1/s.
        shapes: (k, d) complex coordinates. shape^T (2 s M + C) shape is 1 for an eigenvalue s, so that a start q, v
            excites a mode by shape^T (s M q + C q + M v).
    """

    values: Array
    shapes: Array


@dataclass(frozen=True, eq=False)
class Modes:
    """The modes of an arm about a posture, k pairs of complex eigenvalues s of its linear model, the slowest first.

    Attributes:
        frequencies: (k,) of the damped oscillation, Im s / (2 pi), Hz.
        damping_ratios: (k,) -Re s / |s|.
        shapes: (k, d) complex, coordinates in the order of `kernels.layout`; the modal mass of each is 1 (kg m^2 or
            kg, as its coordinates are), and its largest entry real.
        shares: (k, 2 n) of the n links and then of the n joints in the elastic energy, 0 to 1.
        parts: names (2 n,) of these links and joints.
        motors: "held" or "free".
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
        return "\n".join(lines[: SHOWN + 1] + ["  ..."] * (len(self) > SHOWN)) + ">"


def modes(model: Model, joint_angles: Vector | None = None, motors: str = "held") -> Modes:
    """Gives the modes of an arm that rests under its weight, with damping.

    They are those of the linear model about the place where the arm has sagged to. What does not oscillate is left
    out: the arm that turns freely, and what is damped beyond oscillation. Free motors slide, and their Coulomb friction
    damps no small oscillation, see `linearize`; a motor that sticks is a held one.

    Args:
        model: the model.
        joint_angles: (n,) rad, of the motors, zero by default.
        motors: "held" clamps the motors (the joints where they are rigid); "free" leaves them to their holding torques.

    Raises:
        ValueError: for anything but a Model, for wrong angles, for another word, and for an arm too soft to rest.

    Examples:
        >>> vibration = fm.modes(fm.build_model(fm.catalog.one_joint()), motors="held")
        >>> vibration.frequencies[:2].round(2), vibration.damping_ratios[:2].round(3)
        (array([ 1.41, 11.26]), array([0.004, 0.007]))
    """
    held = one_of("motors", motors, ("held", "free")) == "held"
    n = check_model(model).n_joints
    resting = equilibrium_matrices(model, np.zeros(n) if joint_angles is None else joint_angles)
    kept = resting.others if held else np.arange(model.n_dof)
    found = oscillatory_modes(resting, kept)
    shapes = np.zeros((len(found.values), model.n_dof), dtype=complex)
    shapes[:, kept] = found.shapes
    masses = np.einsum("ka,ab,kb->k", shapes.conj(), resting.mass, shapes).real
    largest = (
        np.take_along_axis(shapes, np.abs(shapes).argmax(axis=1)[:, None], axis=1) if shapes.size else shapes[:, :1]
    )
    shapes = shapes * (np.abs(largest) / largest) / np.sqrt(masses)[:, None]
    ratios = -found.values.real / np.abs(found.values)
    ratios[np.abs(ratios) < ROUNDING] = 0.0
    return Modes(
        frequencies=found.values.imag / (2.0 * np.pi),
        damping_ratios=ratios,
        shapes=shapes,
        shares=_shares(model, shapes),
        parts=tuple(f"{kind} {i}" for kind in ("link", "joint") for i in range(1, n + 1)),
        motors=motors,
        eigenvalues=found.values,
    )


def equilibrium_matrices(model: Model, motor_angles: Vector) -> EquilibriumMatrices:
    """Gives the arm at rest with its motors at angles (n,) rad.

    Raises:
        ValueError: for wrong angles, and for an arm too soft to rest.
    """
    linear = linearize(model, state=rest_state(model, motor_angles), torque=holding_torques(model, motor_angles))
    d, balance = model.n_dof, linear.balance
    assert balance is not None
    stiffness = -balance.forces[:, :d]
    damping = -balance.forces[:, d : 2 * d]
    return EquilibriumMatrices(
        balance.mass, (damping + damping.T) / 2.0, (stiffness + stiffness.T) / 2.0, linear.C[:, :d], model.motor_columns
    )


def oscillatory_modes(resting: EquilibriumMatrices, kept: IntArray) -> Eigenpairs:
    """Gives the modes of an arm of which only the coordinates `kept` (d,) move.

    The eigenvalues are found in the coordinates of the natural modes, so that the slow ones are exact beside stiff
    ones.
    """
    block = np.ix_(kept, kept)
    mass, damping = resting.mass[block], resting.damping[block]
    if not len(mass):
        return Eigenpairs(np.zeros(0, dtype=complex), np.zeros((0, 0), dtype=complex))
    squares, natural = natural_modes(mass, resting.stiffness[block])
    lowest = np.sqrt(squares[squares > 0.0].min(initial=np.inf))
    sizes = np.sqrt(np.maximum(np.abs(squares), lowest**2 if np.isfinite(lowest) else 1.0))
    with check_solvable("modes"):
        lost = natural.T @ damping @ natural
        values, vectors = np.linalg.eig(
            np.block([[np.zeros_like(lost), np.diag(sizes)], [-np.diag(squares / sizes), -lost]])
        )
    rings = (values.imag > TURNING * np.abs(values)) & (np.abs(values) > SLOWEST * lowest)
    rows = np.flatnonzero(rings)
    rows = rows[np.argsort(values[rows].imag, kind="stable")]
    values, modal = values[rows], (vectors[: len(mass), rows] / sizes[:, None]).T
    norm = 2.0 * values * (modal**2).sum(axis=1) + np.einsum("ka,ab,kb->k", modal, lost, modal)
    return Eigenpairs(values, (modal / np.sqrt(norm)[:, None]) @ natural.T)


def elastic_energies(model: Model, places: Array) -> Array:
    """Gives twice the elastic energies (k, 2 n) of the n links and then of the n joints at coordinates (k, d), J.

    Of complex coordinates, which turn in time, it is four times the mean.
    """
    n, constants, stiffness = model.n_joints, model.constants, stiffness_matrix(model)
    energies = np.zeros((len(places), 2 * n))
    for i in range(n):
        columns = model.elastic_columns(i)
        bent, wound = places[:, columns], places[:, model.motor_columns[i]] - places[:, i]
        energies[:, i] = np.einsum("ka,ab,kb->k", bent.conj(), stiffness[columns, columns], bent).real
        energies[:, n + i] = constants.joint_stiffness[i] * np.abs(wound) ** 2
    return energies


def _shares(model: Model, shapes: Array) -> Array:
    """Gives the shares (k, 2 n) of links and joints in the elastic energy of shapes (k, d)."""
    energies = elastic_energies(model, shapes)
    total = energies.sum(axis=1, keepdims=True)
    return np.divide(energies, total, out=np.zeros_like(energies), where=total > 0.0)


def spin_frequencies(model: Model, rates: Vector, joint_angles: Vector | None = None) -> Array:
    """Return the natural frequencies (r, k) of an arm that spins about its first joint, Hz, ascending.

    The motors keep their rates: the first turns, the others stand still; gravity is left out. The arm is in the
    equilibrium of the spin, and its links stiffen if the model has foreshortening. A row is nan without such an
    equilibrium, and its last entries are nan for modes that do not oscillate.

    Args:
        model: model of the arm.
        rates: (r,) rad/s.
        joint_angles: (n,) rad, zero by default.

    Raises:
        ValueError: for wrong shapes and values that are not finite.
    """
    d, n, result = check_model(model).n_dof, model.n_joints, []
    light = replace(model, constants=model.constants._replace(gravity=np.zeros(3)))
    others = np.setdiff1d(np.arange(d), model.motor_columns)
    kept, k = np.concatenate([others, d + others]), len(others)
    for rate in vector("rates", rates, unit="rad/s"):
        row = np.full(k, np.nan)
        spinning = _spin_equilibrium(light, np.zeros(n) if joint_angles is None else joint_angles, rate)
        if spinning is not None:
            state, torque = spinning
            mass = mass_matrix(light, state)
            with np.errstate(over="ignore"):  # of the slope of friction, which spin leaves behind
                whole = linearize(light, state=state, torque=torque).A[d:]
            demands = (mass @ whole)[np.ix_(others, kept)]
            slopes = np.linalg.solve(mass[np.ix_(others, others)], demands)  # whatever torques hold the motors
            rings = np.linalg.eigvals(np.block([[np.zeros((k, k)), np.eye(k)], [slopes]])).imag
            found = np.sort(rings[rings > 0.0]) / (2 * np.pi)  # of each pair its upper half
            row[: len(found)] = found
        result.append(row)
    return np.array(result).reshape(-1, k)


def _spin_equilibrium(model: Model, angles: Vector, rate: float) -> tuple[Array, Array] | None:
    """Return the equilibrium state (2 d,) of a spin and its torques (n,) N m; None without one."""
    d, n = model.n_dof, model.n_joints
    state, motors = model.initial_state(angles, np.eye(n)[0] * rate), model.motor_columns
    others, stiffness, forces = np.setdiff1d(np.arange(d), motors), stiffness_matrix(model), inertial_forces(model)
    inner = stiffness[np.ix_(others, others)]
    for _ in range(SPIN_ITERATIONS):
        balance = forces(state[:d], state[d:], np.zeros(d)) + stiffness @ state[:d]
        moved = np.linalg.solve(inner, balance[others])
        state[others] -= moved
        if not np.isfinite(state).all() or np.abs(state).max() > MAX_COORDINATE:
            return None
        if np.abs(moved).max(initial=0.0) < 1e-12 * max(1.0, float(np.abs(state).max())):
            return state, balance[motors]
    return None

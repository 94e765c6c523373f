"""Vibration modes excited by the motors and observable at the tip, with motors held, free or under position servos."""

import numpy as np

from flexman_gym.common.arrays import Array, Vector
from flexman_gym.common.checks import flag, physical
from flexman_gym.model.dynamics import inertial_forces
from flexman_gym.model.model import Model, check_model
from flexman_gym.model.statics import rest_state
from flexman_gym.model.vibration import Eigenpairs, EquilibriumMatrices

RIGID_MODE_RATIO = 0.5  # fraction of the lowest frequency with held motors; slower modes are rigid-body motion
RATIO_ROUNDING = 1e-9  # dimensionless; smaller damping ratios are set to 0
SERVO_DAMPING = 0.7  # damping ratio of a rigid arm under a position servo
MIN_TIP_AMPLITUDE = 1e-3  # fraction of the largest tip amplitude; modes with smaller amplitudes are omitted


def excited_modes(model: Model, posture: Vector, held: bool = True, servo: float | None = None) -> Array:
    """Return the modes (k, 3) excited by the motors and observable at the tip of an arm at rest, the lowest first.

    A mode is a pair of complex eigenvalues s of the linear model, see `model.vibration`. The columns are the natural
    frequency |s| / (2 pi), Hz; the damping ratio -Re s / |s|; and the largest tip amplitude caused by one motor: in m
    after a step of 1 rad of a held motor, or after an impulse of 1 N m s on a free one. Constraints raise frequencies
    (Rayleigh), so that an arm with free motors has no mode below the lowest mode with held motors, except for rotation,
    or the pendulum motion under gravity, of the whole arm, which is omitted.

    Args:
        model: model of the arm.
        posture: (n,) motor angles, rad.
        held: True for motors held in position; False for motors free to turn under constant holding torques.
        servo: bandwidth of position servos that hold the motors, Hz; None for motors that do not move. Their stiffness
            and damping give a rigid arm, with all other motors locked, a damping ratio of SERVO_DAMPING.

    Raises:
        ValueError: for a posture of wrong shape, and an arm without an equilibrium.
    """
    resting = EquilibriumMatrices.of(check_model(model), posture)
    if servo is not None:
        return _servo_modes(resting, 2.0 * np.pi * physical("servo", servo, "Hz"))
    motors, others = resting.motors, resting.free
    inertia, springs = (matrix[np.ix_(others, others)] for matrix in (resting.mass, resting.stiffness))
    result = np.zeros((0, 3))
    if len(others):
        # a step of a motor moves the links at once by inertia; springs then pull them to the equilibrium
        inertial = -np.linalg.solve(inertia, resting.mass[np.ix_(others, motors)])
        starts = inertial + np.linalg.solve(springs, resting.stiffness[np.ix_(others, motors)])
        eigen = resting.oscillatory_modes(others)
        damping = resting.damping[np.ix_(others, others)]
        excited = [shape @ (value * inertia + damping) @ starts for value, shape in zip(*eigen, strict=True)]
        result = _observable_modes(eigen, np.array(excited), resting.tip[:, others])
    if flag("held", held) or not len(result):
        return result
    eigen = resting.oscillatory_modes(np.arange(model.n_dof))
    above = np.abs(eigen.values) > 2.0 * np.pi * RIGID_MODE_RATIO * result[0, 0]
    return _observable_modes(
        Eigenpairs(eigen.values[above], eigen.shapes[above]), eigen.shapes[np.ix_(above, motors)], resting.tip
    )


def travel_modes(model: Model, posture: Vector, axis: Vector) -> Array:
    """Return the modes (k, 3) of an arm with held motors that the travel of its base excites, the lowest first.

    Columns as in `excited_modes`; the tip amplitude, m, is that after a change of the velocity by 1 m/s.

    Args:
        model: model of the arm.
        posture: (n,) motor angles, rad.
        axis: (3,) direction of the travel, base frame.
    """
    resting = EquilibriumMatrices.of(check_model(model), posture)
    rest = np.zeros(model.n_dof)
    inertial = inertial_forces(model, np.array(axis))(rest_state(model, posture)[: model.n_dof], rest, rest)
    eigen = resting.oscillatory_modes(resting.free)
    amplitudes = eigen.shapes @ inertial[resting.free]
    return _observable_modes(eigen, amplitudes[:, None], resting.tip[:, resting.free])


def _servo_modes(resting: EquilibriumMatrices, bandwidth: float) -> Array:
    """Return the modes (k, 3) of an arm under position servos of a bandwidth (rad/s), see `excited_modes`."""
    motors, others, turned = resting.motors, resting.free, np.zeros((len(resting.mass), len(resting.motors)))
    turned[motors, np.arange(len(motors))] = 1.0
    turned[others] = -np.linalg.solve(
        resting.stiffness[np.ix_(others, others)], resting.stiffness[np.ix_(others, motors)]
    )
    inertia = np.einsum("am,ab,bm->m", turned, resting.mass, turned)
    stiffness, damping = resting.stiffness.copy(), resting.damping.copy()
    stiffness[motors, motors] += inertia * bandwidth**2
    damping[motors, motors] += 2.0 * SERVO_DAMPING * inertia * bandwidth
    closed = resting._replace(stiffness=stiffness, damping=damping)
    eigen = closed.oscillatory_modes(np.arange(len(closed.mass)))
    pairs = zip(*eigen, strict=True)
    amplitudes = [shape @ (value * closed.mass + damping) @ turned for value, shape in pairs]
    return _observable_modes(eigen, np.array(amplitudes).reshape(-1, len(motors)), closed.tip)


def _observable_modes(eigen: Eigenpairs, amplitudes: Array, tip: Array) -> Array:
    """Return the modes (k, 3) with sufficient tip amplitude, from complex modal amplitudes by each motor (k, n)."""
    tip_amplitudes = 2.0 * np.linalg.norm(eigen.shapes @ tip.T, axis=1) * np.abs(amplitudes).max(axis=1, initial=0.0)
    kept = np.flatnonzero(tip_amplitudes > MIN_TIP_AMPLITUDE * tip_amplitudes.max(initial=0.0))
    rates = np.abs(eigen.values)
    kept = kept[np.argsort(rates[kept])]
    ratios = -eigen.values[kept].real / rates[kept]
    ratios[np.abs(ratios) < RATIO_ROUNDING] = 0.0
    return np.transpose([rates[kept] / (2.0 * np.pi), ratios, tip_amplitudes[kept]])

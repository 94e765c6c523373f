"""Stability margins of the sampled PD loop, with sliding and with sticking motors.

A motor with Coulomb friction c slides or sticks. Friction of a sliding motor is a constant torque, which does not damp
small deviations; a sticking motor is clamped. A loop may be stable with one set of sticking motors and unstable with
another set, so that each set defines a loop and the worst loop determines the margins. The slope of a smoothed friction
law at rest, equivalent to a damper of a hundred times c, is excluded: with this damper every gain would appear safe.
Friction stops an unstable loop after a small disturbance only, and therefore adds nothing to the margins.
"""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import combinations
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from flexman_gym.common.arrays import Array, IntArray, Vector
from flexman_gym.common.errors import value_error
from flexman_gym.model.model import Model
from flexman_gym.model.state_space import LinearModel, first_order_lag
from flexman_gym.model.statics import holding_torques, rest_state
from flexman_gym.simulation.linearization import linearize

GAIN_FACTORS = np.geomspace(1.0, 16.0, 25)  # dimensionless; candidate gain margins
PHASE_SHIFTS = np.linspace(0.0, 90.0, 19)  # degrees; candidate phase margins
IMAGINARY_DEGREE = 1j * np.pi / 180.0  # logarithm of the factor exp(i phase) of a phase shift of 1 degree
STABLE_RADIUS = 1.0 + 1e-9  # dimensionless; bound of the spectral radius; it is 1 for undamped uncontrollable modes
Response = NDArray[np.complex128]


class SampledLoop(NamedTuple):
    """Linear model of an arm about a posture with sampled torques: x[k + 1] = transition x[k] + inputs torques[k].

    Attributes:
        transition: (m, m) state matrix; the state x consists of coordinates, rates and delayed torques. Rows and
            columns of sticking motors are zero.
        inputs: (m, n) input matrix.
        motors: (n,) columns of the motor angles in x; n motors, without passive joints.
        rates: (n,) columns of the motor rates in x.
        stuck: indices, from 0, of the joints with sticking motors.
        joints: indices, from 0, of the n joints with motors among all joints.
    """

    transition: Array
    inputs: Array
    motors: Array
    rates: Array
    stuck: tuple[int, ...] = ()
    joints: tuple[int, ...] = ()

    def spectral_radius(self, stiffness: Vector, damping: Vector) -> float:
        """Return the spectral radius of the loop closed by a PD; below 1 the loop is stable."""
        return float(np.abs(np.linalg.eigvals(self.transition - self.inputs @ _gain(self, stiffness, damping))).max())

    def open_loop_responses(self, stiffness: Vector, damping: Vector, frequencies: Vector, period: float) -> Response:
        """Return complex open-loop responses (n, f) of a PD: the loop of one motor is opened, all others are closed.

        Args:
            stiffness: (n,) proportional gains, N m/rad.
            damping: (n,) derivative gains, N m s/rad.
            frequencies: (f,) Hz, below half the sampling frequency.
            period: sampling period, s.
        """
        n, size = self.inputs.shape[1], len(self.transition)
        gain, result = _gain(self, stiffness, damping), []
        points = np.exp(2j * np.pi * period * np.asarray(frequencies, dtype=float))
        for motor in range(n):
            closed = np.where(np.arange(n) == motor, 0.0, 1.0)[:, None] * gain
            resolvent = points[:, None, None] * np.eye(size) - (self.transition - self.inputs @ closed)  # its inverse
            result.append(np.linalg.solve(resolvent, self.inputs[:, motor][None, :, None])[..., 0] @ gain[motor])
        return np.array(result)


class Margins(NamedTuple):
    """Stability margins (gain and phase) of a loop.

    Attributes:
        gain: gain margin, 1: a factor on the torques of any one motor or of all motors.
        phase: phase margin, a lag or lead of the torques of any one motor or of all motors, degrees.
        stuck: indices, from 0, of the joints with sticking motors in the worst loop: an unstable loop, or the loop with
            the smallest gain margin.
    """

    gain: float
    phase: float
    stuck: tuple[int, ...] = ()


MIN_MARGINS = Margins(2.0, 30.0)  # 1, degrees; smallest gain margin and phase margin of tuned gains


def sampled_loops(
    model: Model, joint_angles: Vector, period: float, delay: int = 0, bandwidth: float | None = None
) -> list[SampledLoop]:
    """Return the loops of an arm at rest, one for each set of motors that may stick.

    The first loop has sliding motors only; an arm without Coulomb friction has no further loop. The set of all motors
    is excluded, since the gains have no effect if every motor sticks.

    Args:
        model: model of the arm.
        joint_angles: (n,) joint angles, rad.
        period: control period, s.
        delay: delay of the torques, whole control periods.
        bandwidth: bandwidth of a first-order lag of the drives, Hz, see `first_order_lag`; None for no lag.

    Raises:
        ValueError: for an arm whose joints are all passive.
    """
    if not len(model.driven_columns):
        raise value_error("arm.joints", "passive joints", "a joint with a motor: loops are closed by motors")
    linear = _at_rest(model, joint_angles)
    return [_loop(model, linear, stuck, period, delay, bandwidth) for stuck in _stuck_sets(model)]


def _at_rest(model: Model, joint_angles: Vector) -> LinearModel:
    """Return the linear model about the equilibrium at joint angles (n,) rad, with sliding motors."""
    return linearize(model, state=rest_state(model, joint_angles), torque=holding_torques(model, joint_angles))


def _stuck_sets(model: Model) -> Iterator[tuple[int, ...]]:
    """Yield the sets of joints whose motors may stick, the empty set first and the set of all joints excluded."""
    frictional = np.flatnonzero((model.constants.coulomb_friction > 0.0) & (model.constants.passive == 0)).tolist()
    for count in range(min(len(frictional) + 1, len(model.driven_columns))):
        yield from combinations(frictional, count)


def _loop(
    model: Model, linear: LinearModel, stuck: tuple[int, ...], period: float, delay: int, bandwidth: float | None
) -> SampledLoop:
    """Return the sampled loop of a linear model with the sticking motors clamped."""
    motors, n, d = model.driven_columns, len(model.driven_columns), model.n_dof
    columns = model.motor_columns[list(stuck)]
    clamped = np.concatenate([columns, d + columns])
    sampled = (_clamped(linear, columns) if stuck else linear).discrete(period, delay * period)
    delayed, entry = sampled.A, sampled.B
    delayed[clamped], delayed[:, clamped], entry[clamped] = 0.0, 0.0, 0.0
    if bandwidth is not None:
        remaining, mean = first_order_lag(period, bandwidth)
        delayed = np.block([[delayed, mean * entry], [np.zeros((n, len(delayed))), remaining * np.eye(n)]])
        entry = np.vstack([(1.0 - mean) * entry, (1.0 - remaining) * np.eye(n)])
    return SampledLoop(delayed, entry, motors, d + motors, stuck, tuple(np.flatnonzero(model.constants.passive == 0)))


def _clamped(linear: LinearModel, columns: IntArray) -> LinearModel:
    """Return a linear model with clamped coordinates (k,); the order of the states is unchanged."""
    assert linear.balance is not None
    mass, forces, _ = linear.balance
    d, free = len(mass), np.setdiff1d(np.arange(len(mass)), columns)
    A, B = np.zeros_like(linear.A), np.zeros_like(linear.B)
    moving = np.concatenate([free, d + free])
    scale = np.sqrt(np.diag(mass)[free])  # equilibrates metres and radians
    demands = forces[np.ix_(free, [*moving, *range(2 * d, forces.shape[1])])]
    derivatives = np.linalg.solve(mass[np.ix_(free, free)] / np.outer(scale, scale), demands / scale[:, None])
    derivatives /= scale[:, None]
    A[free, d + free] = 1.0
    A[np.ix_(d + free, moving)], B[d + free] = derivatives[:, : len(moving)], derivatives[:, len(moving) :]
    return replace(linear, A=A, B=B, balance=None)


def margins(loops: Sequence[SampledLoop], stiffness: Vector, damping: Vector) -> Margins:
    """Return the least gain margin (1) and phase margin (degrees) of a PD over loops and motors; 1 and 0 if unstable.

    A margin is the smallest change of the torques for which an eigenvalue of the closed loop leaves the unit circle.
    The torques of any one motor, or of all motors, are multiplied by a factor >= 1, or by exp(+-i phase).

    Args:
        loops: from `sampled_loops`.
        stiffness: (n,) proportional gains, N m/rad.
        damping: (n,) derivative gains, N m s/rad.
    """
    smallest, stable = [], np.ones(len(loops), dtype=bool)
    for values, changes in ((GAIN_FACTORS, GAIN_FACTORS), (PHASE_SHIFTS, np.exp(IMAGINARY_DEGREE * PHASE_SHIFTS))):
        passed = np.array([[_stable(loop, stiffness, damping, change) for change in changes] for loop in loops])
        failed = np.argmin(np.column_stack([passed, np.zeros(len(loops), dtype=bool)]), axis=1)  # first unstable change
        smallest.append(values[np.maximum(failed - 1, 0)])
        stable &= failed > 0
    gains, phases = smallest
    worst = loops[int(np.lexsort((phases, gains, stable))[0])]
    return Margins(float(gains.min()), float(phases.min()), worst.stuck)


def has_margins(loops: Sequence[SampledLoop], stiffness: Vector, damping: Vector, least: Margins) -> bool:
    """Return True if the loops are stable and remain stable with the gain factor and the phase shift of `least`."""
    changes = (1.0, least.gain, np.exp(IMAGINARY_DEGREE * least.phase))
    return all(_stable(loop, stiffness, damping, change) for change in changes for loop in loops)


def describe_stuck_motors(stuck: Sequence[int]) -> str:
    """Return a clause that names the sticking motors, counted from 1, for messages; "" without sticking motors."""
    return f" while friction holds motor {' and '.join(str(joint + 1) for joint in stuck)}" if stuck else ""


def _gain(loop: SampledLoop, stiffness: Vector, damping: Vector) -> Array:
    """Return the gain (n, m) of a PD for the state of a loop; its gains are those of the n motors, or of all joints."""
    n, gain = loop.inputs.shape[1], np.zeros(loop.inputs.T.shape)
    if len(stiffness) != n:
        stiffness, damping = (np.asarray(each)[list(loop.joints)] for each in (stiffness, damping))
    gain[np.arange(n), loop.motors], gain[np.arange(n), loop.rates] = stiffness, damping
    return gain


def _stable(loop: SampledLoop, stiffness: Vector, damping: Vector, change: complex) -> bool:
    """Return True if a loop is stable with the torques of any one motor, and of all motors, multiplied by `change`."""
    n, gain = loop.inputs.shape[1], _gain(loop, stiffness, damping)
    motors = np.ones((1, n)) if n == 1 or change == 1.0 else np.vstack([np.eye(n), np.ones(n)])
    closed = loop.transition - (loop.inputs * (1.0 + motors[:, None] * (change - 1.0))) @ gain
    return bool((np.abs(np.linalg.eigvals(closed)) < STABLE_RADIUS).all())

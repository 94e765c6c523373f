"""Margins: how far the sampled loop of a PD is from instability."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from flexman_gym.arrays import Array, Vector
from flexman_gym.model.linear import linearize
from flexman_gym.model.model import Model
from flexman_gym.model.statics import holding_torques, rest_state

FACTORS, PHASES = np.geomspace(1.0, 16.0, 25), np.linspace(0.0, 90.0, 19)  # degrees, at which margins are looked for
TURN = 1j * np.pi / 180.0  # by a degree
Response = NDArray[np.complex128]


class Loop(NamedTuple):
    """An arm about a posture as sampled torques move it: next = transition x + inputs torques.

    Attributes:
        transition: (m, m) of coordinates, speeds and the torques that are on their way.
        inputs: (m, n).
        motors: (n,) columns of the motor angles.
        rates: (n,) columns of the motor rates.
    """

    transition: Array
    inputs: Array
    motors: Array
    rates: Array


class Margins(NamedTuple):
    """What a loop bears before it is unstable.

    Attributes:
        gain: factor of the torques of one motor or of all.
        phase: by which the torques of one motor or of all lag or lead, degrees.
    """

    gain: float
    phase: float


def sampled_loop(
    model: Model, joint_angles: Vector, period: float, delay: int = 0, bandwidth: float | None = None
) -> Loop:
    """Gives the loop of an arm at rest at joint angles (n,) rad whose torques come `delay` periods (s) late.

    With a bandwidth (Hz) the drives lag besides, see `lag`; what they have reached belongs to the state.
    """
    linear = linearize(model, state=rest_state(model, joint_angles), torque=holding_torques(model, joint_angles))
    sampled = linear.discrete(period, delay * period)
    late, entry, n = sampled.A, sampled.B, model.n_joints
    if bandwidth is not None:
        left, mean = lag(period, bandwidth)
        late = np.block([[late, mean * entry], [np.zeros((n, len(late))), left * np.eye(n)]])
        entry = np.vstack([(1.0 - mean) * entry, (1.0 - left) * np.eye(n)])
    return Loop(late, entry, model.motor_columns, model.n_dof + model.motor_columns)


def lag(period: float, bandwidth: float) -> tuple[float, float]:
    """Gives how a first-order lag of a bandwidth (Hz) passes a period (s) in which it is asked for the same.

    Returns:
        The parts of the distance to what is asked for that are left at the end of the period, and in its mean.
    """
    turned = 2.0 * np.pi * bandwidth * period
    return float(np.exp(-turned)), float(-np.expm1(-turned) / turned)


def margins(loops: Sequence[Loop], stiffness: Vector, damping: Vector) -> Margins:
    """Gives the least margins of a PD over loops, (1, 0) where one of these is unstable.

    A margin is the least change of the torques with which an eigenvalue of the closed loop leaves the unit circle:
    those of one motor, or those of all, are multiplied by a factor >= 1, or by exp(+-i phase).

    Args:
        loops: of `sampled_loop`.
        stiffness: (n,) N m/rad.
        damping: (n,) N m s/rad.
    """
    result = []
    for values, changes in ((FACTORS, FACTORS), (PHASES, np.exp(TURN * PHASES))):
        good = np.array([[_stable(loop, stiffness, damping, change) for change in changes] for loop in loops])
        first = int(np.argmin(np.append(good.all(axis=0), False)))  # that is not borne
        result.append(float(values[max(first - 1, 0)]))
    return Margins(*result)


def has_margins(loops: Sequence[Loop], stiffness: Vector, damping: Vector, least: Margins) -> bool:
    """Whether loops are stable as they are and with both of the changes at the end of the least margins."""
    changes = (1.0, least.gain, np.exp(TURN * least.phase))
    return all(_stable(loop, stiffness, damping, change) for change in changes for loop in loops)


def spectral_radius(loop: Loop, stiffness: Vector, damping: Vector) -> float:
    """Gives the largest magnitude of an eigenvalue of a loop that a PD closes; below 1 where it is stable."""
    return float(np.abs(np.linalg.eigvals(loop.transition - loop.inputs @ _gain(loop, stiffness, damping))).max())


def _gain(loop: Loop, stiffness: Vector, damping: Vector) -> Array:
    """The gain (n, m) of a PD on the state of a loop."""
    n, gain = loop.inputs.shape[1], np.zeros(loop.inputs.T.shape)
    gain[np.arange(n), loop.motors], gain[np.arange(n), loop.rates] = stiffness, damping
    return gain


def _stable(loop: Loop, stiffness: Vector, damping: Vector, change: complex) -> bool:
    """Whether a loop is stable while the torques of any one motor, and those of all, are multiplied by a number."""
    n, gain = loop.inputs.shape[1], _gain(loop, stiffness, damping)
    motors = np.ones((1, n)) if n == 1 or change == 1.0 else np.vstack([np.eye(n), np.ones(n)])
    closed = loop.transition - (loop.inputs * (1.0 + motors[:, None] * (change - 1.0))) @ gain
    return bool((np.abs(np.linalg.eigvals(closed)) < 1.0).all())


def open_loops(loop: Loop, stiffness: Vector, damping: Vector, frequencies: Vector, period: float) -> Response:
    """Gives the responses (n, f) of a PD's loops, each opened at one motor while the others act.

    Args:
        loop: of `sampled_loop`.
        stiffness: (n,) N m/rad.
        damping: (n,) N m s/rad.
        frequencies: (f,) Hz, below half the sampling frequency.
        period: of sampling, s.
    """
    n, size = loop.inputs.shape[1], len(loop.transition)
    gain, result = np.zeros((n, size)), []
    gain[np.arange(n), loop.motors], gain[np.arange(n), loop.rates] = stiffness, damping
    turns = np.exp(2j * np.pi * period * np.asarray(frequencies, dtype=float))
    for motor in range(n):
        acting = np.where(np.arange(n) == motor, 0.0, 1.0)[:, None] * gain
        others = turns[:, None, None] * np.eye(size) - (loop.transition - loop.inputs @ acting)
        result.append(np.linalg.solve(others, loop.inputs[:, motor][None, :, None])[..., 0] @ gain[motor])
    return np.array(result)

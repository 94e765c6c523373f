"""Margins: how far the sampled loop of a PD is from instability."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from flexman_gym.arrays import Array, Vector
from flexman_gym.control.discrete import zero_order_hold
from flexman_gym.model.linear import linearize
from flexman_gym.model.model import Model
from flexman_gym.model.statics import holding_torques, rest_state

FACTORS, PHASES = np.geomspace(1.0, 16.0, 25), np.linspace(0.0, 90.0, 19)  # degrees, at which margins are looked for
TURN = 1j * np.pi / 180.0  # by a degree


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


def sampled_loop(model: Model, joint_angles: Vector, period: float, delay: int = 0) -> Loop:
    """Gives the loop of an arm at rest at joint angles (n,) rad whose torques come `delay` periods (s) late."""
    linear = linearize(model, state=rest_state(model, joint_angles), torque=holding_torques(model, joint_angles))
    transition, inputs = zero_order_hold(linear, period)
    size, n = inputs.shape
    late = np.zeros((size + delay * n, size + delay * n))
    late[:size, :size] = transition
    entry = np.vstack([inputs, np.zeros((delay * n, n))])
    if delay:  # the newest torques stand first, the oldest act
        late[:size, -n:], entry[:size] = inputs, 0.0
        late[size + n :, size:-n] = np.eye((delay - 1) * n)
        entry[size : size + n] = np.eye(n)
    return Loop(late, entry, model.motor_columns, model.n_dof + model.motor_columns)


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


def _stable(loop: Loop, stiffness: Vector, damping: Vector, change: complex) -> bool:
    """Whether a loop is stable while the torques of any one motor, and those of all, are multiplied by a number."""
    n, m = loop.inputs.shape[1], len(loop.transition)
    gain = np.zeros((n, m))
    gain[np.arange(n), loop.motors], gain[np.arange(n), loop.rates] = stiffness, damping
    motors = np.ones((1, n)) if n == 1 or change == 1.0 else np.vstack([np.eye(n), np.ones(n)])
    closed = loop.transition - (loop.inputs * (1.0 + motors[:, None] * (change - 1.0))) @ gain
    return bool((np.abs(np.linalg.eigvals(closed)) < 1.0).all())

"""Modes: how an arm vibrates about a posture, with its motors held or free."""

import numpy as np

from flexman_gym.arrays import Array, Vector
from flexman_gym.checks import flag
from flexman_gym.model.linear import linearize
from flexman_gym.model.model import Model, checked_model
from flexman_gym.model.statics import holding_torques, rest_state

SLOWER = 0.5  # of the lowest mode with held motors: what is slower still is the arm turning about its motors
ROUNDING = 1e-9  # of a damping ratio
UNSEEN = 1e-3  # of the most that a mode moves the tip: one that moves it less is left out


def ringing_modes(model: Model, posture: Vector, held: bool = True) -> Array:
    """Gives the modes (k, 3) that motors excite and the tip feels, of an arm at rest: the lowest first.

    A mode is a pair of complex eigenvalues s of the linear model. It has a natural frequency |s| / (2 pi) in Hz, a
    damping ratio -Re s / |s|, and an amplitude of the tip, the most that one motor causes: in m after a held motor has
    been stepped by 1 rad, in m after a free one has had an impulse of 1 N m s. Constraints raise frequencies
    (Rayleigh), so that free motors leave no mode below
    the lowest one with held motors, but for the arm that turns, or swings in gravity, as a whole. That is left out.

    Args:
        model: of the arm.
        posture: (n,) rad, of the motors.
        held: whether the motors are held, by whatever torques that takes; free ones carry the holding torques.

    Raises:
        ValueError: for a posture of wrong shape, and for an arm too soft to rest.
    """
    state = rest_state(checked_model(model), posture)
    linear = linearize(model, state=state, torque=holding_torques(model, posture))
    d, motors = model.n_dof, model.motor_columns
    rows, inputs, tip = linear.A[d:], linear.B[d:], linear.C[:, :d]
    # accelerations of all coordinates by those of the motors, and what is left where the motors have none
    carried = inputs @ np.linalg.inv(inputs[motors])
    still, rest = rows - carried @ rows[motors], np.setdiff1d(np.arange(d), motors)
    # a step carries along what hangs on a motor; springs draw it to where it rests
    drawn = np.linalg.solve(still[np.ix_(rest, rest)], still[np.ix_(rest, motors)]) + carried[rest]
    result = _oscillating(still[np.ix_(rest, np.append(rest, d + rest))], drawn, tip[:, rest])
    if flag("held", held) or not len(result):
        return result
    return _oscillating(rows, np.vstack([np.zeros_like(inputs), inputs]), tip, SLOWER * result[0, 0])


def _oscillating(rows: Array, starts: Array, tip: Array, above: float = 0.0) -> Array:
    """Modes above a frequency of accelerations rows (d, 2 d) x, after starts (d or 2 d, n) that each motor causes."""
    d = len(rows)
    values, shapes = np.linalg.eig(np.vstack([np.eye(2 * d)[d:], rows]))
    caused = np.linalg.inv(shapes)[:, : len(starts)] @ starts
    moved = 2.0 * np.linalg.norm(tip @ shapes[:d], axis=0) * np.abs(caused).max(axis=1)
    sizes = np.abs(values)
    upper = (values.imag > 0.0) & (sizes > 2.0 * np.pi * above)
    kept = np.flatnonzero(upper & (moved > UNSEEN * moved[upper].max(initial=0.0)))
    kept = kept[np.argsort(sizes[kept])]
    ratios = -values[kept].real / sizes[kept]
    ratios[np.abs(ratios) < ROUNDING] = 0.0
    return np.transpose([sizes[kept] / (2.0 * np.pi), ratios, moved[kept]])

"""Modes: how an arm vibrates about a posture, with its motors held or free."""

import numpy as np

from flexman_gym.arrays import Array, Vector
from flexman_gym.checks import flag
from flexman_gym.model.model import Model, checked_model
from flexman_gym.model.vibration import Eigen, at_rest, oscillations

SLOWER = 0.5  # of the lowest mode with held motors: what is slower still is the arm turning about its motors
ROUNDING = 1e-9  # of a damping ratio
UNSEEN = 1e-3  # of the most that a mode moves the tip: one that moves it less is left out


def ringing_modes(model: Model, posture: Vector, held: bool = True) -> Array:
    """Gives the modes (k, 3) that motors excite and the tip feels, of an arm at rest: the lowest first.

    A mode is a pair of complex eigenvalues s of the linear model, see `model.vibration`. It has a natural frequency
    |s| / (2 pi) in Hz, a damping ratio -Re s / |s|, and an amplitude of the tip, the most that one motor causes: in m
    after a held motor has been stepped by 1 rad, in m after a free one has had an impulse of 1 N m s. Constraints raise
    frequencies (Rayleigh), so that free motors leave no mode below the lowest one with held motors, but for the arm
    that turns, or swings in gravity, as a whole. That is left out.

    Args:
        model: of the arm.
        posture: (n,) rad, of the motors.
        held: whether the motors are held, by whatever torques that takes; free ones carry the holding torques.

    Raises:
        ValueError: for a posture of wrong shape, and for an arm too soft to rest.
    """
    resting = at_rest(checked_model(model), posture)
    motors, others = resting.motors, resting.others
    inertia, springs = (matrix[np.ix_(others, others)] for matrix in (resting.mass, resting.stiffness))
    result = np.zeros((0, 3))
    if len(others):
        # a step carries along what hangs on a motor; springs draw it to where it rests
        carried = -np.linalg.solve(inertia, resting.mass[np.ix_(others, motors)])
        starts = carried + np.linalg.solve(springs, resting.stiffness[np.ix_(others, motors)])
        eigen = oscillations(resting, others)
        lost = resting.damping[np.ix_(others, others)]
        caused = [shape @ (value * inertia + lost) @ starts for value, shape in zip(*eigen, strict=True)]
        result = _felt(eigen, np.array(caused), resting.tip[:, others])
    if flag("held", held) or not len(result):
        return result
    every = np.arange(model.n_dof)
    eigen = oscillations(resting, every)
    above = np.abs(eigen.values) > 2.0 * np.pi * SLOWER * result[0, 0]
    return _felt(Eigen(eigen.values[above], eigen.shapes[above]), eigen.shapes[np.ix_(above, motors)], resting.tip)


def _felt(eigen: Eigen, caused: Array, tip: Array) -> Array:
    """Modes (k, 3) that the tip feels, of those that motors excite by (k, n)."""
    moved = 2.0 * np.linalg.norm(eigen.shapes @ tip.T, axis=1) * np.abs(caused).max(axis=1, initial=0.0)
    kept = np.flatnonzero(moved > UNSEEN * moved.max(initial=0.0))
    sizes = np.abs(eigen.values)
    kept = kept[np.argsort(sizes[kept])]
    ratios = -eigen.values[kept].real / sizes[kept]
    ratios[np.abs(ratios) < ROUNDING] = 0.0
    return np.transpose([sizes[kept] / (2.0 * np.pi), ratios, moved[kept]])

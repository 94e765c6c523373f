"""Peers, decay: what a step of an integrator alone takes from the lowest mode of the arm, which has no damping."""

from collections.abc import Iterator, Sequence

import numpy as np

import flexman_gym as fm
from flexman_gym.simulation.amplification import vibration_factor
from studies.precision.measure import Row

OURS, MODEL, PIECES = {"midpoint_2_sweeps": 2.5e-3, "gauss_3_sweeps": 1e-2}, "MuJoCo, 4 pieces", 4  # methods, steps (s)


def decay(factor: complex, step: float) -> float:
    """The part of the amplitude of a vibration that is lost in a second, from its factor of a step (s)."""
    return 1.0 - float(abs(factor)) ** (1.0 / step)


def decays(arm: fm.Arm, rows: Sequence[Row]) -> Iterator[tuple[str, float, float]]:
    """Names of methods, their steps (s) and decays: of ours, and of MuJoCo's at the steps of its runs."""
    omega = 2.0 * np.pi * float(fm.frequencies(fm.build_model(arm, elements=3))[len(arm.joints)])
    for name, step in OURS.items():
        yield f"ours, {name}", step, decay(vibration_factor(fm.METHODS[name], omega * step), step)
    for name, step in ((row.method, row.step or 0.0) for row in rows if row.model == MODEL):
        from studies.peers.mujoco import step_factors

        factors = step_factors(arm, PIECES, name, step)
        factor = factors[np.abs(factors - np.exp(1j * omega * step)).argmin()]  # the mode's own
        yield f"{MODEL}, {name}", step, decay(factor, step)

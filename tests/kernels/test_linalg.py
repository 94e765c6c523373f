"""Sine and versine against values in extended precision."""

import numba
import numpy as np
import pytest

from flexman_gym.kernels.compile import FLAGS
from flexman_gym.kernels.linalg import sine_versine


@numba.njit(**FLAGS)
def compute(angles, sines, versines):
    """Compute sines and versines of angles (rad)."""
    for i in range(len(angles)):
        sines[i], versines[i] = sine_versine(angles[i])


@pytest.mark.parametrize("reach", [1e-9, 1e-3, 0.1, 1.5, 3.2, 10.0, 1e3, 1e6])
def test_sine_and_versine_are_accurate_to_rounding(reach):
    angles = np.random.default_rng(0).uniform(-reach, reach, 20_000)
    sines, versines = np.zeros_like(angles), np.zeros_like(angles)
    compute(angles, sines, versines)
    exact = angles.astype(np.longdouble)
    assert np.abs(sines - np.sin(exact)).max() < 4e-16
    true = 2.0 * np.sin(exact / 2.0) ** 2
    assert (np.abs(versines - true) <= 6e-16 * true).all()


def test_multiples_of_a_quarter_turn():
    angles = 0.5 * np.pi * np.arange(-8.0, 9.0)
    sines, versines = np.zeros_like(angles), np.zeros_like(angles)
    compute(angles, sines, versines)
    assert sines == pytest.approx(np.tile([0.0, 1.0, 0.0, -1.0], 5)[:17], abs=2e-15)
    assert versines == pytest.approx(np.tile([0.0, 1.0, 2.0, 1.0], 5)[:17], abs=2e-15)

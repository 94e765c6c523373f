"""Tests of the Rayleigh-Ritz oracle against printed frequencies."""

import numpy as np
import pytest

from oracles.ritz import bar_eigenvalues, beam_eigenvalues


@pytest.mark.parametrize(
    ("keywords", "expected"),
    [  # Blevins, Formulas for Natural Frequency and Mode Shape, and closed forms computed elsewhere
        ({}, (3.51601527, 22.03449156, 61.69721441)),
        ({"tip_mass_ratio": 1.0}, (1.55729786, 16.25008516, 50.89584283)),
        ({"hub_inertia_ratio": 0.0}, (15.41820572, 49.96486203, 104.24769646)),
        ({"hub_inertia_ratio": 0.1}, (6.96392355, 22.98023897, 62.02590928)),
        ({"spring": (1e12, None)}, (3.51601527, 22.03449156, 61.69721441)),
        ({"segments": ((0.3, 1.0, 1.0), (0.7, 1.0, 1.0))}, (3.51601527, 22.03449156, 61.69721441)),
    ],
)
def test_beams_have_their_printed_frequencies(keywords, expected):
    assert beam_eigenvalues(3, **keywords) == pytest.approx(expected, rel=5e-9)


def test_a_bar_has_odd_quarters_of_a_wave():
    assert bar_eigenvalues(3) == pytest.approx(np.pi * np.array([0.5, 1.5, 2.5]), rel=1e-9)

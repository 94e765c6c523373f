"""Deviations: of fits to records with noise that is not white, against closed forms and by drawing it often."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.signal import lfilter

import flexman_gym as fm
from flexman_gym.fit.fit import _covariance, _memory
from flexman_gym.fit.problem import Part

from oracles.turned import BENT, CHOICE, STIFFNESS, turned


def coloured(random, size, kept):
    """Noise e_k = kept e_(k-1) + w_k (AR(1)) of deviation 1, (size,); the first 200 of it are left out."""
    white = random.standard_normal(size + 200) * np.sqrt(1.0 - kept**2)
    return lfilter([1.0], [1.0, -kept], white)[200:]


@pytest.mark.parametrize("kept", [0.0, 0.5, 0.9])
def test_the_memory_of_an_autoregression_is_that_of_its_closed_form(kept):
    """The sum over all lags of kept^|lag|: (1 + kept) / (1 - kept)."""
    rows = coloured(np.random.default_rng(0), 200_000, kept)
    assert _memory(rows) == pytest.approx((1.0 + kept) / (1.0 - kept), rel=0.1)
    assert _memory(3.0 * rows + 5.0) == pytest.approx(_memory(rows))


def linear(rows, slopes, record=0):
    """A problem that is linear in its unknowns, at their place of the least residuals."""
    part = Part(record, "linear", rows, np.ones(len(rows)), False)
    return SimpleNamespace(parts=[part], evaluated=lambda x: (rows, slopes), divided=lambda values: [values])


@pytest.mark.parametrize("kept", [0.0, 0.8])
def test_the_mean_of_coloured_noise_is_as_uncertain_as_its_closed_form(kept):
    """The variance s^2 / m (1 + kept) / (1 - kept), whatever the deviation s that the fit assumed."""
    m = 100_000
    rows = 0.3 * coloured(np.random.default_rng(1), m, kept)
    variance = _covariance(linear(rows, np.ones((m, 1))), np.zeros(1))
    assert variance[0, 0] == pytest.approx(0.09 / m * (1.0 + kept) / (1.0 - kept), rel=0.1)


def test_numbers_that_a_fit_uses_up_count():
    """Of m samples of white noise u are lost to u unknowns: the variance has the divisor m - u."""
    m, u, random = 60, 20, np.random.default_rng(2)
    slopes = np.linalg.qr(random.standard_normal((m, u)))[0]
    found = []
    for _ in range(300):
        rows = random.standard_normal(m)
        rows -= slopes @ (slopes.T @ rows)
        found.append(_covariance(linear(rows, slopes), np.zeros(u))[0, 0] / _memory(rows))
    assert np.mean(found) == pytest.approx(1.0, rel=0.05)


def test_given_deviations_are_those_of_frequencies():
    """A part of ringing is not rescaled by what is left of it: one residual tells no noise."""
    variance = _covariance(linear(np.array([3.0, -3.0]), np.array([[2.0], [0.0]]), record=-1), np.zeros(1))
    assert variance[0, 0] == pytest.approx(0.25, rel=1e-6)


def test_deviations_cover_what_fits_of_coloured_records_miss():
    """Of 25 fits the squares of errors in deviations have mean 1; 99.9 % of such means are from 0.3 to 2.1."""
    clean = turned((BENT,), samples=401, gains=(BENT,))
    random, squares = np.random.default_rng(3), []
    for _ in range(25):
        noise = 0.03 * np.std(clean.outputs[BENT]) * coloured(random, 401, 0.9)
        record = replace(clean, outputs={BENT: clean.outputs[BENT] + noise})
        found = fm.fit(fm.catalog.one_joint(), "joint_stiffness", records=[record], starts=0, check=False, **CHOICE)
        gain, deviation = found.gains[BENT]
        miss = (found.values["joint_stiffness"][0] - STIFFNESS) / found.deviations["joint_stiffness"][0]
        squares.append([miss**2, ((gain - 1.0) / deviation) ** 2])
    assert (np.mean(squares, axis=0) > 0.3).all() and (np.mean(squares, axis=0) < 2.1).all(), np.mean(squares, axis=0)

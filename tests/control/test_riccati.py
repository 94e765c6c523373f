"""Riccati: covariances are those of the errors that there are, and the stationary one solves its equation."""

import numpy as np
import pytest
from scipy.linalg import solve_discrete_are
from scipy.stats import chi2

from flexman_gym.control.margins import sampled_loop
from flexman_gym.control.riccati import corrected, predicted, stationary
from flexman_gym.envs.setup import build, setup_of
from flexman_gym.simulation.readings import Readings

RUNS, PERIODS = 3000, 40


def system(seed, size=6, read=2, growth=1.02):
    """A made-up system: transition, noise, matrix, variances; some of its parts grow by themselves."""
    random = np.random.default_rng(seed)
    transition = growth * np.linalg.qr(random.normal(size=(size, size)))[0] @ np.diag(random.uniform(0.6, 1.0, size))
    driven = random.normal(size=(size, 2))
    return transition, driven @ driven.T, random.normal(size=(read, size)), random.uniform(0.1, 2.0, read)


def arm_system(delay=2, part=0.01):
    """A flexible arm about a posture, torques that come late, its encoders and gauges; transition, inputs and so on."""
    setup = setup_of({"name": "FlexPlanar-v0"})
    model = build(setup).model
    loop = sampled_loop(model, [0.4, -0.7], setup.control_period, delay)
    unit = Readings(model).named(np.eye(2 * model.n_dof))
    read = np.hstack([unit["motor_angles"], unit["motor_rates"], unit["root_strains"][:, [0, 1, 3, 4]]]).T
    matrix = np.hstack([read, np.zeros((len(read), len(loop.transition) - read.shape[1]))])
    reaching = sampled_loop(model, [0.4, -0.7], setup.control_period).inputs * part * np.array(setup.torque_limit)
    driven = np.vstack([reaching, np.zeros((len(loop.transition) - len(reaching), 2))])
    return loop, driven, matrix, np.repeat([1e-3, 1e-2, 1e-5], [2, 2, 4])


@pytest.mark.parametrize("seed", range(4))
def test_many_periods_lead_to_it(seed):
    transition, noise, matrix, variances = system(seed)
    result = stationary(transition, noise, matrix, variances)
    covariance = np.eye(6)
    for _ in range(3000):
        covariance = predicted(corrected(covariance, matrix, variances)[1], transition, noise)
    assert np.abs(result - covariance).max() <= 1e-9 * np.abs(covariance).max()
    expected = solve_discrete_are(transition.T, matrix.T, noise, np.diag(variances))
    assert np.abs(result - expected).max() <= 1e-7 * np.abs(expected).max()


def test_systems_side_by_side_are_solved_as_alone():
    first, second = system(1), system(2)
    both = stationary(np.array([first[0], second[0]]), np.array([first[1], second[1]]), *first[2:])
    assert np.array_equal(both[0], stationary(first[0][None], first[1][None], *first[2:])[0])


def test_parts_that_are_forgotten_at_once_do_no_harm():
    """Eigenvalues of zero, as torques on their way have: nothing is divided by them."""
    loop, driven, matrix, deviations = arm_system(3)
    noise, size = driven @ driven.T, len(loop.transition)
    result = stationary(loop.transition, noise, matrix, deviations**2)
    after = predicted(corrected(result, matrix, deviations**2)[1], loop.transition, noise)
    assert np.abs(after - result).max() <= 1e-8 * np.abs(result).max()
    short = size - 6
    alone = stationary(loop.transition[:short, :short], noise[:short, :short], matrix[:, :short], deviations**2)
    assert np.array_equal(result[short:], np.zeros((6, size))) and result[:short, :short] == pytest.approx(alone)


def test_a_scalar_is_the_root_of_its_quadratic_equation():
    """p = a^2 p r / (p + r) + q."""
    a, q, r = 1.3, 0.7, 0.2
    half = 0.5 * (q + a * a * r - r)
    result = stationary(np.array([[a]]), np.array([[q]]), np.array([[1.0]]), np.array([r]))
    assert result[0, 0] == pytest.approx(half + np.sqrt(half**2 + q * r), rel=1e-12)


def test_what_readings_do_not_tell_is_infinite():
    """A second motor that nobody reads wanders off; the first is known."""
    transition = np.kron(np.eye(2), [[1.0, 0.1], [0.0, 1.0]])
    result = stationary(transition, np.eye(4), np.eye(1, 4), np.array([1.0]))
    assert np.isfinite(result[:2, :2]).all() and np.isinf(np.diag(result)[2:]).all()


def test_one_reading_of_one_number_is_the_weighted_mean():
    gain, left = corrected(np.array([[4.0]]), np.array([[1.0]]), np.array([1.0]))
    assert gain[0, 0] == pytest.approx(0.8) and left[0, 0] == pytest.approx(0.8)


def runs(loop, driven, matrix, deviations, steady):
    """Innovations in standard form (RUNS, PERIODS, m), and errors (RUNS, s) at the end with their covariance."""
    random, size = np.random.default_rng(7), len(matrix[0])
    noise, variances = driven @ driven.T, deviations**2
    covariance = stationary(loop.transition, noise, matrix, variances) if steady else np.diag(np.full(size, 1e-4))
    x = random.multivariate_normal(np.zeros(size), covariance, RUNS, method="svd")
    estimate, innovations = np.zeros((RUNS, size)), []
    for period in range(PERIODS):
        error = x @ matrix.T + deviations * random.normal(size=(RUNS, len(matrix))) - estimate @ matrix.T
        spread = np.linalg.cholesky(matrix @ covariance @ matrix.T + np.diag(variances))
        innovations.append(np.linalg.solve(spread, error.T).T)
        gain, covariance = corrected(covariance, matrix, variances)
        estimate = estimate + error @ gain.T
        if period < PERIODS - 1:
            torques = random.normal(size=(RUNS, 2))
            x = x @ loop.transition.T + torques @ loop.inputs.T + random.normal(size=(RUNS, 2)) @ driven.T
            estimate = estimate @ loop.transition.T + torques @ loop.inputs.T
            covariance = predicted(covariance, loop.transition, noise)
    return np.array(innovations).swapaxes(0, 1), x - estimate, covariance


@pytest.mark.parametrize("steady", [False, True])
@pytest.mark.parametrize("delay", [0, 2])
def test_innovations_are_white_and_as_large_as_they_should_be(delay, steady):
    """Sums of their squares are within the 99 % bounds of chi-square; neighbours in time do not know of each other."""
    innovations, _, _ = runs(*arm_system(delay), steady)
    total, count = np.square(innovations).sum(), innovations.size
    assert chi2.ppf(0.005, count) < total < chi2.ppf(0.995, count)
    neighbours = (innovations[:, 1:] * innovations[:, :-1]).sum(axis=(0, 1)) / innovations[:, 1:, 0].size ** 0.5
    assert np.abs(neighbours).max() < 4.0


@pytest.mark.parametrize("steady", [False, True])
def test_the_covariance_is_that_of_the_errors(steady):
    """Of each direction: normalised, all eigenvalues of the sample are within Marchenko and Pastur's bounds of 1."""
    _, errors, covariance = runs(*arm_system(0), steady)
    deviations = np.sqrt(np.diag(covariance))
    moved = deviations > 1e-9 * deviations.max()  # a planar arm does not leave its plane
    values, left = np.linalg.eigh((covariance / np.outer(deviations, deviations).clip(1e-300))[moved][:, moved])
    known = values > 1e-9
    scaled = (errors[:, moved] / deviations[moved]) @ left[:, known] / np.sqrt(values[known])
    sample = np.linalg.eigvalsh(scaled.T @ scaled / RUNS)
    edge = np.sqrt(scaled.shape[1] / RUNS)
    assert (1.0 - 1.15 * edge) ** 2 < sample[0] and sample[-1] < (1.0 + 1.15 * edge) ** 2 and scaled.shape[1] > 8

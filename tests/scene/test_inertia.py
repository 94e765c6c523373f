"""Tests of inertia matrices: which a body can have, and the nearest one."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from flexman_gym.scene.inertia import nearest_inertia, triangle_excess


def second_moments(inertia):
    """Return the second moments of mass (3, 3) of a body about its centre, kg m^2."""
    return np.trace(inertia) / 2.0 * np.eye(3) - inertia


def random_body(rng):
    """Return the inertia (3, 3) of a random cloud of points about its centre."""
    points = rng.normal(size=(5, 3)) * rng.uniform(0.1, 1.0, 3)
    points -= points.mean(axis=0)
    return np.einsum("ij,ij->", points, points) * np.eye(3) - points.T @ points


@pytest.mark.parametrize("seed", range(5))
def test_inertia_of_a_body_is_possible_and_nearest_to_itself(seed):
    inertia = random_body(np.random.default_rng(seed))
    assert triangle_excess(inertia) == 0.0
    np.testing.assert_allclose(nearest_inertia(inertia), inertia, rtol=0, atol=1e-14 * np.abs(inertia).max())


@pytest.mark.parametrize("seed", range(5))
def test_nearest_inertia_is_possible_and_no_body_is_nearer(seed):
    """Distance: Frobenius norm of the second moments. Moved a little towards any body, the nearest one is farther."""
    rng = np.random.default_rng(seed)
    given = rng.normal(size=(3, 3))
    given = given + given.T
    nearest = nearest_inertia(given)
    assert triangle_excess(given) > 0.01 and triangle_excess(nearest) < 1e-14
    np.testing.assert_allclose(nearest_inertia(nearest), nearest, rtol=0, atol=1e-14)
    distance = np.linalg.norm(second_moments(given - nearest))
    for _ in range(50):
        other = nearest + rng.uniform(0.0, 0.3) * (random_body(rng) - nearest)
        assert np.linalg.norm(second_moments(given - other)) >= distance * (1.0 - 1e-12)


def test_nearest_inertia_keeps_the_largest_moment_where_one_second_moment_is_negative():
    turn = Rotation.from_rotvec([0.3, -0.5, 0.2]).as_matrix()
    nearest = nearest_inertia(turn @ np.diag([0.002, 0.0, 0.0]) @ turn.T)
    np.testing.assert_allclose(turn.T @ nearest @ turn, np.diag([0.002, 0.001, 0.001]), rtol=0, atol=1e-17)


def test_triangle_excess_is_relative_and_does_not_depend_on_the_axes():
    turn = Rotation.from_rotvec([0.3, -0.5, 0.2]).as_matrix()
    for moments, excess in (((3.0, 1.0, 1.5), 0.5 / 3.0), ((1.0, 1.0, -0.2), 0.2), ((0.0, 0.0, 0.0), 0.0)):
        assert triangle_excess(7.0 * turn @ np.diag(moments) @ turn.T) == pytest.approx(excess, abs=1e-14)

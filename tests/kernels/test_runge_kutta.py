"""Step size control of adaptive methods: Hairer, Norsett and Wanner, Solving ODEs I, II.4."""

import numpy as np
import pytest

from flexman_gym.kernels import runge_kutta
from flexman_gym.kernels.runge_kutta import MAX_FACTOR, MIN_FACTOR, SAFETY

ORDER, SIZE = 8, 0.1  # s


def next_size(length, error, last=False):
    """Return the step size (s) after a step of a length (s) with a scaled error, in place of one of SIZE."""
    return runge_kutta._next_step_size.py_func(SIZE, length, last, error, ORDER)


def test_a_step_of_the_next_size_has_the_error_of_the_safety_factor():
    """An error that grows with the power `ORDER` of the step becomes SAFETY^ORDER."""
    for error in (1e-3, 0.1, 1.0, 20.0):
        assert error * (next_size(SIZE, error) / SIZE) ** ORDER == pytest.approx(SAFETY**ORDER)


def test_step_sizes_change_by_bounded_factors():
    assert next_size(SIZE, 0.0) == next_size(SIZE, 1e-12) == pytest.approx(MAX_FACTOR * SIZE)
    assert next_size(SIZE, 1e12) == next_size(SIZE, np.inf) == pytest.approx(MIN_FACTOR * SIZE)
    assert next_size(SIZE, np.nan) == pytest.approx(0.1 * SIZE)


@pytest.mark.parametrize("share", [0.01, 0.5, 0.9])
def test_a_step_shortened_to_an_output_neither_lengthens_nor_shortens_the_next(share):
    """Its error is small because it is short. Only an error near its bound, or beyond it, shortens the next step."""
    assert next_size(share * SIZE, 1e-6, last=True) == SIZE
    assert next_size(share * SIZE, 1.0, last=True) == pytest.approx(SAFETY * SIZE)
    assert next_size(share * SIZE, 20.0, last=True) == pytest.approx(share * next_size(SIZE, 20.0))
    assert next_size(SIZE, 1e-6, last=True) == next_size(SIZE, 1e-6) > SIZE, "one that ends there by itself counts"

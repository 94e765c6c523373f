"""Arithmetic of numbers with tangents against their partial derivatives, and equal values."""

import math

import numba
import numpy as np
import pytest

import flexman_gym as fm
from flexman_gym.kernels.arguments import TangentTables, address_tables, aligned_zeros, tangent_constants, work_of
from flexman_gym.kernels.compile import FLAGS
from flexman_gym.kernels.lanes import (
    add_products,
    chain,
    fma,
    is_below,
    is_zero,
    number_of,
    select_below,
)
from flexman_gym.kernels.layout import make_work
from flexman_gym.kernels.linalg import sine_versine

A, B, C = 1.7, -0.6, 2.3
MODEL = fm.build_model(fm.catalog.one_joint(), elements=2)
FUNCTIONS = {  # name -> value, and partial derivatives with respect to a, b and c
    "a + b": (A + B, (1.0, 1.0, 0.0)),
    "a - b": (A - B, (1.0, -1.0, 0.0)),
    "a b": (A * B, (B, A, 0.0)),
    "2 a": (2.0 * A, (2.0, 0.0, 0.0)),
    "a / b": (A / B, (1.0 / B, -A / B**2, 0.0)),
    "a / 3": (A / 3.0, (1.0 / 3.0, 0.0, 0.0)),
    "3 / b": (3.0 / B, (0.0, -3.0 / B**2, 0.0)),
    "-b": (-B, (0.0, -1.0, 0.0)),
    "fma(a, b, c)": (math.fsum([A * B, C]), (B, A, 1.0)),
    "fma(2, b, c)": (2.0 * B + C, (0.0, 2.0, 1.0)),
    "fma(a, 2, 1)": (2.0 * A + 1.0, (2.0, 0.0, 0.0)),
    "add_products(c, a, b)": (math.fsum([A * B, C]), (B, A, 1.0)),
    "sqrt(a)": (math.sqrt(A), (0.5 / math.sqrt(A), 0.0, 0.0)),
    "sin(c)": (math.sin(C), (0.0, 0.0, math.cos(C))),
    "cos(c)": (math.cos(C), (0.0, 0.0, -math.sin(C))),
    "tanh(b)": (math.tanh(B), (0.0, 1.0 - math.tanh(B) ** 2, 0.0)),
    "sine of 20 a": (math.sin(20.0 * A), (20.0 * math.cos(20.0 * A), 0.0, 0.0)),
    "versine of 20 a": (1.0 - math.cos(20.0 * A), (20.0 * math.sin(20.0 * A), 0.0, 0.0)),
    "a b if b < 0 else c": (A * B, (B, A, 0.0)),
    "a b if a < 0 else c": (C, (0.0, 0.0, 1.0)),
    "number of a": (A, (0.0, 0.0, 0.0)),
    "a number with a slope": (C, (0.0, 3.0, 0.0)),
}


@numba.njit(**FLAGS)
def compute(tables):
    """Set work.new_state to the functions of the first three entries of work.row; return tests of b and b - b."""
    work = work_of(tables, 0)
    a, b, c, out = work.row[0], work.row[1], work.row[2], work.new_state
    out[0], out[1], out[2], out[3] = a + b, a - b, a * b, 2.0 * a
    out[4], out[5], out[6], out[7] = a / b, a / 3.0, 3.0 / b, -b
    out[8], out[9], out[10], out[11] = fma(a, b, c), fma(2.0, b, c), fma(a, 2.0, 1.0), add_products(c, a, b)
    out[12], out[13], out[14], out[15] = math.sqrt(a), math.sin(c), math.cos(c), math.tanh(b)
    out[16], out[17] = sine_versine(20.0 * a)
    out[18], out[19] = select_below(b, 0.0, a * b, c), select_below(a, 0.0, a * b, c)
    out[20], out[21] = number_of(a), chain(2.3, 3.0, b)
    moving = b - number_of(b)  # zero with tangents
    return is_below(b, 0.0), is_zero(moving), is_zero(moving - moving)


@pytest.fixture(scope="module")
def computed():
    """Return the tests, and the numbers (k, 8) of the functions with tangents of the parameters."""
    constants, work = tangent_constants(MODEL.constants), make_work(MODEL.constants, aligned_zeros)
    tangents = np.random.default_rng(0).normal(size=(3, 7))
    work.row[:3, 0], work.row[:3, 1:] = (A, B, C), tangents
    tests = compute(address_tables(TangentTables, constants, work))
    return tests, work.new_state[: len(FUNCTIONS)].copy(), tangents


@pytest.mark.slow
@pytest.mark.parametrize("row, name", list(enumerate(FUNCTIONS)))
def test_tangents_follow_the_partial_derivatives(computed, row, name):
    _, found, tangents = computed
    value, partials = FUNCTIONS[name]
    assert found[row, 0] == pytest.approx(value, rel=1e-15)
    np.testing.assert_allclose(found[row, 1:], np.array(partials) @ tangents, rtol=1e-13, atol=1e-14)


def test_comparisons_test_the_number_and_zero_tests_the_tangents_too(computed):
    (below, moving_is_zero, zero_is_zero), _, _ = computed
    assert below and not moving_is_zero and zero_is_zero

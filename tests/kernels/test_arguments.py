"""Fields of a struct argument can be read and written like arrays."""

import numba
import numpy as np
import pytest

import flexman_gym as fm
from flexman_gym.kernels.layout import Work, make_work


@numba.njit(_nrt=False)
def _access(work, i, j):
    """Access a field in all ways used by kernels: indices from variables, constants, slices and rows."""
    work.tip_shape[i, j] = 2.0 * work.row[j] + work.tip_shape[0, j]
    part = work.row[i : i + 3]
    part[1] = work.tip_shape[i][j]
    work.factor[5] = part[1] + len(part)


def _work() -> Work:
    work = make_work(fm.build_model(fm.catalog.paper_rrr(), elements=1).constants)
    for values in work:
        values[...] = np.random.default_rng(values.size).normal(size=values.shape)
    return work


@pytest.mark.slow
def test_a_compiled_access_equals_that_of_the_arrays():
    compiled, plain = _work(), _work()
    _access(compiled, 2, 4)
    _access.py_func(plain, 2, 4)
    for name, ours, expected in zip(Work._fields, compiled, plain, strict=True):
        np.testing.assert_array_equal(ours, expected, err_msg=name)

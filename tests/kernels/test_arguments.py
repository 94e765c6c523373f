"""Fields: they are read and written as arrays are."""

import numba
import numpy as np

import flexman_gym as fm
from flexman_gym.kernels.layout import Work, make_work


@numba.njit(_nrt=False)
def _move_up(work, i, j):
    """Every way in which kernels use a field, with indices known at run time, written out, and of parts of it."""
    work.tip_shape[i, j] = 2.0 * work.row[j] + work.tip_shape[0, j]
    part = work.row[i : i + 3]
    part[1] = work.tip_shape[i][j]
    work.factor[5] = part[1] + len(part)


def _work() -> Work:
    work = make_work(fm.build_model(fm.catalog.paper_rrr(), elements=1).constants)
    for values in work:
        values[...] = np.random.default_rng(values.size).normal(size=values.shape)
    return work


def test_a_field_is_read_and_written_where_an_array_would_be():
    compiled, plain = _work(), _work()
    _move_up(compiled, 2, 4)
    _move_up.py_func(plain, 2, 4)
    for name, ours, expected in zip(Work._fields, compiled, plain, strict=True):
        np.testing.assert_array_equal(ours, expected, err_msg=name)

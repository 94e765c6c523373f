"""Equality: the same keys, types, shapes and bits of what environments return."""

import numpy as np


def same(found, expected, name=""):
    """Asserts the same keys, types, shapes and bits."""
    assert type(found) is type(expected), name
    if isinstance(found, dict):
        assert found.keys() == expected.keys(), name
        for key in found:
            same(found[key], expected[key], f"{name} {key}")
        return
    assert found.dtype == expected.dtype and found.shape == expected.shape, name
    if found.dtype == object:
        for one, other in zip(found, expected, strict=True):
            assert type(one) is type(other) and np.array_equal(one, other), name
    else:
        assert np.array_equal(found, expected), name

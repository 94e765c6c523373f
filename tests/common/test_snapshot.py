"""Snapshot: the state of an object is restored; the attribute of version 0.2 that lists it is read with a warning."""

import numpy as np
import pytest

from flexman_gym.common.snapshot import get_state, set_state


class Counter:
    """Object with a number, an array and a random generator as its state."""

    state_fields = ("count", "values", "random")

    def __init__(self):
        self.count, self.values, self.random = 0, np.zeros(3), np.random.default_rng(1)


class FormerCounter(Counter):
    """The same, written for version 0.2."""

    kept = ("count",)


def test_a_restored_object_continues_as_before_and_keeps_its_arrays():
    counter = Counter()
    state = get_state(counter)
    array, expected = counter.values, counter.random.normal()
    counter.count, counter.values[1] = 5, 2.0
    assert set_state("counter", counter, state) is counter
    assert counter.count == 0 and counter.values is array and not array.any()
    assert counter.random.normal() == expected


def test_the_state_of_a_class_of_version_0_2_is_read_with_a_warning():
    with pytest.warns(DeprecationWarning, match=r"^FormerCounter\.kept is state_fields now$"):
        assert get_state(FormerCounter()) == {"count": 0}

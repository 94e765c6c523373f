"""Tests of snapshots: the state of an object is restored, and one with other fields is refused."""

import numpy as np

from flexman_gym.common.snapshot import get_state, set_state


class Counter:
    """Object with a number, an array and a random generator as its state."""

    state_fields = ("count", "values", "random")

    def __init__(self):
        self.count, self.values, self.random = 0, np.zeros(3), np.random.default_rng(1)


def test_a_restored_object_continues_as_before_and_keeps_its_arrays():
    counter = Counter()
    state = get_state(counter)
    array, expected = counter.values, counter.random.normal()
    counter.count, counter.values[1] = 5, 2.0
    assert set_state("counter", counter, state) is counter
    assert counter.count == 0 and counter.values is array and not array.any()
    assert counter.random.normal() == expected

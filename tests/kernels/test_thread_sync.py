"""Signals: one thread sees what another one tells, and waits no longer than it should."""

import threading

import numpy as np

from flexman_gym.kernels.thread_sync import spin_wait


def test_who_watches_tells_his_own_number_and_sees_the_other():
    numbers = np.array([3, 8])
    assert spin_wait(numbers, 0, 5, 8, 1) and numbers.tolist() == [5, 8]
    assert spin_wait(numbers, 1, 9, 5, 1) and numbers.tolist() == [5, 9]
    assert not spin_wait(numbers, 0, 6, 8, 1000) and numbers.tolist() == [6, 9]


def test_two_threads_keep_step():
    """One tells a number and waits for the same of the other, which tells it when it has seen it."""
    numbers, looks, seen = np.zeros(2, dtype=np.int64), 10**10, []

    def follow():
        seen.extend(n for n in range(1, 11) if spin_wait(numbers, 1, n - 1, n, looks))
        spin_wait(numbers, 1, 10, 10, 1)

    thread = threading.Thread(target=follow, daemon=True)
    thread.start()
    assert all(spin_wait(numbers, 0, n, n, looks) for n in range(1, 11))
    thread.join(20.0)
    assert seen == list(range(1, 11))

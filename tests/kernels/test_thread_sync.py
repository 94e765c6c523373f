"""Synchronisation of two threads: the other flag is read, and the wait is limited."""

import threading

import numpy as np

from flexman_gym.kernels.thread_sync import spin_wait


def test_a_thread_sets_its_flag_and_reads_the_other():
    flags = np.array([3, 8])
    assert spin_wait(flags, 0, 5, 8, 1) and flags.tolist() == [5, 8]
    assert spin_wait(flags, 1, 9, 5, 1) and flags.tolist() == [5, 9]
    assert not spin_wait(flags, 0, 6, 8, 1000) and flags.tolist() == [6, 9]


def test_two_threads_alternate():
    """One thread sets a number and waits until the other sets the same number, having read it."""
    flags, polls, seen = np.zeros(2, dtype=np.int64), 10**10, []

    def follow():
        seen.extend(n for n in range(1, 11) if spin_wait(flags, 1, n - 1, n, polls))
        spin_wait(flags, 1, 10, 10, 1)

    thread = threading.Thread(target=follow, daemon=True)
    thread.start()
    assert all(spin_wait(flags, 0, n, n, polls) for n in range(1, 11))
    thread.join(20.0)
    assert seen == list(range(1, 11))

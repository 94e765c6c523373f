"""Helper: a thread does what it is given, says what went wrong, and ends with its owner."""

import gc
import threading
import time

import pytest

from flexman_gym.simulation.helper import Helper


def test_tasks_are_done_in_another_thread_one_after_the_other():
    helper, result = Helper(), []
    for number in range(100):
        helper.begin(lambda number=number: result.append((number, threading.get_ident())))
        helper.finish()
        assert result[-1][0] == number
    assert {thread for _, thread in result} != {threading.get_ident()}
    assert len({thread for _, thread in result}) == 1


def test_what_a_task_raises_is_raised_and_the_next_task_is_done():
    helper, result = Helper(), []
    helper.begin(lambda: 1 / 0)
    with pytest.raises(ZeroDivisionError):
        helper.finish()
    helper.begin(lambda: result.append(1))
    helper.finish()
    assert result == [1]


def test_a_task_that_nobody_waited_for_is_done_before_the_next():
    helper, result = Helper(), []
    helper.begin(lambda: (time.sleep(0.05), result.append(1)))
    helper.begin(lambda: result.append(2))
    helper.finish()
    assert result == [1, 2]


def test_the_thread_ends_with_its_owner():
    before = set(threading.enumerate())
    helper = Helper()
    (thread,) = set(threading.enumerate()) - before
    del helper
    gc.collect()
    thread.join(10.0)
    assert not thread.is_alive()

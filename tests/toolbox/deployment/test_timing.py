"""Tests of the transport of readings: age, period, clock and losses, by receipts at the deadlines."""

import numpy as np
import pytest

from flexman_gym.toolbox.deployment.machine.machine import Receipt
from flexman_gym.toolbox.deployment.machine.packets import COPIES
from flexman_gym.toolbox.deployment.machine.timing import TimingTest

PERIOD, SILENCE = 0.02, 5


def noticed(receipts, periods=60):
    """Return the number of the deadline and the text of the first fault; `receipts(k)` is None without new readings."""
    test, newest = TimingTest(PERIOD, SILENCE), Receipt(0, 0.0, 0.0, 0, 0)
    test.begin(newest)
    for k in range(1, periods):
        fresh = receipts(k)
        newest = fresh or newest
        if text := test.check(newest, fresh is not None, PERIOD * (k + 0.1)):
            return k, text
    return None


def regular(k, stamp=None, sampled=None, arrived=None):
    time = PERIOD * k
    return Receipt(k, time if stamp is None else stamp, time if sampled is None else sampled, 0, arrived or COPIES * k)


def test_regular_readings_are_no_fault():
    assert noticed(regular) is None


@pytest.mark.parametrize("lost", [{9}, {9, 10}, {9, 10, 11}, {9, 11, 13, 15}])
def test_readings_that_are_missing_for_less_than_the_silence_are_no_fault(lost):
    def receipts(k):
        return None if k in lost else regular(k, arrived=COPIES * (k - sum(each < k for each in lost)))

    assert noticed(receipts) is None


def test_a_machine_that_was_held_up_for_three_periods_and_catches_up_is_no_fault():
    assert noticed(lambda k: None if k in (9, 10, 11) else regular(k)) is None


def late_readings(late):
    """Return receipts of readings that are late by a number of periods, from the tenth on."""

    def receipts(k):
        newest, before = (int(np.floor(each + 0.1 - late)) if each >= 10 else each for each in (k, k - 1))
        return regular(newest) if newest >= max(10, before + 1) or k < 10 else None

    return receipts


@pytest.mark.parametrize("late", [1.3, 2.1, 2.5, 2.9])
def test_late_readings_are_noticed_with_their_age(late):
    k, text = noticed(late_readings(late))
    age = np.ceil(late - 0.1) + 0.1
    assert k <= 10 + 4 and text.startswith(f"readings are {1e3 * PERIOD * age:.3g} ms old")


@pytest.mark.parametrize("late", [0.5, 1.0])
def test_readings_that_are_less_than_two_periods_old_at_the_deadline_are_no_fault(late):
    assert noticed(late_readings(late)) is None


@pytest.mark.parametrize(("step", "most"), [(0.5, 3), (2.0, 2), (3.0, 2)])
def test_another_period_of_the_time_stamps_is_noticed(step, most):
    k, text = noticed(lambda k: regular(k) if k < 10 else regular(k, stamp=PERIOD * (9 + step * (k - 9))))
    assert k <= 9 + most and text == f"the machine stamps a sample every {1e3 * step * PERIOD:.3g} ms, not 20 ms"


@pytest.mark.parametrize("jump", [-3.0, 3.0, 50.0])
def test_a_jump_of_the_clock_is_noticed(jump):
    k, text = noticed(lambda k: regular(k) if k < 10 else regular(k, stamp=PERIOD * (k + jump)))
    assert k == 11 and text.startswith(f"the clock of the machine is wrong by {1e3 * jump * PERIOD:.3g} ms")


def test_lost_copies_are_noticed_although_each_reading_arrives():
    k, text = noticed(lambda k: regular(k, arrived=COPIES * min(k, 10) + max(k - 10, 0)))
    assert k == 15 and text == "10 of 15 packets are lost"
    assert noticed(lambda k: regular(k, arrived=2 * k)) is None


def test_a_machine_without_receipts_is_tested_by_the_number_of_its_readings():
    def first(fresh):
        test = TimingTest(PERIOD, SILENCE)
        return next((k for k in range(1, 60) if test.check(None, fresh(k), PERIOD * k)), None)

    assert first(lambda k: k % 5 == 0) == 5
    assert first(lambda k: k % 3 == 0) is None


def test_an_honest_start_is_allowed_and_readings_from_the_future_are_not():
    test = TimingTest(PERIOD, SILENCE)
    assert test.start([]) == ""
    assert test.start([(regular(k), PERIOD * (k + 0.1)) for k in range(1, 9)]) == ""
    ahead = [(regular(k, sampled=PERIOD * (k + 5)), PERIOD * k) for k in range(1, 9)]
    assert test.start(ahead).startswith("readings that are -100 ms old")
    assert "do not echo" in test.start([(regular(k, sampled=-float("inf")), PERIOD * k) for k in range(1, 9)])

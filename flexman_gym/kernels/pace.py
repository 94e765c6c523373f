"""Pace: how long the next step is, by a clock with fixed steps or by the error of the last one."""

import math

from flexman_gym.kernels.compile import inner
from flexman_gym.kernels.layout import LARGEST_STATE

SAFETY, SMALLEST_FACTOR, LARGEST_FACTOR = 0.9, 0.2, 10.0  # step size control, Hairer, Norsett and Wanner I, II.4
LEAST_PACE = 1e-14  # of the interval


@inner
def first_pace(work, clock):
    """The step to begin with (s): the one at which the last run ended, or that of the clock."""
    if clock.rtol > 0.0 and work.pace[0] > 0.0:
        return work.pace[0]
    return clock.step


@inner
def resume(work):
    """Whether a run goes on after a pause, the steps of its interval that were taken, and the seconds."""
    paused, n, done = work.progress[0], work.progress[1], work.progress[2]
    work.progress[:] = 0.0
    return paused > 0.0, int(n), done


@inner
def pause(work, n, done, pace):
    """Keeps where a run is, with the step (s) that comes next."""
    work.progress[0], work.progress[1], work.progress[2], work.pace[0] = 1.0, n, done, pace


@inner
def step_time(clock, r, n):
    """Start (s) of step n of interval r of a call."""
    return clock.time + (clock.first + r * clock.substeps + n) * clock.step


@inner
def next_step(clock, r, n, done, pace):
    """Start and length of step n of interval r, of which `done` has passed, and whether it is the last one."""
    if clock.rtol == 0.0:
        return step_time(clock, r, n), clock.step, n + 1 == clock.substeps
    interval = clock.step * clock.substeps
    last = done + 1.0001 * pace >= interval
    return clock.time + (clock.first // clock.substeps + r) * interval + done, (interval - done if last else pace), last


@inner
def next_pace(pace, h, last, error, order):
    """The step after one of length h with this error; one that was cut short to end an interval says little."""
    if not error <= 1.0:
        return h * (max(SMALLEST_FACTOR, SAFETY * error ** (-1.0 / order)) if error > 1.0 else 0.1)
    factor = LARGEST_FACTOR if error == 0.0 else SAFETY * error ** (-1.0 / order)
    factor = min(LARGEST_FACTOR, max(SMALLEST_FACTOR, factor))
    if not last:
        return h * factor
    return max(pace, h) * min(factor, 1.0) if h < pace else h * factor


@inner
def error_norm(work, count, clock, state):
    """Scaled error of a step by 1 or 2 estimates, two of them combined as in DOP853 (Hairer et al. I, II.10)."""
    size = len(state) - 2
    first = second = 0.0
    for k in range(size):
        scale = clock.atol + clock.rtol * max(abs(state[k]), abs(work.trial[k]))
        first += (work.estimate[0, k] / scale) ** 2
        if count > 1:
            second += (work.estimate[1, k] / scale) ** 2
    if count == 1:
        return math.sqrt(first / size)
    if first == 0.0 and second == 0.0:
        return 0.0
    return first / math.sqrt((first + 0.01 * second) * size)


@inner
def out_of_bounds(state):
    """Whether a state is not finite or beyond LARGEST_STATE; the ledger is not looked at."""
    for j in range(len(state) - 2):
        if not abs(state[j]) <= LARGEST_STATE:
            return True
    return False

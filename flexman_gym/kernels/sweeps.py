"""Sweeps: methods that iterate a fixed number of times in every step, the midpoint rule and Gauss's of two stages.

Runs are as in `explicit`.
"""

from flexman_gym.kernels.compile import inner, kernel
from flexman_gym.kernels.gauss import gauss_step
from flexman_gym.kernels.layout import DIVERGED, OK, PAUSED
from flexman_gym.kernels.linalg import copy
from flexman_gym.kernels.midpoint import midpoint_step
from flexman_gym.kernels.outputs import observe
from flexman_gym.kernels.pace import out_of_bounds, pause, resume, step_time


@kernel
def run_sweeps(constants, work, sweeps, table, clock, state, rows, outputs):
    """Fixed steps, each of a number of sweeps; `sweeps` as in `swept_step`."""
    d, evaluations = len(state) // 2 - 1, 0
    _, n, done = resume(work)
    for r in range(len(rows)):
        while n < clock.substeps:
            if evaluations >= clock.most:
                pause(work, n, done, 0.0)
                return PAUSED, r, evaluations
            evaluations += swept_step(constants, work, sweeps, table, (step_time(clock, r, n), clock.step), state)
            if out_of_bounds(work.trial):
                return DIVERGED, r, evaluations
            copy(work.trial, state)
            n += 1
        n = 0
        copy(state, rows[r])
        observe(constants, work, state[:d], state[d : 2 * d], outputs[r])
    return OK, len(rows), evaluations


@inner
def swept_step(constants, work, sweeps, table, moment, state):
    """work.trial = what follows the state and its ledger; moment = (time, step). Returns the evaluations.

    `sweeps` is their number and None for the midpoint rule, or a number for a pair of stages.
    """
    count, pair = sweeps
    return step_of_either(constants, work, count, pair, table, moment, state)


@inner
def step_of_either(constants, work, sweeps, pair, table, moment, state):
    """The same; Numba compiles one branch, as it looks for None among arguments only."""
    if pair is None:
        midpoint_step(constants, work, sweeps, table, moment, state)
        evaluations = sweeps
    else:
        gauss_step(constants, work, sweeps, table, moment, state)
        evaluations = 2 * sweeps + 1
    return evaluations

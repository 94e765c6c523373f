"""Gauss's method with two stages, of order 4, in sweeps: a fixed number of iterations without a test of convergence.

With the matrix A of the method, stages x = x0 + h A v, v = v0 + h A w have accelerations w that solve M w = F(x, v).
That is one linear system of twice the size. A differs from the lower triangular matrix T below by the same number in
all entries; with T in place of A the stages are solved one after the other, each at the cost of a linearly implicit
stage, and what T lacks is taken from the iteration before. A free vibration then loses at least 87 % of its error in an
iteration, whatever its frequency, and a stiff one all of it (van der Houwen and Swart, Triangularly implicit iteration
methods for ODE-IVP solvers, SIAM J. Sci. Comput. 18, 41, 1997).
"""

from flexman_gym.kernels.compile import inner
from flexman_gym.kernels.dynamics import factorise
from flexman_gym.kernels.forces import applied_forces, drive_at, friction_slopes
from flexman_gym.kernels.joints import prescribed_power
from flexman_gym.kernels.kinematics import positions, velocities
from flexman_gym.kernels.lanes import fused
from flexman_gym.kernels.midpoint import advance_midpoint, solve_stage, sweep

ROOT = 12.0**-0.5  # from the middle of a step to its stages, in steps
DIAGONAL, LOWER, REST = ROOT, 2.0 * ROOT, 0.25 - ROOT  # T = (DIAGONAL, 0; LOWER, DIAGONAL), and all entries of A - T
FROZEN = 2  # iterations with the mass matrix of the first guess
RELAXED = 1.03  # their changes are taken so many times, with which an undamped vibration grows least; see the tests


@inner
def gauss_step(constants, work, sweeps, table, moment, state):
    """work.trial = what follows the state and its ledger; moment = (time, step).

    The first guess takes mass matrix and forces at positions half a step ahead, and solves the stages with these. A
    sweep takes them at each stage anew. Rows of work.stages: the rates of x and v in the stages, then sums of both.
    """
    d, (time, step) = len(state) // 2 - 1, moment
    x, v, first, second = work.trial[:d], work.trial[d : 2 * d], work.stages[0], work.stages[1]
    drive_at(table, time + 0.5 * step, work.drive)
    first_stages(constants, work, step, state)
    g = DIAGONAL * step
    for n in range(sweeps):
        add_stages_up(work, d)
        for i in range(2):
            drive_at(table, time + (0.5 + (2 * i - 1) * ROOT) * step, work.drive)
            stage_without_own(work, i, step, state)
            advance_midpoint(work, g, x, v)
            sweep(constants, work, g, x, v)
            keep_stage(work, i, g, 1.0)
            if n == sweeps - 1:
                power = prescribed_power(constants, work, work.stages[i][:d])
                supplied, lost = applied_forces(constants, work, x, work.stages[i][:d])
                work.stages[i][2 * d], work.stages[i][2 * d + 1] = supplied + power, lost
    for k in range(len(state)):
        work.trial[k] = state[k] + 0.5 * step * (first[k] + second[k])


@inner
def first_stages(constants, work, step, state):
    """work.stages[:2] = the stages with the mass matrix and forces half a step ahead along the speeds."""
    d, g = len(state) // 2 - 1, 0.5 * step
    x, v, w = work.trial[:d], work.trial[d : 2 * d], work.rates
    for k in range(d):
        x[k], v[k] = state[k] + g * state[d + k], state[d + k]
        work.stage_state[k], work.stage_state[d + k] = x[k], v[k]
    positions(constants, work, x)
    velocities(constants, work, v)
    friction_slopes(constants, work, v)
    factorise(constants, work, (g, g * g))
    frozen_solution(constants, work, v)
    for i in range(2):
        for k in range(d):
            work.stages[i][k] = v[k] + (0.5 + (2 * i - 1) * ROOT) * step * w[k]
            work.stages[i][d + k] = w[k]
    g = DIAGONAL * step
    factorise(constants, work, (g, g * g))
    for _ in range(FROZEN):
        add_stages_up(work, d)
        for i in range(2):
            stage_without_own(work, i, step, state)
            frozen_solution(constants, work, v)
            keep_stage(work, i, g, RELAXED)


@inner
def frozen_solution(constants, work, v):
    """work.rates = accelerations at the positions and speeds v (d,) in work space, but springs at work.stage_state."""
    d = len(v)
    for k in range(d):
        work.shift[k] = work.stage_state[d + k] - v[k]
    solve_stage(constants, work, v)


@inner
def add_stages_up(work, d):
    """work.stages[2] = the sums of the rates in both stages, d of x and d of v."""
    for k in range(2 * d):
        work.stages[2][k] = work.stages[0][k] + work.stages[1][k]


@inner
def stage_without_own(work, i, step, state):
    """work.stage_state = stage i for no accelerations of its own; work.rates = its latest accelerations."""
    d, rest, lower = len(state) // 2 - 1, REST * step, LOWER * step * i
    for k in range(d):
        before = fused(rest, work.stages[2][d + k], state[d + k])
        before = fused(lower, work.stages[0][d + k], before)
        work.stage_state[d + k] = before
        place = fused(rest, work.stages[2][k], state[k])
        place = fused(lower, work.stages[0][k], place)
        work.stage_state[k] = fused(DIAGONAL * step, before, place)
        work.rates[k] = work.stages[i][d + k]


@inner
def keep_stage(work, i, g, relaxed):
    """Moves the rates of stage i by so many times the change to those of work.rates."""
    stage, d = work.stages[i], len(work.rates)
    for k in range(d):
        stage[k] = fused(relaxed, fused(g, work.rates[k], work.stage_state[d + k]) - stage[k], stage[k])
        stage[d + k] = fused(relaxed, work.rates[k] - stage[d + k], stage[d + k])

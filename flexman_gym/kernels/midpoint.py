"""The implicit midpoint rule in sweeps: a fixed number of Newton's iterations a step, without a test of convergence."""

from flexman_gym.kernels.compile import inner
from flexman_gym.kernels.dynamics import factorise, solve
from flexman_gym.kernels.forces import (
    applied_forces,
    disturb,
    drive_at,
    friction_shift,
    friction_slopes,
    motor_forces,
    structural_forces,
)
from flexman_gym.kernels.joints import prescribed_power
from flexman_gym.kernels.kinematics import positions, velocities


@inner
def midpoint_step(constants, work, sweeps, table, moment, state):
    """work.trial = what follows the state and its ledger; moment = (time, step).

    With g = step / 2 the accelerations w in the middle solve M w = F(x, v) at v = v0 + g w and x = x0 + g v. A sweep
    takes M and F at the latest x and v, but springs and dampers at the w that it solves for, as a linearly implicit
    step does. The first one starts from w = 0: a step keeps nothing of those before it, so that a jump of the drive or
    a new start needs no care. Accelerations of the step before bring the tip at most a third nearer after a release:
    they are a good guess in slow modes, but none in those that turn by more than a radian in a step.
    """
    d, (time, step) = len(state) // 2 - 1, moment
    g, w, x, v = 0.5 * step, work.rates, work.trial[:d], work.trial[d : 2 * d]
    drive_at(table, time + g, work.drive)
    for k in range(d):
        work.stage_state[k], work.stage_state[d + k] = state[k] + g * state[d + k], state[d + k]
        w[k] = 0.0
    advance_midpoint(work, g, x, v)
    for _ in range(sweeps):
        sweep(constants, work, g, x, v)
        advance_midpoint(work, g, x, v)
    # the ledger counts the power at the x and v that the step really takes, not at those of the last sweep
    power = prescribed_power(constants, work, v)
    supplied, lost = applied_forces(constants, work, x, v)
    work.trial[2 * d] = state[2 * d] + step * (supplied + power)
    work.trial[2 * d + 1] = state[2 * d + 1] + step * lost
    for k in range(d):
        x[k], v[k] = state[k] + step * v[k], state[d + k] + step * w[k]


@inner
def advance_midpoint(work, g, x, v):
    """x and v (d,) = the middle of the step for the accelerations work.rates; work.shift[:d] = what v lacks without."""
    d = len(x)
    for k in range(d):
        gained = g * work.rates[k]
        x[k], v[k] = work.stage_state[k] + g * gained, work.stage_state[d + k] + gained
        work.shift[k] = -gained


@inner
def sweep(constants, work, g, x, v):
    """work.rates = the accelerations in the middle of the step, from its latest x and v (d,)."""
    positions(constants, work, x)
    velocities(constants, work, v)
    friction_slopes(constants, work, v)
    factorise(constants, work, (g, g * g))
    solve_stage(constants, work, v)


@inner
def solve_stage(constants, work, v):
    """work.rates = accelerations at the speeds v (d,) in work space, with springs and dampers at work.stage_state.

    Friction is that of the speeds v + work.shift[:d], to first order.
    """
    d = len(v)
    motor_forces(constants, work, v)
    friction_shift(constants, work, work.shift[:d])
    structural_forces(constants, work, work.stage_state[:d], work.stage_state[d : 2 * d])
    disturb(constants, work, v)
    solve(constants, work, work.rates)

"""Explicit methods: Runge-Kutta steps by their coefficients (`layout.Tableau`), and the semi-implicit Euler method.

A run fills rows (r, 2 d + 2) with the state and the ledger after every interval of the clock, and outputs (r, OUTPUTS)
with what `observe` reads there. It returns a status, the rows that are valid and the number of evaluations. The state
that is passed in is advanced in place. `table` is that of the drive, see `layout`. A run that pauses (`Clock.most`)
leaves in `work` what it needs to go on: the next call takes its state and the rows that are left, with `Clock.first`,
and the bits are those of one call. Each family has its own loop, with one call of the dynamics in it: compilers copy
that call wherever it stands.
"""

from flexman_gym.kernels.compile import kernel
from flexman_gym.kernels.layout import DIVERGED, NOT_CONVERGED, OK, PAUSED
from flexman_gym.kernels.linalg import copy
from flexman_gym.kernels.outputs import observe
from flexman_gym.kernels.pace import (
    LEAST_PACE,
    error_norm,
    first_pace,
    next_pace,
    next_step,
    out_of_bounds,
    pause,
    resume,
)
from flexman_gym.kernels.stages import add_stages, slope


@kernel
def run_explicit(constants, work, tableau, table, clock, state, rows, outputs):
    """Steps of an explicit Runge-Kutta method, or of the semi-implicit Euler method."""
    d, s, evaluations = len(state) // 2 - 1, len(tableau.b), 0
    adaptive = clock.rtol > 0.0
    pace = first_pace(work, clock)
    paused, n, done = resume(work)
    known = 1 if paused and adaptive else 0
    for r in range(len(rows)):
        last = clock.substeps == 0
        while not last:
            if evaluations >= clock.most:
                pause(work, n, done, pace)
                return PAUSED, r, evaluations
            time, h, last = next_step(clock, r, n, done, pace)
            for i in range(known, s + adaptive):  # the slope after the step, if wanted, is stage s
                weights = tableau.a[i] if i < s else tableau.b
                add_stages(state, h, weights, work.stages, min(i, s), work.stage_state)
                slope(constants, work, table, time + tableau.abscissae[i] * h, work.stage_state, work.stages[i])
                evaluations += 1
            add_stages(state, h, tableau.b, work.stages, s, work.trial)
            if tableau.semi_implicit:
                for k in range(d):
                    work.trial[k] = state[k] + h * work.trial[d + k]
            if adaptive:
                for e in range(len(tableau.error)):
                    for k in range(len(state)):
                        work.estimate[e, k] = 0.0
                    add_stages(work.estimate[e], h, tableau.error[e], work.stages, s + 1, work.estimate[e])
                error = error_norm(work, len(tableau.error), clock, state)
                pace, known = next_pace(pace, h, last, error, tableau.order), 1
                if not error <= 1.0:
                    last = False
                    if pace < LEAST_PACE * clock.step * clock.substeps:
                        return (DIVERGED if out_of_bounds(work.trial) else NOT_CONVERGED), r, evaluations
                    continue
                copy(work.stages[s], work.stages[0])
            if out_of_bounds(work.trial):
                return DIVERGED, r, evaluations
            copy(work.trial, state)
            n, done = n + 1, done + h
        n, done = 0, 0.0
        work.pace[0] = pace
        copy(state, rows[r])
        observe(constants, work, state[:d], state[d : 2 * d], outputs[r])
    return OK, len(rows), evaluations

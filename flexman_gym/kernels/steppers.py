"""Steppers: three families of one-step methods, each driven by coefficients (`layout.Tableau`).

A run fills rows (r, 2 d + 2) with the state and the ledger after every interval of the clock, and outputs (r, OUTPUTS)
with what `observe` reads there. It returns a status, the rows that are valid and the number of evaluations. The state
that is passed in is advanced in place. `table` is that of the drive, see `layout`.
"""

import math

from flexman_gym.kernels.dynamics import accelerate, factorise, solve
from flexman_gym.kernels.forces import applied_forces, drive_at, friction_shift, friction_slopes, structural_forces
from flexman_gym.kernels.joints import any_prescribed, prescribed_power
from flexman_gym.kernels.kinematics import positions, velocities
from flexman_gym.kernels.layout import DIVERGED, LARGEST_STATE, NOT_CONVERGED, OK
from flexman_gym.kernels.linalg import copy, inner, kernel
from flexman_gym.kernels.outputs import observe

SAFETY, SMALLEST_FACTOR, LARGEST_FACTOR = 0.9, 0.2, 10.0  # step size control, Hairer, Norsett and Wanner I, II.4
SMALLEST_STEP = 1e-14  # of the interval


@inner
def slope(constants, work, table, time, state, out):
    """out (2 d + 2,) = time derivative of state and ledger."""
    d = len(state) // 2 - 1
    x, v = state[:d], state[d : 2 * d]
    drive_at(table, time, work.drive)
    out[2 * d], out[2 * d + 1] = accelerate(constants, work, x, v, out[d : 2 * d])
    for j in range(d):
        out[j] = v[j]


@inner
def out_of_bounds(state):
    """Whether a state is not finite or beyond LARGEST_STATE; the ledger is not looked at."""
    for j in range(len(state) - 2):
        if not abs(state[j]) <= LARGEST_STATE:
            return True
    return False


@inner
def add_stages(state, step, weights, stages, count, out):
    """out = state + step * sum of weights[j] * stages[j] over the first `count` stages."""
    for k in range(len(state)):
        out[k] = state[k]
    for j in range(count):
        weight = step * weights[j]
        if weight != 0.0:
            for k in range(len(state)):
                out[k] += weight * stages[j, k]


@inner
def explicit_stages(constants, work, tableau, table, time, step, state):
    """Stages 1, 2, ... of an explicit step into work.stages, which holds stage 0, and the new state into work.trial."""
    s = len(tableau.b)
    for i in range(1, s):
        add_stages(state, step, tableau.a[i], work.stages, i, work.stage_state)
        slope(constants, work, table, time + tableau.abscissae[i] * step, work.stage_state, work.stages[i])
    add_stages(state, step, tableau.b, work.stages, s, work.trial)


@kernel
def run_explicit(constants, work, tableau, table, clock, state, rows, outputs):
    """Fixed steps of an explicit Runge-Kutta method."""
    d, step, evaluations = len(state) // 2 - 1, clock.step, 0
    for r in range(len(rows)):
        for n in range(clock.substeps):
            time = clock.time + (r * clock.substeps + n) * step
            slope(constants, work, table, time, state, work.stages[0])
            explicit_stages(constants, work, tableau, table, time, step, state)
            evaluations += len(tableau.b)
            if out_of_bounds(work.trial):
                return DIVERGED, r, evaluations
            copy(work.trial, state)
        copy(state, rows[r])
        observe(constants, work, state[:d], state[d : 2 * d], outputs[r])
    return OK, len(rows), evaluations


@kernel
def run_linearly_implicit(constants, work, tableau, table, clock, state, rows, outputs):
    """Fixed steps of a W-method whose approximate Jacobian holds damping and stiffness of links and joint springs."""
    d, step, evaluations = len(state) // 2 - 1, clock.step, 0
    for r in range(len(rows)):
        for n in range(clock.substeps):
            time = clock.time + (r * clock.substeps + n) * step
            for i in range(len(tableau.b)):
                implicit_stage(constants, work, tableau, table, time, step, state, i)
            add_stages(state, 1.0, tableau.b, work.stages, len(tableau.b), work.trial)
            evaluations += len(tableau.b)
            if out_of_bounds(work.trial):
                return DIVERGED, r, evaluations
            copy(work.trial, state)
        copy(state, rows[r])
        observe(constants, work, state[:d], state[d : 2 * d], outputs[r])
    return OK, len(rows), evaluations


@inner
def implicit_stage(constants, work, tableau, table, time, step, state, i):
    """Stage i of a W-method into work.stages[i].

    With g = gamma step and r = sum of c_ij u_j / step, the stage u = (position part, speed part) solves
    u_x / g = v + u_v + r_x and M u_v / g = F(x, v) - K u_x - D u_v + M r_v. In w = u_v / g - r_v that is
    (M + g D + g^2 K) w = F with springs taken at x + g (v + r_x + g r_v) and dampers at v + g r_v: no product with M.
    D holds friction over rate at the start of the step.
    """
    d, size = len(state) // 2 - 1, len(state)
    g = tableau.gamma * step
    shift, stage = work.shift, work.stages[i]  # stage holds r until u is known
    add_stages(state, 1.0, tableau.a[i], work.stages, i, work.stage_state)
    for k in range(size):
        stage[k] = 0.0
    for j in range(i):
        weight = tableau.c[i, j] / step
        for k in range(size):
            stage[k] += weight * work.stages[j, k]
    x, v = work.stage_state[:d], work.stage_state[d : 2 * d]
    for k in range(d):
        shift[k] = g * (v[k] + stage[k] + g * stage[d + k])
        shift[d + k] = g * stage[d + k]
    drive_at(table, time + tableau.abscissae[i] * step, work.drive)
    positions(constants, work, x)
    velocities(constants, work, v)
    supplied, lost = applied_forces(constants, work, x, v)
    if any_prescribed(constants):
        factorise(constants, work, 0.0)  # the torque of a prescribed motion needs the true accelerations
        solve(constants, work, work.trial[:d])
        supplied += prescribed_power(constants, work, v)
    if i == 0:
        friction_slopes(constants, work, v)
    factorise(constants, work, g)
    structural_forces(constants, work, shift[:d], shift[d : 2 * d])
    friction_shift(constants, work, shift[d : 2 * d])
    solve(constants, work, work.trial[:d])
    for k in range(d):
        stage[d + k] = g * (work.trial[k] + stage[d + k])
        stage[k] = g * (v[k] + stage[k] + stage[d + k])
    stage[2 * d] = g * (supplied + stage[2 * d])
    stage[2 * d + 1] = g * (lost + stage[2 * d + 1])


@inner
def error_norm(tableau, stages, step, state, trial, rtol, atol):
    """Scaled error of an explicit step; with two error rows the combination of DOP853 (Hairer et al. I, II.10)."""
    size = len(state) - 2
    first = second = 0.0
    for k in range(size):
        scale = atol + rtol * max(abs(state[k]), abs(trial[k]))
        one = two = 0.0
        for j in range(len(tableau.b) + 1):
            one += tableau.error[0, j] * stages[j, k]
            if len(tableau.error) > 1:
                two += tableau.error[1, j] * stages[j, k]
        first += (one / scale) ** 2
        second += (two / scale) ** 2
    if len(tableau.error) == 1:
        return step * math.sqrt(first / size)
    if first == 0.0 and second == 0.0:
        return 0.0
    return step * first / math.sqrt((first + 0.01 * second) * size)


@kernel
def run_adaptive(constants, work, tableau, table, clock, state, rows, outputs, tolerance):
    """Adaptive steps of an explicit pair that end on every output time; tolerance = (rtol, atol)."""
    d, s, evaluations, step = len(state) // 2 - 1, len(tableau.b), 1, clock.step
    interval = clock.step * clock.substeps
    slope(constants, work, table, clock.time, state, work.stages[0])
    for r in range(len(rows)):
        done = 0.0
        while done < interval:
            time = clock.time + r * interval + done
            last = done + 1.0001 * step >= interval
            h = interval - done if last else step
            explicit_stages(constants, work, tableau, table, time, h, state)
            slope(constants, work, table, time + h, work.trial, work.stages[s])
            evaluations += s
            error = error_norm(tableau, work.stages, h, state, work.trial, tolerance[0], tolerance[1])
            if not error <= 1.0:
                step = h * (max(SMALLEST_FACTOR, SAFETY * error ** (-1.0 / tableau.order)) if error > 1.0 else 0.1)
                if step < SMALLEST_STEP * interval:
                    return (DIVERGED if out_of_bounds(work.trial) else NOT_CONVERGED), r, evaluations
                continue
            if out_of_bounds(work.trial):
                return DIVERGED, r, evaluations
            factor = LARGEST_FACTOR if error == 0.0 else SAFETY * error ** (-1.0 / tableau.order)
            step = max(step, h) if last else h
            step *= min(LARGEST_FACTOR, max(SMALLEST_FACTOR, factor)) if not (last and factor > 1.0) else 1.0
            done = interval if last else done + h
            copy(work.trial, state)
            copy(work.stages[s], work.stages[0])
        copy(state, rows[r])
        observe(constants, work, state[:d], state[d : 2 * d], outputs[r])
    return OK, len(rows), evaluations

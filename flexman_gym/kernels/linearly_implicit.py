"""Linearly implicit methods: W-methods and their extrapolation, by coefficients (`layout.Tableau`).

Runs are as in `explicit`.
"""

from flexman_gym.kernels.compile import inner, kernel
from flexman_gym.kernels.dynamics import factorise, solve
from flexman_gym.kernels.forces import applied_forces, drive_at, friction_shift, friction_slopes, structural_forces
from flexman_gym.kernels.groups import lane_number, store_lane_number
from flexman_gym.kernels.joints import any_prescribed, prescribed_power
from flexman_gym.kernels.kinematics import positions, velocities
from flexman_gym.kernels.lanes import fused
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
from flexman_gym.kernels.stages import add_stages


@kernel
def run_linearly_implicit(constants, work, tableau, table, clock, state, rows, outputs):
    """Steps of a W-method whose approximate Jacobian holds damping and stiffness of links and joints, extrapolated."""
    return run_steps(constants, work, None, tableau, table, clock, state, rows, outputs)


@inner
def run_steps(constants, work, lanes, tableau, table, clock, state, rows, outputs):
    """The run; with `lanes`, as `sequences_step` takes them, several sequences of a step are in the lanes."""
    d, evaluations = len(state) // 2 - 1, 0
    adaptive = clock.rtol > 0.0
    pace = first_pace(work, clock)
    _, n, done = resume(work)
    for r in range(len(rows)):
        last = clock.substeps == 0
        while not last:
            if evaluations >= clock.most:
                pause(work, n, done, pace)
                return PAUSED, r, evaluations
            time, h, last = next_step(clock, r, n, done, pace)
            if lanes is None:
                evaluations += implicit_step(constants, work, tableau, table, (time, h), state)
            else:
                evaluations += sequences_step(lanes, work, tableau, table, (time, h), state)
            if adaptive:
                error = error_norm(work, 1, clock, state)
                pace = next_pace(pace, h, last, error, tableau.order)
                if not error <= 1.0:
                    last = False
                    if pace < LEAST_PACE * clock.step * clock.substeps:
                        return (DIVERGED if out_of_bounds(work.trial) else NOT_CONVERGED), r, evaluations
                    continue
            if out_of_bounds(work.trial):
                return DIVERGED, r, evaluations
            copy(work.trial, state)
            n, done = n + 1, done + h
        n, done = 0, 0.0
        work.pace[0] = pace
        copy(state, rows[r])
        observe(constants, work, state[:d], state[d : 2 * d], outputs[r])
    return OK, len(rows), evaluations


@inner
def implicit_step(constants, work, tableau, table, moment, state):
    """work.trial = what follows the state; moment = (time, step). Returns the evaluations.

    Extrapolation takes the method in sequence[j] equal parts of the step, for each j, and adds the results with
    weights. All first parts start from the same state and share its kinematics.
    """
    s, parts, evaluations, (time, step) = len(tableau.b), tableau.sequence, 0, moment
    for j in range(len(parts)):
        copy(state, work.extrapolated[j])
    for p in range(parts[-1]):
        for j in range(len(parts)):
            if p >= parts[j]:
                continue
            part, start = step / parts[j], work.extrapolated[j]
            for i in range(s):
                moved = p > 0 or i > 0 or j == 0
                implicit_stage(constants, work, tableau, table, (time + p * part, part), start, i, moved)
                evaluations += 1
            add_stages(start, 1.0, tableau.b, work.stages, s, start)
    extrapolate(work, tableau, state)
    return evaluations


@inner
def sequences_step(lanes, work, tableau, table, moment, state):
    """The same for a method of one stage, several sequences at once; `work` is that of one arm.

    `lanes` are constants, work space and rounds (r, lanes, 2): which sequence is in a lane in a round, and which of its
    parts is next. A lane for which none is left goes on with its last one, at which nobody looks.
    """
    (constants, abreast, rounds), parts, (time, step) = lanes, tableau.sequence, moment
    start, steps = abreast.row, abreast.pace
    for r in range(len(rounds)):
        for k in range(rounds.shape[1]):
            j, p = rounds[r, k, 0], rounds[r, k, 1]
            part = step / parts[j]
            store_lane_number(steps, 0, k, part)
            drive_at(table, time + p * part, work.drive)
            for i in range(len(work.drive)):
                store_lane_number(abreast.drive, i, k, work.drive[i])
            for i in range(len(state) if p == 0 else 0):
                store_lane_number(start, i, k, state[i])
        implicit_stage(constants, abreast, tableau, None, (0.0, steps[0]), start, 0, True)
        add_stages(start, 1.0, tableau.b, abreast.stages, 1, start)
        for k in range(rounds.shape[1]):
            j = rounds[r, k, 0]
            if rounds[r, k, 1] + 1 == parts[j]:
                for i in range(len(state)):
                    work.extrapolated[j, i] = lane_number(start, i, k)
    extrapolate(work, tableau, state)
    evaluations = 0
    for j in range(len(parts)):
        evaluations += parts[j]
    return evaluations


@inner
def extrapolate(work, tableau, state):
    """work.trial = the weighted results of all sequences; work.estimate[0] = the error that they show."""
    for k in range(len(state)):
        value = wrong = 0.0
        for j in range(len(tableau.sequence)):
            # differences from the state lose no digits to its size
            change = work.extrapolated[j, k] - state[k]
            value = fused(tableau.weights[j], change, value)
            wrong = fused(tableau.sequence_error[j], change, wrong)
        for e in range(len(tableau.error)):
            for i in range(len(tableau.b)):
                wrong += tableau.error[e, i] * work.stages[i, k]
        work.trial[k], work.estimate[0, k] = state[k] + value, wrong


@inner
def implicit_stage(constants, work, tableau, table, moment, state, i, moved):
    """Stage i of a W-method into work.stages[i]; moment = (time, step); `moved` if kinematics must be computed anew.

    With g = gamma step and r = sum of c_ij u_j / step, the stage u = (position part, speed part) solves
    u_x / g = v + u_v + r_x and M u_v / g = F(x, v) - K u_x - D u_v + M r_v. In w = u_v / g - r_v that is
    (M + g D + g^2 K) w = F with springs taken at x + g (v + r_x + g r_v) and dampers at v + g r_v: no product with M.
    D holds friction over rate at the start of the step.
    """
    d, size, (time, step) = len(state) // 2 - 1, len(state), moment
    g = tableau.gamma * step
    shift, stage = work.shift, work.stages[i]  # stage holds r until u is known
    add_stages(state, 1.0, tableau.a[i], work.stages, i, work.stage_state)
    for k in range(size):
        stage[k] = 0.0
    for j in range(i):
        weight = tableau.c[i, j] / step
        for k in range(size):
            stage[k] = fused(weight, work.stages[j, k], stage[k])
    x, v = work.stage_state[:d], work.stage_state[d : 2 * d]
    for k in range(d):
        shift[k] = g * fused(g, stage[d + k], v[k] + stage[k])
        shift[d + k] = g * stage[d + k]
    if moved:
        drive_at(table, time + tableau.abscissae[i] * step, work.drive)
        positions(constants, work, x)
        velocities(constants, work, v)
    supplied, lost = applied_forces(constants, work, x, v)
    if i == 0:
        friction_slopes(constants, work, v)
    for implicit in range(0 if any_prescribed(constants) else 1, 2):
        if implicit:
            structural_forces(constants, work, shift[:d], shift[d : 2 * d])
            friction_shift(constants, work, shift[d : 2 * d])
        factorise(constants, work, (g * float(implicit), g * g * float(implicit)))
        solve(constants, work, work.rates)
        if not implicit:  # the torque of a prescribed motion needs the true accelerations
            supplied += prescribed_power(constants, work, v)
    for k in range(d):
        stage[d + k] = g * (work.rates[k] + stage[d + k])
        stage[k] = g * (v[k] + stage[k] + stage[d + k])
    stage[2 * d] = g * (supplied + stage[2 * d])
    stage[2 * d + 1] = g * (lost + stage[2 * d + 1])

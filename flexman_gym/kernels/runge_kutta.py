"""Runge-Kutta methods given by their coefficients (`layout.Tableau`): explicit, linearly implicit, step size control.

Explicit methods include the semi-implicit Euler method; linearly implicit methods are W-methods and their
extrapolation. `batch.run_steps` repeats steps of equal length, `run_adaptive` steps whose lengths follow the estimated
error. A paused integration (`TimeGrid.max_evaluations`) leaves its progress in work.progress: the next call receives
the state at the pause, the remaining rows and `TimeGrid.first_row`, and the results equal the results of a single call
to the bit. A kernel has a single call of the dynamics, because the compiler inlines the dynamics at every call.
"""

import math

from flexman_gym.kernels.arguments import constants_of, field, work_of
from flexman_gym.kernels.compile import inner, kernel
from flexman_gym.kernels.dynamics import factorise, prescribed_power, solve
from flexman_gym.kernels.forces import applied_forces, evaluate_drive, secant_friction, shift_forces, tangent_springs
from flexman_gym.kernels.foundation import evaluate_foundation, load_foundation
from flexman_gym.kernels.kinematics import compute_kinematics
from flexman_gym.kernels.lanes import extract_lane, fma, insert_lane, value_lane
from flexman_gym.kernels.layout import DIVERGED, LARGEST_STATE, NOT_CONVERGED, OK, PAUSED
from flexman_gym.kernels.linalg import copy
from flexman_gym.kernels.outputs import set_outputs

SAFETY, MIN_FACTOR, MAX_FACTOR = 0.9, 0.2, 10.0  # step size control; Hairer, Norsett and Wanner, Solving ODEs I, II.4
MIN_STEP = 1e-14  # dimensionless; smallest step as a fraction of the interval between outputs


@inner
def _resume(work):
    """Return the first stage, 1 after a pause, and the simulated time (s) since the last output; clear both."""
    paused, elapsed = work.progress[0], work.progress[1]
    work.progress[:] = 0.0
    return 1 if paused > 0.0 else 0, elapsed


@inner
def _pause(work, elapsed, step_size):
    """Store the simulated time `elapsed` (s) since the last output, and the length of the next step (s)."""
    work.progress[0], work.progress[1], work.next_step[0] = 1.0, elapsed, step_size


@inner
def _next_step(grid, r, elapsed, step_size):
    """Return start and length (s) of the next step of interval r, `elapsed` s of simulated time after its start.

    The third value is True for the last step of the interval.
    """
    interval = grid.step * grid.substeps
    last = elapsed + 1.0001 * step_size >= interval
    start = grid.time + (grid.first_row + r) * interval + elapsed
    return start, (interval - elapsed if last else step_size), last


@inner
def _next_step_size(step_size, h, last, error, order):
    """Return the next step size (s) after a step of length h (s) with a scaled error and an error order.

    A step shortened to end at an output (`last`) contains little information about larger steps.
    """
    if not error >= 0.0:  # NaN
        return 0.1 * h
    factor = MAX_FACTOR if error == 0.0 else SAFETY * error ** (-1.0 / order)
    factor = min(MAX_FACTOR, max(MIN_FACTOR, factor))
    if last and h < step_size and error <= 1.0:
        return step_size * min(factor, 1.0)
    return h * factor


@inner
def _error_norm(work, count, grid, state):
    """Return the scaled error of a step from 1 or 2 estimates, combined as in DOP853 (Solving ODEs I, II.10)."""
    size = len(state) - 2
    first = second = 0.0
    for k in range(size):
        scale = grid.atol + grid.rtol * max(abs(state[k]), abs(work.new_state[k]))
        first += (work.error_estimate[0, k] / scale) ** 2
        if count > 1:
            second += (work.error_estimate[1, k] / scale) ** 2
    if count == 1:
        return math.sqrt(first / size)
    if first == 0.0 and second == 0.0:
        return 0.0
    return first / math.sqrt((first + 0.01 * second) * size)


@inner
def in_bounds(state, k):
    """Return True if coordinates and speeds in lane k, for a derivative in the lane of its arm, are in LARGEST_STATE.

    Infinite numbers and NaN are not; the ledger is not checked.
    """
    for j in range(len(state) - 2):
        if not abs(extract_lane(state, j, value_lane(state, k))) <= LARGEST_STATE:
            return False
    return True


@inner
def _stage_derivative(constants, work, table, time, state, out):
    """Set out (2 d + 2,) to the time derivative of state and ledger."""
    d = len(state) // 2 - 1
    x, v = state[:d], state[d : 2 * d]
    evaluate_drive(work, table, time)
    compute_kinematics(constants, work, x, v)
    factorise(constants, work, (0.0, 0.0))
    supplied, dissipated = applied_forces(constants, work, x, v)
    solve(constants, work, out[d : 2 * d])
    out[2 * d], out[2 * d + 1] = supplied + prescribed_power(constants, work, v), dissipated
    for j in range(d):
        out[j] = v[j]


@kernel
def state_derivative(constants, work, table, time, state, out):
    """Set out (2 d + 2,) to the time derivative of state and ledger (2 d + 2,) at a time (s)."""
    load_foundation(work, table)
    _stage_derivative(constants, work, table, time, field(state), field(out))


@inner
def _add_stages(state, step, weights, stages, count, out):
    """Set out to state + step * sum of weights[j] * stages[j] over the first `count` stages."""
    for k in range(len(state)):
        out[k] = state[k]
    for j in range(count):
        weight = step * weights[j]
        if weight != 0.0:
            for k in range(len(state)):
                out[k] = fma(weight, stages[j, k], out[k])


@kernel
def run_adaptive(constants, work, method, tableau, table, grid, state, rows, outputs):
    """Integrate an arm by steps whose lengths follow the estimated error.

    Args:
        constants: `layout.Constants` of the arm.
        work: `layout.Work` of the arm.
        method: result of `layout.step_method` for a method with an error estimate.
        tableau: tableau of this method.
        table: (7, n + 6) drive table of `layout`.
        grid: time grid of the rows.
        state: (2 d + 2,) state and ledger (work and dissipation, J), overwritten.
        rows: (r, 2 d + 2) states and ledgers after each interval, overwritten.
        outputs: (r, OUTPUTS) results of `set_outputs`, overwritten.

    Returns:
        Status, number of valid rows and number of evaluations of the accelerations.
    """
    state, rows, outputs = field(state), field(rows), field(outputs)
    load_foundation(work, table)
    d, evaluations = len(state) // 2 - 1, 0
    step_size = work.next_step[0] if work.next_step[0] > 0.0 else grid.step
    first_stage, elapsed = _resume(work)
    for r in range(len(rows)):
        last = grid.substeps == 0
        while not last:
            if evaluations >= grid.max_evaluations:
                _pause(work, elapsed, step_size)
                return PAUSED, r, evaluations
            time, h, last = _next_step(grid, r, elapsed, step_size)
            evaluations += _explicit_trial(constants, work, method[0], table, (time, h), state, first_stage)
            evaluations += linearly_implicit_step(constants, work, method[1], table, (time, h), state)
            evaluations += sequences_step(work, method[2], table, (time, h), state)
            error = _error_norm(work, max(1, len(tableau.error)), grid, state)
            step_size, first_stage = _next_step_size(step_size, h, last, error, tableau.order), 1
            if not error <= 1.0:
                last = False
                if step_size < MIN_STEP * grid.step * grid.substeps:
                    return (NOT_CONVERGED if in_bounds(work.new_state, 0) else DIVERGED), r, evaluations
                continue
            if not in_bounds(work.new_state, 0):
                return DIVERGED, r, evaluations
            copy(work.stages[len(tableau.b)], work.stages[0])  # stage 0 of the next step of an explicit method
            copy(work.new_state, state)
            elapsed += h
        elapsed = 0.0
        work.next_step[0] = step_size
        copy(state, rows[r])
        evaluate_foundation(work, grid.time + (grid.first_row + r + 1) * grid.step * grid.substeps)
        set_outputs(constants, work, state[:d], state[d : 2 * d], outputs[r])
    return OK, len(rows), evaluations


@inner
def _explicit_trial(constants, work, tableau, table, span, state, first_stage):
    """Set work.new_state and work.error_estimate after a step of an explicit method; return the evaluations.

    The stages before `first_stage` are those of the previous step. The end of the step is evaluated as stage s. Zero
    for the tableau None, see `batch.fixed_step`.
    """
    if tableau is None:
        return 0
    end = len(tableau.b) + 1
    _explicit_stages(constants, work, tableau, table, span, state, (first_stage, end))
    for e in range(len(tableau.error)):
        for k in range(len(state)):
            work.error_estimate[e, k] = 0.0
        _add_stages(work.error_estimate[e], span[1], tableau.error[e], work.stages, end, work.error_estimate[e])
    return end - first_stage


@inner
def explicit_step(constants, work, tableau, table, span, state):
    """Set work.new_state to the state and ledger after a step; return the evaluations, see `batch.fixed_step`."""
    if tableau is None:
        return 0
    _explicit_stages(constants, work, tableau, table, span, state, (0, len(tableau.b)))
    return len(tableau.b)


@inner
def _explicit_stages(constants, work, tableau, table, span, state, stages):
    """Set work.new_state to the state and ledger after a step; span = (start time, step), s.

    `stages` = (first, end): stages that are evaluated; all are 0 to s, see `_explicit_trial`.
    """
    d, s, (time, h), (first, end) = len(state) // 2 - 1, len(tableau.b), span, stages
    for i in range(first, end):
        weights = tableau.a[i] if i < s else tableau.b
        _add_stages(state, h, weights, work.stages, min(i, s), work.stage_state)
        _stage_derivative(constants, work, table, time + tableau.abscissae[i] * h, work.stage_state, work.stages[i])
    _add_stages(state, h, tableau.b, work.stages, s, work.new_state)
    if tableau.semi_implicit:
        for k in range(d):
            work.new_state[k] = state[k] + h * work.new_state[d + k]


@inner
def linearly_implicit_step(constants, work, tableau, table, span, state):
    """Set work.new_state to the state and ledger after a step of a W-method; return the evaluations.

    span = (start time, step), s; see `batch.fixed_step`. The approximate Jacobian contains damping and stiffness of
    links and joints, and motor friction. An extrapolation method divides the step into sequence[j] equal substeps, for
    each j, and adds the results with weights. The first substeps of all sequences start from the same state and share
    its kinematics.
    """
    if tableau is None:
        return 0
    s, parts, evaluations, (time, step) = len(tableau.b), tableau.sequence, 0, span
    for j in range(len(parts)):
        copy(state, work.extrapolated[j])
    for p in range(parts[-1]):
        for j in range(len(parts)):
            if p >= parts[j]:
                continue
            part, start = step / parts[j], work.extrapolated[j]
            for i in range(s):
                update = p > 0 or i > 0 or j == 0
                _implicit_stage(constants, work, tableau, table, (time + p * part, part), start, i, update)
                evaluations += 1
            _add_stages(start, 1.0, tableau.b, work.stages, s, start)
    _extrapolate(work, tableau, state)
    return evaluations


@inner
def sequences_step(work, method, table, span, state):
    """Set work.new_state as `linearly_implicit_step`, to the bit, for an extrapolated step of a one-stage method.

    Several sequences of the step of one arm are computed at once. `work` are the scratch arrays of the arm. method =
    (tableau, `arguments.SequenceTables`, schedule (r, lanes, 2)): the schedule is the sequence and the substep of each
    SIMD lane in each of r rounds. An idle lane repeats steps whose results are discarded.
    """
    if method is None:
        return 0
    (tableau, tables, schedule), (time, step), evaluations = method, span, 0
    constants, lane_work, parts = constants_of(tables, 0), work_of(tables, 0), tableau.sequence
    start, steps = lane_work.row, lane_work.next_step
    for r in range(len(schedule)):
        for k in range(schedule.shape[1]):
            j, p = schedule[r, k, 0], schedule[r, k, 1]
            part = step / parts[j]
            insert_lane(steps, 0, k, part)
            evaluate_drive(work, table, time + p * part)
            for i in range(len(work.drive)):
                insert_lane(lane_work.drive, i, k, work.drive[i])
            for i in range(len(state) if p == 0 else 0):
                insert_lane(start, i, k, state[i])
        _implicit_stage(constants, lane_work, tableau, None, (0.0, steps[0]), start, 0, True)
        _add_stages(start, 1.0, tableau.b, lane_work.stages, 1, start)
        for k in range(schedule.shape[1]):
            j = schedule[r, k, 0]
            if schedule[r, k, 1] + 1 == parts[j]:
                for i in range(len(state)):
                    work.extrapolated[j, i] = extract_lane(start, i, k)
    _extrapolate(work, tableau, state)
    for j in range(len(parts)):
        evaluations += parts[j]
    return evaluations


@inner
def _extrapolate(work, tableau, state):
    """Set work.new_state to the weighted sum of the results of all sequences, and work.error_estimate[0]."""
    for k in range(len(state)):
        value = error = 0.0
        for j in range(len(tableau.sequence)):
            # sums of changes have smaller rounding errors than sums of states
            change = work.extrapolated[j, k] - state[k]
            value = fma(tableau.weights[j], change, value)
            error = fma(tableau.sequence_error[j], change, error)
        for e in range(len(tableau.error)):
            for i in range(len(tableau.b)):
                error += tableau.error[e, i] * work.stages[i, k]
        work.new_state[k], work.error_estimate[0, k] = state[k] + value, error


@inner
def _implicit_stage(constants, work, tableau, table, span, state, i, update):
    """Set work.stages[i] to stage i of a W-method; span = (start time, step), s.

    With g = gamma step and r = sum of c_ij u_j / step, the stage u = (u_x, u_v) for x and v solves
    u_x / g = v + u_v + r_x and M u_v / g = F(x, v) - K u_x - D u_v + M r_v. For w = u_v / g - r_v this is
    (M + g D + g^2 K) w = F with springs at x + g (v + r_x + g r_v) and dampers at v + g r_v: no product with M is
    needed. D contains the secant of friction and K the tangents of springs with knees at the start of the step.
    Kinematics are computed if `update`.
    """
    d, size, (time, step) = len(state) // 2 - 1, len(state), span
    g = tableau.gamma * step
    shift, stage = work.shift, work.stages[i]  # stage contains r until u is computed
    _add_stages(state, 1.0, tableau.a[i], work.stages, i, work.stage_state)
    for k in range(size):
        stage[k] = 0.0
    for j in range(i):
        weight = tableau.c[i, j] / step
        for k in range(size):
            stage[k] = fma(weight, work.stages[j, k], stage[k])
    x, v = work.stage_state[:d], work.stage_state[d : 2 * d]
    for k in range(d):
        shift[k] = g * fma(g, stage[d + k], v[k] + stage[k])
        shift[d + k] = g * stage[d + k]
    if update:
        evaluate_drive(work, table, time + tableau.abscissae[i] * step)
        compute_kinematics(constants, work, x, v)
    supplied, dissipated = applied_forces(constants, work, x, v)
    if i == 0:
        tangent_springs(constants, work, x)
        secant_friction(constants, work, v)
    for implicit in range(0 if _any_prescribed(constants) else 1, 2):
        if implicit:
            shift_forces(constants, work, shift[:d], shift[d : 2 * d])
        factorise(constants, work, (g * float(implicit), g * g * float(implicit)))
        solve(constants, work, work.rates)
        if not implicit:  # the torque of a prescribed motion follows from the accelerations without shift
            supplied += prescribed_power(constants, work, v)
    for k in range(d):
        stage[d + k] = g * (work.rates[k] + stage[d + k])
        stage[k] = g * (v[k] + stage[k] + stage[d + k])
    stage[2 * d] = g * (supplied + stage[2 * d])
    stage[2 * d + 1] = g * (dissipated + stage[2 * d + 1])


@inner
def _any_prescribed(constants):
    """Return True if the motion of a motor or the rotation of the base is prescribed."""
    if constants.rotating[0]:
        return True
    for i in range(len(constants.prescribed)):
        if constants.prescribed[i]:
            return True
    return False

"""Runge-Kutta methods by their coefficients (`layout.Tableau`), explicit and linearly implicit, with step size control.

Explicit methods include the semi-implicit Euler method; linearly implicit ones are W-methods and their
extrapolation. A run fills rows (r, 2 d + 2) with the state and the ledger after every interval of the clock, and
outputs (r, OUTPUTS) with the values of `compute_outputs` there. It returns a status, the number of valid rows and the
number of evaluations. The state that is passed in is advanced in place. `table` is that of the drive, see `layout`.
A run that pauses (`Clock.most`) leaves in `work` the data to continue: the next call takes its state and the
remaining rows, with `Clock.first`, and the bits are those of one call. Each family has its own loop, with one call
of the dynamics in it, because the compiler copies that call wherever it stands.
"""

import math

from flexman_gym.kernels.compile import inner, kernel
from flexman_gym.kernels.dynamics import compute_accelerations, factorise, prescribed_power, solve
from flexman_gym.kernels.forces import (
    applied_forces,
    evaluate_drive,
    secant_friction,
    shift_friction,
    structural_forces,
)
from flexman_gym.kernels.kinematics import positions, velocities
from flexman_gym.kernels.lanes import extract_lane, fma, insert_lane
from flexman_gym.kernels.layout import DIVERGED, LARGEST_STATE, NOT_CONVERGED, OK, PAUSED
from flexman_gym.kernels.linalg import copy
from flexman_gym.kernels.outputs import compute_outputs

SAFETY, SMALLEST_FACTOR, LARGEST_FACTOR = 0.9, 0.2, 10.0  # step size control, Hairer, Norsett and Wanner I, II.4
SMALLEST_STEP = 1e-14  # of the interval


@inner
def _first_step_size(work, clock):
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
def step_start(clock, r, n):
    """Start (s) of step n of interval r of a call."""
    return clock.time + (clock.first + r * clock.substeps + n) * clock.step


@inner
def _next_step(clock, r, n, done, pace):
    """Start and length of step n of interval r, of which `done` has passed, and whether it is the last one."""
    if clock.rtol == 0.0:
        return step_start(clock, r, n), clock.step, n + 1 == clock.substeps
    interval = clock.step * clock.substeps
    last = done + 1.0001 * pace >= interval
    return clock.time + (clock.first // clock.substeps + r) * interval + done, (interval - done if last else pace), last


@inner
def _next_step_size(pace, h, last, error, order):
    """The step after one of length h with this error; one that was cut short to end an interval says little."""
    if not error <= 1.0:
        return h * (max(SMALLEST_FACTOR, SAFETY * error ** (-1.0 / order)) if error > 1.0 else 0.1)
    factor = LARGEST_FACTOR if error == 0.0 else SAFETY * error ** (-1.0 / order)
    factor = min(LARGEST_FACTOR, max(SMALLEST_FACTOR, factor))
    if not last:
        return h * factor
    return max(pace, h) * min(factor, 1.0) if h < pace else h * factor


@inner
def _error_norm(work, count, clock, state):
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


@inner
def _stage_derivative(constants, work, table, time, state, out):
    """out (2 d + 2,) = time derivative of state and ledger."""
    d = len(state) // 2 - 1
    x, v = state[:d], state[d : 2 * d]
    evaluate_drive(table, time, work.drive)
    out[2 * d], out[2 * d + 1] = compute_accelerations(constants, work, x, v, out[d : 2 * d])
    for j in range(d):
        out[j] = v[j]


@kernel
def state_derivative(constants, work, table, time, state, out):
    """out (2 d + 2,) = time derivative of state and ledger, for integrators outside the kernels."""
    _stage_derivative(constants, work, table, time, state, out)


@inner
def _add_stages(state, step, weights, stages, count, out):
    """out = state + step * sum of weights[j] * stages[j] over the first `count` stages."""
    for k in range(len(state)):
        out[k] = state[k]
    for j in range(count):
        weight = step * weights[j]
        if weight != 0.0:
            for k in range(len(state)):
                out[k] = fma(weight, stages[j, k], out[k])


@kernel
def run_explicit(constants, work, tableau, table, clock, state, rows, outputs):
    """Steps of an explicit Runge-Kutta method, or of the semi-implicit Euler method."""
    d, s, evaluations = len(state) // 2 - 1, len(tableau.b), 0
    adaptive = clock.rtol > 0.0
    pace = _first_step_size(work, clock)
    paused, n, done = resume(work)
    known = 1 if paused and adaptive else 0
    for r in range(len(rows)):
        last = clock.substeps == 0
        while not last:
            if evaluations >= clock.most:
                pause(work, n, done, pace)
                return PAUSED, r, evaluations
            time, h, last = _next_step(clock, r, n, done, pace)
            for i in range(known, s + adaptive):  # the slope after the step, if wanted, is stage s
                weights = tableau.a[i] if i < s else tableau.b
                _add_stages(state, h, weights, work.stages, min(i, s), work.stage_state)
                _stage_derivative(
                    constants, work, table, time + tableau.abscissae[i] * h, work.stage_state, work.stages[i]
                )
                evaluations += 1
            _add_stages(state, h, tableau.b, work.stages, s, work.trial)
            if tableau.semi_implicit:
                for k in range(d):
                    work.trial[k] = state[k] + h * work.trial[d + k]
            if adaptive:
                for e in range(len(tableau.error)):
                    for k in range(len(state)):
                        work.estimate[e, k] = 0.0
                    _add_stages(work.estimate[e], h, tableau.error[e], work.stages, s + 1, work.estimate[e])
                error = _error_norm(work, len(tableau.error), clock, state)
                pace, known = _next_step_size(pace, h, last, error, tableau.order), 1
                if not error <= 1.0:
                    last = False
                    if pace < SMALLEST_STEP * clock.step * clock.substeps:
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
        compute_outputs(constants, work, state[:d], state[d : 2 * d], outputs[r])
    return OK, len(rows), evaluations


@kernel
def run_linearly_implicit(constants, work, tableau, table, clock, state, rows, outputs):
    """Steps of a W-method whose approximate Jacobian holds damping and stiffness of links and joints, extrapolated."""
    return run_w_method(constants, work, None, tableau, table, clock, state, rows, outputs)


@inner
def run_w_method(constants, work, lanes, tableau, table, clock, state, rows, outputs):
    """The run; with `lanes`, as `_sequences_step` takes them, several sequences of a step are in the lanes."""
    d, evaluations = len(state) // 2 - 1, 0
    adaptive = clock.rtol > 0.0
    pace = _first_step_size(work, clock)
    _, n, done = resume(work)
    for r in range(len(rows)):
        last = clock.substeps == 0
        while not last:
            if evaluations >= clock.most:
                pause(work, n, done, pace)
                return PAUSED, r, evaluations
            time, h, last = _next_step(clock, r, n, done, pace)
            if lanes is None:
                evaluations += linearly_implicit_step(constants, work, tableau, table, (time, h), state)
            else:
                evaluations += _sequences_step(lanes, work, tableau, table, (time, h), state)
            if adaptive:
                error = _error_norm(work, 1, clock, state)
                pace = _next_step_size(pace, h, last, error, tableau.order)
                if not error <= 1.0:
                    last = False
                    if pace < SMALLEST_STEP * clock.step * clock.substeps:
                        return (DIVERGED if out_of_bounds(work.trial) else NOT_CONVERGED), r, evaluations
                    continue
            if out_of_bounds(work.trial):
                return DIVERGED, r, evaluations
            copy(work.trial, state)
            n, done = n + 1, done + h
        n, done = 0, 0.0
        work.pace[0] = pace
        copy(state, rows[r])
        compute_outputs(constants, work, state[:d], state[d : 2 * d], outputs[r])
    return OK, len(rows), evaluations


@inner
def linearly_implicit_step(constants, work, tableau, table, moment, state):
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
                _implicit_stage(constants, work, tableau, table, (time + p * part, part), start, i, moved)
                evaluations += 1
            _add_stages(start, 1.0, tableau.b, work.stages, s, start)
    _extrapolate(work, tableau, state)
    return evaluations


@inner
def _sequences_step(lanes, work, tableau, table, moment, state):
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
            insert_lane(steps, 0, k, part)
            evaluate_drive(table, time + p * part, work.drive)
            for i in range(len(work.drive)):
                insert_lane(abreast.drive, i, k, work.drive[i])
            for i in range(len(state) if p == 0 else 0):
                insert_lane(start, i, k, state[i])
        _implicit_stage(constants, abreast, tableau, None, (0.0, steps[0]), start, 0, True)
        _add_stages(start, 1.0, tableau.b, abreast.stages, 1, start)
        for k in range(rounds.shape[1]):
            j = rounds[r, k, 0]
            if rounds[r, k, 1] + 1 == parts[j]:
                for i in range(len(state)):
                    work.extrapolated[j, i] = extract_lane(start, i, k)
    _extrapolate(work, tableau, state)
    evaluations = 0
    for j in range(len(parts)):
        evaluations += parts[j]
    return evaluations


@inner
def _extrapolate(work, tableau, state):
    """work.trial = the weighted results of all sequences; work.estimate[0] = the error that they show."""
    for k in range(len(state)):
        value = wrong = 0.0
        for j in range(len(tableau.sequence)):
            # differences from the state lose no digits to its size
            change = work.extrapolated[j, k] - state[k]
            value = fma(tableau.weights[j], change, value)
            wrong = fma(tableau.sequence_error[j], change, wrong)
        for e in range(len(tableau.error)):
            for i in range(len(tableau.b)):
                wrong += tableau.error[e, i] * work.stages[i, k]
        work.trial[k], work.estimate[0, k] = state[k] + value, wrong


@inner
def _implicit_stage(constants, work, tableau, table, moment, state, i, moved):
    """Stage i of a W-method into work.stages[i]; moment = (time, step); `moved` if kinematics must be computed anew.

    With g = gamma step and r = sum of c_ij u_j / step, the stage u = (position part, speed part) solves
    u_x / g = v + u_v + r_x and M u_v / g = F(x, v) - K u_x - D u_v + M r_v. In w = u_v / g - r_v that is
    (M + g D + g^2 K) w = F with springs taken at x + g (v + r_x + g r_v) and dampers at v + g r_v: no product with M.
    D holds friction over rate at the start of the step.
    """
    d, size, (time, step) = len(state) // 2 - 1, len(state), moment
    g = tableau.gamma * step
    shift, stage = work.shift, work.stages[i]  # stage holds r until u is known
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
    if moved:
        evaluate_drive(table, time + tableau.abscissae[i] * step, work.drive)
        positions(constants, work, x)
        velocities(constants, work, v)
    supplied, lost = applied_forces(constants, work, x, v)
    if i == 0:
        secant_friction(constants, work, v)
    for implicit in range(0 if _any_prescribed(constants) else 1, 2):
        if implicit:
            structural_forces(constants, work, shift[:d], shift[d : 2 * d])
            shift_friction(constants, work, shift[d : 2 * d])
        factorise(constants, work, (g * float(implicit), g * g * float(implicit)))
        solve(constants, work, work.rates)
        if not implicit:  # the torque of a prescribed motion needs the true accelerations
            supplied += prescribed_power(constants, work, v)
    for k in range(d):
        stage[d + k] = g * (work.rates[k] + stage[d + k])
        stage[k] = g * (v[k] + stage[k] + stage[d + k])
    stage[2 * d] = g * (supplied + stage[2 * d])
    stage[2 * d + 1] = g * (lost + stage[2 * d + 1])


@inner
def _any_prescribed(constants):
    """Whether the motion of any motor is prescribed."""
    for i in range(len(constants.prescribed)):
        if constants.prescribed[i]:
            return True
    return False

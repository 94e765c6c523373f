"""Batch kernels: b arms of one model, each in a lane of the SIMD registers of the processor.

The kernels of an integration step are compiled for scratch arrays whose elements are groups of ARMS_PER_GROUP numbers,
one for each arm. No operation combines lanes, so the motion of an arm does not depend on the other arms, bit for bit.
Constants that may differ between arms (`arguments.PER_ARM`) are groups as well; all arms share the other constants. A
call passes tables of addresses instead of arrays, which saves microseconds.
"""

from flexman_gym.kernels.arguments import constants_of, work_of
from flexman_gym.kernels.compile import inner, released
from flexman_gym.kernels.control_period import NOT_DONE, finish_period, start_period
from flexman_gym.kernels.foundation import evaluate_foundation, evaluate_foundation_end, load_foundation
from flexman_gym.kernels.implicit import converged_step, gauss_step, midpoint_step
from flexman_gym.kernels.lanes import extract_lane, insert_lane, lane_count
from flexman_gym.kernels.layout import ARMS_PER_GROUP, DIVERGED, NOT_CONVERGED, OK
from flexman_gym.kernels.linalg import copy
from flexman_gym.kernels.outputs import compute_tip_accelerations, set_outputs
from flexman_gym.kernels.runge_kutta import explicit_step, in_bounds, linearly_implicit_step, sequences_step


@inner
def fixed_step(constants, work, method, table, span, state):
    """Set work.new_state to the state and ledger after a step; span = (start time, step), s.

    The ledger is work and dissipation since the start, J. `method` is a result of `layout.step_method`: the step of a
    family whose argument is None returns 0, and Numba removes the rest of this step when it compiles the kernel.
    Returns the number of evaluations of the accelerations, negative if the step does not converge.
    """
    explicit, linearly_implicit, sequences, midpoint, gauss, converged = method
    evaluations = explicit_step(constants, work, explicit, table, span, state)
    evaluations += linearly_implicit_step(constants, work, linearly_implicit, table, span, state)
    evaluations += sequences_step(work, sequences, table, span, state)
    evaluations += midpoint_step(constants, work, midpoint, table, span, state)
    evaluations += gauss_step(constants, work, gauss, table, span, state)
    return evaluations + converged_step(constants, work, converged, table, span, state)


@inner
def _advance_steps(constants, work, method, steps, state):
    """Advance the state and ledger (2 d + 2,) under the inputs work.drive, and compute work.outputs.

    steps = (length in s, number). The method is that of `fixed_step`; its steps cannot fail to converge.
    """
    d, (step, number) = len(state) // 2 - 1, steps
    for n in range(number):
        fixed_step(constants, work, method, None, (n * step, step), state)
        copy(work.new_state, state)
    evaluate_foundation(work, number * step)
    set_outputs(constants, work, state[:d], state[d : 2 * d], work.outputs)


@released
def advance_batch(tables, method, inputs, steps, rows, out, status, trail):
    """Integrate arms over T control periods of constant inputs.

    Args:
        tables: `arguments.ArmTables` of the arms.
        method: result of `layout.step_method`.
        inputs: drives (b, T, n + 6) in each period: n motor torques (N m), or accelerations (rad/s^2) of motors with
            prescribed motion, tip force (3, N) and base acceleration (3, m/s^2). Then a table, times and rows of PD
            control of the motors, see `_add_feedback`, which needs a trail; arrays with b = 0 for none.
        steps: length (s) and number of the steps in a period.
        rows: (b, 2 d + 2) states, each followed by work and dissipation, J (the energy ledger), at the end of the last
            successful period, overwritten.
        out: (b, OUTPUTS) output rows, overwritten.
        status: (b,) arms whose status is not OK are not integrated; set to DIVERGED for arms that diverge.
        trail: record of the rows (b, T, 2 d + 2) and outputs (b, T, OUTPUTS) after each successful period, overwritten;
            (b, 0, ...) records none.
    """
    work, drives = work_of(tables, 0), inputs[0]
    state = work.row
    for group in range(len(tables[0])):
        first, end = group * ARMS_PER_GROUP, min((group + 1) * ARMS_PER_GROUP, len(rows))
        if _any_moving(status, first, end):
            _set_lanes(rows, first, state)
            for t in range(drives.shape[1]):
                _set_inputs(drives[:, t], first, work)
                if len(inputs[1]) > 0:
                    motor = constants_of(tables, group).motor
                    _add_feedback(motor, inputs[1:], trail[0], (first, end, t), work.drive)
                _advance_steps(constants_of(tables, group), work, method, steps, state)
                for arm in range(first, end):
                    if status[arm] == OK and not in_bounds(state, arm - first):
                        status[arm] = DIVERGED
                    if status[arm] == OK:
                        _copy_lane(state, arm - first, rows[arm])
                        _copy_lane(work.outputs, arm - first, out[arm])
                        _record_period(trail, arm, t, rows, out)


@inner
def _add_feedback(motor, feedback, rows, place, drive):
    """Add sampled PD torques, delayed by whole periods, to the drive in period t, and clip the sums to the limits.

    Args:
        motor: `Constants.motor`.
        feedback: table (b, 4, n) of stiffness (N m/rad), damping (N m s/rad), torque limit (N m) and reference (rad) of
            each motor; (b, 2) first period with feedback and delay in periods; (b, 2 d + 2) rows at the start, from
            which the motors are read while the delayed period precedes it.
        rows: (b, T, 2 d + 2) rows after each period up to t - 1.
        place: first and end index of the arms of the group, and t.
        drive: inputs of the group, overwritten.
    """
    (table, timing, start), (first, end, t) = feedback, place
    d = start.shape[1] // 2 - 1
    for arm in range(first, end):
        if t >= timing[arm, 0]:
            read = t - 1 - timing[arm, 1]
            for j in range(table.shape[2]):
                column = motor[j] if motor[j] >= 0 else j
                angle = rows[arm, read, column] if read >= 0 else start[arm, column]
                rate = rows[arm, read, d + column] if read >= 0 else start[arm, d + column]
                torque = extract_lane(drive, j, arm - first)
                torque += table[arm, 0, j] * (table[arm, 3, j] - angle) - table[arm, 1, j] * rate
                insert_lane(drive, j, arm - first, min(max(torque, -table[arm, 2, j]), table[arm, 2, j]))


@released
def advance_single(tables, method, drives, steps, rows, out, status, trail):
    """Advance a single arm, alone or as a control period of an environment.

    Args:
        tables: `arguments.SingleTables` of the arm, followed by the address table (fields, 3) of the `Period` of an
            environment, empty without an environment.
        method: as in `advance_batch`.
        drives: (1, T, n + 6) inputs as in `advance_batch`; in an environment T = 1, and the action sets the torques.
        steps: length (s) and number of the steps in a period.
        rows: (1, 2 d + 2) state and ledger, overwritten.
        out: (1, OUTPUTS) output row, overwritten.
        status: (1,) as in `advance_batch`.
        trail: record of the rows and outputs after each valid period.

    Returns:
        NOT_DONE for an action that is not allowed, without an effect; otherwise the result of
        `control_period.finish_period`, or 0 without an environment.
    """
    period = tables[2]
    if len(period) > 0 and not start_period(period):
        return NOT_DONE
    work = work_of(tables, 0)
    copy(rows[0], work.row)
    for t in range(drives.shape[1]):
        if status[0] == OK:
            _set_inputs(drives[:, t], 0, work)
            _advance_steps(constants_of(tables, 0), work, method, steps, work.row)
            status[0] = OK if in_bounds(work.row, 0) else DIVERGED
            if status[0] == OK:
                copy(work.row, rows[0])
                copy(work.outputs, out[0])
                _record_period(trail, 0, t, rows, out)
    if len(period) > 0:
        return finish_period(period, rows, out, status)
    return 0


@inner
def _record_period(trail, arm, t, rows, out):
    """Copy the row and outputs of an arm after period t to the trail, unless the trail is empty."""
    if trail[0].shape[1] > 0:
        copy(rows[arm], trail[0][arm, t])
        copy(out[arm], trail[1][arm, t])


@released
def run_steps(tables, method, drives, grid, steps, moved, status, counts):
    """Integrate arms by fixed steps, each under its own drive table.

    Args:
        tables: address tables of the arms, of a class of `arguments`, or constants and scratch arrays of a single arm.
            An arm and its derivatives with respect to one parameter each (TangentTables, AllTangentTables) count as
            ARMS_PER_GROUP arms, whose status is that of the first.
        method: result of `layout.step_method`.
        drives: (b, 7, n + 6) drive tables: rows as in `layout`, columns for n torques or accelerations of the motors, 3
            components of the tip force and 3 of the base acceleration.
        grid: `layout.StepGrid` of the rows.
        steps: first and end index of the steps; step -1 stands for a step 0 of length zero before the first one.
        moved: states and ledgers (b, 2 d + 2) at the first step, set to those at the end; rows (b, r, 2 d + 2) and
            outputs (b, r, OUTPUTS), overwritten.
        status: (b,) arms whose status is not OK are not integrated; set to DIVERGED or NOT_CONVERGED for failed arms.
        counts: (b, 2) set to the end index of the last successful step, and increased by the evaluations of the
            accelerations.
    """
    work = work_of(tables, 0)
    size = lane_count(work.row)
    for first in range(0, len(status), size):
        arms, constants = (first, min(first + size, len(status))), constants_of(tables, first // size)
        if _any_moving(status, arms[0], arms[1]):
            _run_group(constants, work, (method, drives, grid, steps), arms, moved, status, counts)


@inner
def _run_group(constants, work, given, arms, moved, status, counts):
    """Integrate a group of arms as in `run_steps`; given = (method, drives, grid, steps), arms = (first, end)."""
    (method, drives, grid, steps), (first, end), (states, rows, out) = given, arms, moved
    state, d = work.row, len(work.row) // 2 - 1
    _set_lanes(states, first, state)
    for i in range(len(work.drive_table)):
        _set_lanes(drives[:, i], first, work.drive_table[i])
    load_foundation(work, work.drive_table)
    for n in range(steps[0], steps[1]):
        if grid.substeps > 0:
            span = grid.time + max(n, 0) * grid.step, (grid.step if n >= 0 else 0.0)
            evaluations = fixed_step(constants, work, method, work.drive_table, span, state)
            _count_step(work.new_state, evaluations, n + 1, arms, status, counts)
            if not _any_moving(status, first, end):
                return
            copy(work.new_state, state)
        if grid.substeps == 0 or (n >= 0 and (n + 1) % grid.substeps == 0):
            evaluate_foundation(work, grid.time + (n + 1) * grid.step)
            set_outputs(constants, work, state[:d], state[d : 2 * d], work.outputs)
            r = grid.row if grid.substeps == 0 else grid.row + n // grid.substeps
            for arm in range(first, end):
                if status[arm] == OK:
                    _copy_lane(state, arm - first, rows[arm, r])
                    _copy_lane(work.outputs, arm - first, out[arm, r])
    for arm in range(first, end):
        if status[arm] == OK:
            _copy_lane(state, arm - first, states[arm])


@inner
def _count_step(state, evaluations, steps, arms, status, counts):
    """Set the status and counts of the arms that reach `state` by a step; a failed arm keeps its number of steps."""
    for arm in range(arms[0], arms[1]):
        if status[arm] == OK:
            counts[arm, 1] += abs(evaluations)
            if not in_bounds(state, arm - arms[0]):
                status[arm] = DIVERGED
            elif evaluations < 0:
                status[arm] = NOT_CONVERGED
            else:
                counts[arm, 0] = steps


@inner
def _set_lanes(values, first, flat):
    """Set the lanes of the groups flat (j,) to the rows of values (b, j), lane k to the row of the arm `first` + k."""
    for k in range(lane_count(flat)):
        arm = min(first + k, len(values) - 1)  # lanes without an arm repeat the last arm
        for j in range(len(flat)):
            insert_lane(flat, j, k, values[arm, j])


@inner
def _set_inputs(values, first, work):
    """Set the inputs, and the foundation row of a rotating base, to the rows of values as in `_set_lanes`."""
    count = len(work.motor_torque) + 6
    _set_lanes(values[:, :count], first, work.drive[:count])
    _set_lanes(values[:, count:], first, work.foundation)


@inner
def _copy_lane(flat, k, out):
    """Copy lane k of the groups of a flat array to out, for all entries of out."""
    for j in range(len(out)):
        out[j] = extract_lane(flat, j, k)


@released
def tip_accelerations(tables, drives, rows, out):
    """Compute the tip accelerations of arms, see `outputs.compute_tip_accelerations`.

    Args:
        tables: `arguments.SingleTables` or `arguments.ArmTables` of the arms.
        drives: (b, n + 6) inputs: n motor torques (N m), tip force (3, N) and base acceleration (3, m/s^2).
        rows: (b, 2 d + 2) states and ledgers, as in `advance_batch`.
        out: (b, TIP_ACCELERATIONS) m/s^2, overwritten.
    """
    work = work_of(tables, 0)
    state, size = work.row, lane_count(work.row)
    d = len(state) // 2 - 1
    for group in range(len(tables[0])):
        first = group * size
        _set_lanes(rows, first, state)
        _set_inputs(drives, first, work)
        evaluate_foundation_end(work)
        compute_tip_accelerations(constants_of(tables, group), work, state[:d], state[d : 2 * d], work.outputs)
        for arm in range(first, min(first + size, len(rows))):
            _copy_lane(work.outputs, arm - first, out[arm])


@inner
def _any_moving(status, first, end):
    """Return True if any arm with an index from `first` to `end` - 1 is still integrated: its status is OK."""
    for arm in range(first, end):
        if status[arm] == OK:
            return True
    return False

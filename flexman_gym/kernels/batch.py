"""Batch kernels: b arms of one model, each in a lane of the SIMD registers of the processor.

The kernels of an integration step are compiled for scratch arrays whose elements are groups of ARMS_PER_GROUP numbers,
one for each arm. No operation combines lanes, so the motion of an arm does not depend on the other arms, bit for bit.
Constants that may differ between arms (`arguments.PER_ARM`) are groups as well; all arms share the other constants. A
call passes tables of addresses instead of arrays, which saves microseconds.
"""

from flexman_gym.kernels.arguments import (
    all_constants_of_tangents,
    constants_of_arms,
    constants_of_one,
    constants_of_tangents,
    work_of_arms,
    work_of_one,
    work_of_tangents,
)
from flexman_gym.kernels.compile import inner, released
from flexman_gym.kernels.control_period import NOT_DONE, finish_period, start_period
from flexman_gym.kernels.implicit import fixed_newton_step
from flexman_gym.kernels.lanes import extract_lane, insert_lane
from flexman_gym.kernels.layout import ARMS_PER_GROUP, DIVERGED, LARGEST_STATE, OK
from flexman_gym.kernels.linalg import copy
from flexman_gym.kernels.outputs import compute_outputs, compute_tip_accelerations
from flexman_gym.kernels.runge_kutta import explicit_step, linearly_implicit_step, out_of_bounds, step_start


@inner
def _fixed_step(constants, work, tableau, counts, table, span, state):
    """Set work.new_state to the state and ledger after a step; span = (start time, step), s.

    The method is that of the tableau: linearly implicit, or explicit if counts[1] is not None. Without a tableau it is
    the method with the `counts` of `implicit.fixed_newton_step`. The ledger is work and dissipation since the start, J.
    """
    if tableau is None:
        fixed_newton_step(constants, work, counts, table, span, state)
    else:
        _tableau_step(constants, work, tableau, counts[1], table, span, state)


@inner
def _tableau_step(constants, work, tableau, explicit, table, span, state):
    """Call the step of a linearly implicit method, or that of an explicit one if `explicit` is not None."""
    if explicit is None:
        linearly_implicit_step(constants, work, tableau, table, span, state)
    else:
        explicit_step(constants, work, tableau, table, span, state, (0, len(tableau.b)))


@inner
def _advance_steps(constants, work, tableau, counts, steps, state):
    """Advance the state and ledger (2 d + 2,) under the inputs work.drive, and compute work.outputs.

    steps = (length in s, number). Tableau and counts as in `_fixed_step`.
    """
    d, (step, number) = len(state) // 2 - 1, steps
    for n in range(number):
        span = n * step, step
        _fixed_step(constants, work, tableau, counts, None, span, state)
        copy(work.new_state, state)
    compute_outputs(constants, work, state[:d], state[d : 2 * d], work.outputs)


@released
def advance_batch(tables, work_table, method, inputs, steps, rows, out, status, trail):
    """Integrate arms over T control periods of constant inputs.

    Args:
        tables: (groups, fields, 3) address table of the constants of each group of ARMS_PER_GROUP arms.
        work_table: (fields, 3) address table of the scratch arrays.
        method: tableau (or None) and counts, as in `_fixed_step`.
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
    work, drives = work_of_arms(work_table), inputs[0]
    state = work.row
    for group in range(len(tables)):
        first, end = group * ARMS_PER_GROUP, min((group + 1) * ARMS_PER_GROUP, len(rows))
        if _any_moving(status, first, end):
            _set_lanes(rows, first, state)
            for t in range(drives.shape[1]):
                _set_lanes(drives[:, t], first, work.drive)
                if len(inputs[1]) > 0:
                    motor = constants_of_arms(tables[group]).motor
                    _add_feedback(motor, inputs[1:], trail[0], (first, end, t), work.drive)
                _advance_steps(constants_of_arms(tables[group]), work, method[0], method[1], steps, state)
                for arm in range(first, end):
                    if status[arm] == OK and not _lane_in_bounds(state, arm - first):
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
        tables: (fields, 3) address tables of the constants of the arm, of the scratch arrays, and of the `Period` of an
            environment; the last table is empty without an environment.
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
    table, work_table, period = tables
    if len(period) > 0 and not start_period(period):
        return NOT_DONE
    work = work_of_one(work_table)
    copy(rows[0], work.row)
    for t in range(drives.shape[1]):
        if status[0] == OK:
            copy(drives[0, t], work.drive)
            _advance_steps(constants_of_one(table), work, method[0], method[1], steps, work.row)
            status[0] = DIVERGED if out_of_bounds(work.row) else OK
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
def run_batch(tables, work_table, tableau, newton, drives, grid, rows, out, counts):
    """Integrate arms by fixed steps, each under its own drive table.

    Args:
        tables: (groups, fields, 3) address table of the constants of each group of ARMS_PER_GROUP arms.
        work_table: (fields, 3) address table of the scratch arrays.
        tableau: tableau of a linearly implicit method, or None, see `_fixed_step`.
        newton: numbers of a method without a tableau, see `counts` of `_fixed_step`.
        drives: (b, 7, n + 6) drive tables: rows as in `layout`, columns for n torques or accelerations of the motors, 3
            components of the tip force and 3 of the base acceleration.
        grid: time grid of the rows.
        rows: (b, r + 1, 2 d + 2) states and ledgers, as in `advance_batch`; the first row is the start, all other rows
            are overwritten.
        out: (b, r + 1, OUTPUTS) output rows, overwritten.
        counts: (b, 2) number of valid rows after the first, and number of steps, overwritten; different from `counts`
            of the method.
    """
    work = work_of_arms(work_table)
    for group in range(len(tables)):
        constants, first = constants_of_arms(tables[group]), group * ARMS_PER_GROUP
        given = tableau, newton, drives, grid
        _run_group(constants, work, given, (first, min(first + ARMS_PER_GROUP, len(rows)), False), rows, out, counts)


@released
def run_tangents(tables, work_table, tableau, newton, drives, grid, rows, out, counts):
    """Integrate an arm and its derivatives by fixed steps; arguments as in `run_batch`, b = ARMS_PER_GROUP * groups.

    The constants and scratch arrays of each group are `lanes.TANGENTS`. Of ARMS_PER_GROUP successive drive tables, rows
    and output rows, the first is that of the arm, and the others are derivatives with respect to one parameter each.
    Only the arm is tested for divergence.
    """
    work = work_of_tangents(work_table)
    for group in range(len(tables)):
        constants, first = constants_of_tangents(tables[group]), group * ARMS_PER_GROUP
        given = tableau, newton, drives, grid
        _run_group(constants, work, given, (first, first + ARMS_PER_GROUP, True), rows, out, counts)


@released
def run_all_tangents(tables, work_table, tableau, newton, drives, grid, rows, out, counts):
    """Integrate an arm and its derivatives as `run_tangents`, with derivatives of all constants."""
    work = work_of_tangents(work_table)
    for group in range(len(tables)):
        constants, first = all_constants_of_tangents(tables[group]), group * ARMS_PER_GROUP
        given = tableau, newton, drives, grid
        _run_group(constants, work, given, (first, first + ARMS_PER_GROUP, True), rows, out, counts)


@inner
def _run_group(constants, work, given, arms, rows, out, counts):
    """Integrate a group of arms as in `run_batch`.

    given = (tableau, newton, drives, grid). arms = (first, end, tangents): indices of the arms, and True if the arms
    after the first are derivatives, which are valid as long as the first is.
    """
    (tableau, newton, drives, grid), (first, end, tangents) = given, arms
    _load_arms(work, drives, rows, first)
    for arm in range(first, end):
        counts[arm, 0], counts[arm, 1] = -1, 0
    for r in range(rows.shape[1]):
        for n in range(grid.substeps if r > 0 else 0):
            span = step_start(grid, r - 1, n), grid.step
            _fixed_step(constants, work, tableau, newton, work.drive_table, span, work.row)
            for arm in range(first, end):
                if counts[arm, 0] < 0:
                    counts[arm, 1] += 1
                    if not _lane_in_bounds(work.new_state, 0 if tangents else arm - first):
                        counts[arm, 0] = r - 1
            copy(work.new_state, work.row)
        d = len(work.row) // 2 - 1
        compute_outputs(constants, work, work.row[:d], work.row[d : 2 * d], work.outputs)
        for arm in range(first, end):
            if counts[arm, 0] < 0:
                _copy_lane(work.row, arm - first, rows[arm, r])
                _copy_lane(work.outputs, arm - first, out[arm, r])
    for arm in range(first, end):
        if counts[arm, 0] < 0:
            counts[arm, 0] = rows.shape[1] - 1


@inner
def _load_arms(work, drives, rows, first):
    """Set work.row and work.drive_table to the first rows and the drive tables of the group of arms from `first` on."""
    for k in range(ARMS_PER_GROUP):
        arm = min(first + k, len(rows) - 1)  # lanes without an arm repeat the last arm
        for j in range(len(work.row)):
            insert_lane(work.row, j, k, rows[arm, 0, j])
        for i in range(len(work.drive_table)):
            for j in range(len(work.drive)):
                insert_lane(work.drive_table[i], j, k, drives[arm, i, j])


@inner
def _set_lanes(values, first, flat):
    """Set the lanes of the groups flat (j,) to the rows of values (b, j), lane k to the row of the arm `first` + k."""
    for k in range(ARMS_PER_GROUP):
        arm = min(first + k, len(values) - 1)  # lanes without an arm repeat the last arm
        for j in range(len(flat)):
            insert_lane(flat, j, k, values[arm, j])


@inner
def _copy_lane(flat, k, out):
    """Copy lane k of the groups of a flat array to out, for all entries of out."""
    for j in range(len(out)):
        out[j] = extract_lane(flat, j, k)


@released
def tip_accelerations_batch(tables, work_table, drives, rows, out):
    """Compute the tip accelerations of arms, see `outputs.compute_tip_accelerations`.

    Args:
        tables: (groups, fields, 3) address table of the constants of each group of ARMS_PER_GROUP arms.
        work_table: (fields, 3) address table of the scratch arrays.
        drives: (b, n + 6) inputs: n motor torques (N m), tip force (3, N) and base acceleration (3, m/s^2).
        rows: (b, 2 d + 2) states and ledgers, as in `advance_batch`.
        out: (b, TIP_ACCELERATIONS) m/s^2, overwritten.
    """
    work = work_of_arms(work_table)
    state = work.row
    d = len(state) // 2 - 1
    for group in range(len(tables)):
        first = group * ARMS_PER_GROUP
        _set_lanes(rows, first, state)
        _set_lanes(drives, first, work.drive)
        compute_tip_accelerations(constants_of_arms(tables[group]), work, state[:d], state[d : 2 * d], work.outputs)
        for arm in range(first, min(first + ARMS_PER_GROUP, len(rows))):
            _copy_lane(work.outputs, arm - first, out[arm])


@released
def tip_accelerations_single(table, work_table, drives, rows, out):
    """Compute the tip accelerations of a single arm, with the address table (fields, 3) of its constants."""
    work = work_of_one(work_table)
    d = rows.shape[1] // 2 - 1
    copy(drives[0], work.drive)
    compute_tip_accelerations(constants_of_one(table), work, rows[0, :d], rows[0, d : 2 * d], out[0])


@inner
def _any_moving(status, first, end):
    """Return True if any arm with an index from `first` to `end` - 1 is still integrated: its status is OK."""
    for arm in range(first, end):
        if status[arm] == OK:
            return True
    return False


@inner
def _lane_in_bounds(state, k):
    """Return True if coordinates and speeds in lane k are finite and within LARGEST_STATE."""
    for j in range(len(state) - 2):
        if not abs(extract_lane(state, j, k)) <= LARGEST_STATE:
            return False
    return True

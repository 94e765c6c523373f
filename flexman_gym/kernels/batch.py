"""Batch kernels: arms of one model side by side, each in a lane of the processor's vector registers.

The same kernels integrate one arm or ARMS_PER_GROUP arms: here they are compiled for a work space with groups of
numbers as elements, one number for each arm. Lanes do not mix, so the motion of an arm does not depend, to the
last bit, on its neighbours. Constants that may differ between arms (`PER_ARM`) are groups too; all arms share the
rest. A call passes addresses instead of arrays, which saves microseconds.
"""

from flexman_gym.kernels.arguments import (
    constants_of_arms,
    constants_of_one,
    constants_of_sequences,
    work_of_arms,
    work_of_one,
    work_of_sequences,
)
from flexman_gym.kernels.compile import inner, kernel, released
from flexman_gym.kernels.implicit import fixed_newton_step
from flexman_gym.kernels.lanes import extract_lane, insert_lane
from flexman_gym.kernels.layout import ARMS_PER_GROUP, DIVERGED, LARGEST_STATE, OK
from flexman_gym.kernels.linalg import copy
from flexman_gym.kernels.outputs import compute_outputs, compute_tip_accelerations
from flexman_gym.kernels.runge_kutta import linearly_implicit_step, out_of_bounds, run_w_method, step_start


@inner
def advance_steps(constants, work, tableau, sweeps, steps, state):
    """Moves state and ledger, an array of work space, under work.drive by steps, their length (s) and number.

    By a linearly implicit method, or, without a tableau (None), by sweeps, see `fixed_newton_step`. Then fills
    work.outputs.
    """
    d, (step, count) = len(state) // 2 - 1, steps
    for n in range(count):
        moment = n * step, step
        if tableau is None:
            fixed_newton_step(constants, work, sweeps, None, moment, state)
        else:
            linearly_implicit_step(constants, work, tableau, None, moment, state)
        copy(work.trial, state)
    compute_outputs(constants, work, state[:d], state[d : 2 * d], work.outputs)


@released
def advance_batch(tables, work_table, method, drives, steps, rows, out, status, trail):
    """Moves arms by a method, a tableau or None with sweeps as in `advance_steps`, through periods of constant drives.

    `tables` (groups, fields, 3) are the addresses of the constants of each group of ARMS_ABREAST arms, drives are (b,
    T, n + 6). Overwrites rows (b, 2 d + 2) and outputs `out` (b, OUTPUTS) of the arms whose status (b,) is OK until one
    diverges; it is DIVERGED then. The trail has both after each good period, (b, T, ...), or no period at all.
    """
    work = work_of_arms(work_table)
    state = work.row
    for group in range(len(tables)):
        first, end = group * ARMS_PER_GROUP, min((group + 1) * ARMS_PER_GROUP, len(rows))
        if _any_moving(status, first, end):
            _fill_lanes(rows, first, state)
            for t in range(drives.shape[1]):
                _fill_lanes(drives[:, t], first, work.drive)
                advance_steps(constants_of_arms(tables[group]), work, method[0], method[1], steps, state)
                for arm in range(first, end):
                    if status[arm] == OK and not _lane_in_bounds(state, arm - first):
                        status[arm] = DIVERGED
                    if status[arm] == OK:
                        _read_lane(state, arm - first, rows[arm])
                        _read_lane(work.outputs, arm - first, out[arm])
                        _record_period(trail, arm, t, rows, out)


@released
def advance_single(table, work_table, method, drives, steps, rows, out, status, trail):
    """The same for a single arm."""
    work = work_of_one(work_table)
    copy(rows[0], work.row)
    for t in range(drives.shape[1]):
        if status[0] == OK:
            copy(drives[0, t], work.drive)
            advance_steps(constants_of_one(table), work, method[0], method[1], steps, work.row)
            status[0] = DIVERGED if out_of_bounds(work.row) else OK
            if status[0] == OK:
                copy(work.row, rows[0])
                copy(work.outputs, out[0])
                _record_period(trail, 0, t, rows, out)


@inner
def _record_period(trail, arm, t, rows, out):
    """Puts row and outputs of an arm after period t into a trail that has periods."""
    if trail[0].shape[1] > 0:
        copy(rows[arm], trail[0][arm, t])
        copy(out[arm], trail[1][arm, t])


@released
def run_batch(tables, work_table, tableau, sweeps, drives, clock, rows, out, counts):
    """Runs of arms by fixed steps as in `advance_steps`, each under the table of its own drive (b, 7, n + 6).

    Overwrites rows (b, r + 1, 2 d + 2) behind the first one, from which an arm starts, and outputs `out` (b, r + 1,
    OUTPUTS). counts (b, 2) = how many rows are valid behind the first, and the steps that were taken.
    """
    work = work_of_arms(work_table)
    for group in range(len(tables)):
        constants, first = constants_of_arms(tables[group]), group * ARMS_PER_GROUP
        end = min(first + ARMS_PER_GROUP, len(rows))
        _load_arms(work, drives, rows, first)
        for arm in range(first, end):
            counts[arm, 0], counts[arm, 1] = -1, 0
        for r in range(rows.shape[1]):
            for n in range(clock.substeps if r > 0 else 0):
                moment = step_start(clock, r - 1, n), clock.step
                if tableau is None:
                    fixed_newton_step(constants, work, sweeps, work.table, moment, work.row)
                else:
                    linearly_implicit_step(constants, work, tableau, work.table, moment, work.row)
                for arm in range(first, end):
                    if counts[arm, 0] < 0:
                        counts[arm, 1] += 1
                        if not _lane_in_bounds(work.trial, arm - first):
                            counts[arm, 0] = r - 1
                copy(work.trial, work.row)
            d = len(work.row) // 2 - 1
            compute_outputs(constants, work, work.row[:d], work.row[d : 2 * d], work.outputs)
            for arm in range(first, end):
                if counts[arm, 0] < 0:
                    _read_lane(work.row, arm - first, rows[arm, r])
                    _read_lane(work.outputs, arm - first, out[arm, r])
        for arm in range(first, end):
            if counts[arm, 0] < 0:
                counts[arm, 0] = rows.shape[1] - 1


@inner
def _load_arms(work, drives, rows, first):
    """work.row and work.table = the first rows and the drives of the arms from `first` on."""
    for k in range(ARMS_PER_GROUP):
        arm = min(first + k, len(rows) - 1)  # lanes without an arm repeat the last one
        for j in range(len(work.row)):
            insert_lane(work.row, j, k, rows[arm, 0, j])
        for i in range(len(work.table)):
            for j in range(len(work.drive)):
                insert_lane(work.table[i], j, k, drives[arm, i, j])


@kernel
def run_extrapolation(constants, work, lanes, tableau, table, clock, state, rows, outputs):
    """A run as in `linearly_implicit`, of one arm by an extrapolated method, with several sequences in the lanes.

    `lanes` are the addresses of the same constants, those of work space of sequences, and the rounds of
    `sequences_step`. The bits are those of one sequence after the other.
    """
    abreast = constants_of_sequences(lanes[0]), work_of_sequences(lanes[1]), lanes[2]
    return run_w_method(constants, work, abreast, tableau, table, clock, state, rows, outputs)


@inner
def _fill_lanes(values, first, flat):
    """The numbers (b, j) of the group of arms from `first` on into the lanes of flat (j,)."""
    for k in range(ARMS_PER_GROUP):
        arm = min(first + k, len(values) - 1)  # lanes without an arm repeat the last one
        for j in range(len(flat)):
            insert_lane(flat, j, k, values[arm, j])


@inner
def _read_lane(flat, k, out):
    """out = lane k of the first numbers of a flat array of arms abreast."""
    for j in range(len(out)):
        out[j] = extract_lane(flat, j, k)


@released
def tip_accelerations_batch(tables, work_table, drives, rows, out):
    """out (b, TIP_ACCELERATIONS) of arms with state and ledger in rows (b, 2 d + 2), under drives (b, n + 6).

    `tables` (groups, fields, 3) are the addresses of the constants of each group of ARMS_ABREAST arms.
    """
    work = work_of_arms(work_table)
    state = work.row
    d = len(state) // 2 - 1
    for group in range(len(tables)):
        first = group * ARMS_PER_GROUP
        _fill_lanes(rows, first, state)
        _fill_lanes(drives, first, work.drive)
        compute_tip_accelerations(constants_of_arms(tables[group]), work, state[:d], state[d : 2 * d], work.outputs)
        for arm in range(first, min(first + ARMS_PER_GROUP, len(rows))):
            _read_lane(work.outputs, arm - first, out[arm])


@released
def tip_accelerations_single(table, work_table, drives, rows, out):
    """The same for a single arm."""
    work = work_of_one(work_table)
    d = rows.shape[1] // 2 - 1
    copy(drives[0], work.drive)
    compute_tip_accelerations(constants_of_one(table), work, rows[0, :d], rows[0, d : 2 * d], out[0])


@inner
def _any_moving(status, first, end):
    """Whether an arm from `first` to `end` is to be moved."""
    for arm in range(first, end):
        if status[arm] == OK:
            return True
    return False


@inner
def _lane_in_bounds(state, k):
    """Whether the state in lane k is finite and within LARGEST_STATE; the ledger is not looked at."""
    for j in range(len(state) - 2):
        if not abs(extract_lane(state, j, k)) <= LARGEST_STATE:
            return False
    return True

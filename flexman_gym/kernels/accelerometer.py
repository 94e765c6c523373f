"""Tip acceleration and the specific force on an accelerometer at the tip, of one arm or of several abreast."""

from flexman_gym.kernels.arms import (
    constants_of_arms,
    constants_of_one,
    fill_lanes,
    read_lane,
    work_of_arms,
    work_of_one,
)
from flexman_gym.kernels.compile import inner, kernel, released
from flexman_gym.kernels.dynamics import factorise, solve
from flexman_gym.kernels.forces import applied_forces
from flexman_gym.kernels.kinematics import positions, tip_rotation, velocities
from flexman_gym.kernels.layout import ARMS_ABREAST
from flexman_gym.kernels.linalg import add, apply, apply_transposed, copy, load, load_matrix


@inner
def _sense(constants, work, x, v, out):
    """out = acceleration of the tip and the specific force on it, for coordinates and speeds (d,) under work.drive.

    The acceleration (m/s^2) is the second derivative of the tip's position: in the base frame and relative to the base,
    which the drive may accelerate too. The specific force (m/s^2) is that of an accelerometer: acceleration in inertial
    space less gravity, along the axes of the last link's tip. Overwrites the first four work space groups, work.rates
    and the first TIP_ACCELERATIONS numbers of out.
    """
    last = len(constants.mass) - 1
    positions(constants, work, x)
    velocities(constants, work, v)
    factorise(constants, work, (0.0, 0.0))
    applied_forces(constants, work, x, v)
    felt, _ = solve(constants, work, work.rates)
    linear = felt
    if constants.elastic_start[last + 1] > constants.elastic_start[last]:
        felt = apply_transposed(tip_rotation(work, last), felt)
    for i in range(last, -1, -1):
        linear = apply(load_matrix(work.rotation, i), linear)
    linear = add(linear, load(work.field, 0))
    out[0], out[1], out[2] = linear
    out[3], out[4], out[5] = felt


@kernel
def tip_accelerations(constants, work, x, v, drive, out):
    """out (TIP_ACCELERATIONS,) at coordinates x (d,), speeds v (d,) under a drive (n + 6,), see `_sense`."""
    copy(drive, work.drive)
    _sense(constants, work, x, v, out)


@released
def sense_arms(tables, work_table, drives, rows, out):
    """out (b, TIP_ACCELERATIONS) of arms with state and ledger in rows (b, 2 d + 2), under drives (b, n + 6).

    `tables` (groups, fields, 3) are the addresses of the constants of each group of ARMS_ABREAST arms.
    """
    work = work_of_arms(work_table)
    state = work.row
    d = len(state) // 2 - 1
    for group in range(len(tables)):
        first = group * ARMS_ABREAST
        fill_lanes(rows, first, state)
        fill_lanes(drives, first, work.drive)
        _sense(constants_of_arms(tables[group]), work, state[:d], state[d : 2 * d], work.outputs)
        for arm in range(first, min(first + ARMS_ABREAST, len(rows))):
            read_lane(work.outputs, arm - first, out[arm])


@released
def sense_one(table, work_table, drives, rows, out):
    """The same for a single arm."""
    work = work_of_one(work_table)
    d = rows.shape[1] // 2 - 1
    copy(drives[0], work.drive)
    _sense(constants_of_one(table), work, rows[0, :d], rows[0, d : 2 * d], out[0])

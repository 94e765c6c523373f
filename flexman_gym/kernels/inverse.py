"""Inverse dynamics M v' + h, with quadratic velocity and gravitational forces h(q, v), and static equilibrium."""

import math

from flexman_gym.kernels.arguments import constants_of, field, work_of
from flexman_gym.kernels.compile import inner, kernel
from flexman_gym.kernels.dynamics import link_tip_acceleration, payload_force
from flexman_gym.kernels.forces import has_knees, spring_slope, spring_torque
from flexman_gym.kernels.foundation import base_gravity, base_spin_rate
from flexman_gym.kernels.kinematics import compute_kinematics
from flexman_gym.kernels.lanes import extract_lane, insert_lane, is_zero
from flexman_gym.kernels.layout import ARMS_PER_GROUP
from flexman_gym.kernels.linalg import (
    ZERO,
    add,
    add_scaled,
    apply,
    apply_transposed,
    cross,
    dot,
    load,
    load_matrix,
    load_pair,
    store_pair,
)


@kernel
def inertial_forces(constants, work, x, v, acceleration, out):
    """Call `_inertial_forces` with arrays of Python."""
    _inertial_forces(constants, work, field(x), field(v), field(acceleration), field(out))


@inner
def _inertial_forces(constants, work, x, v, acceleration, out):
    """Set out (d,) to M v' + h at coordinates x (d,) and speeds v (d,) for accelerations v' (d,).

    Sets work.reaction (n + 1, 6) to force (N) and moment (N m) on each link at its origin, then on the payload.
    """
    compute_kinematics(constants, work, x, v)
    n = len(constants.mass)
    linear = add_scaled(ZERO, -1.0, base_gravity(constants, work))
    angular = base_spin_rate(constants, work)
    for i in range(n):
        c = load_matrix(work.rotation, i)
        linear = apply_transposed(c, linear)
        angular = add(apply_transposed(c, angular), load(work.joint_bias, i))
        angular = add_scaled(angular, acceleration[i], load(constants.axis, i))
        store_pair(work.frame_acceleration, i, linear, angular)
        linear, angular = link_tip_acceleration(constants, work, i, (linear, angular), acceleration)
    force, moment = payload_force(constants, work, (linear, angular))
    store_pair(work.reaction, n, force, moment)
    for i in range(n - 1, -1, -1):
        frame = load_pair(work.frame_acceleration, i)
        _elastic_forces(constants, work, i, frame, (force, moment), acceleration, out)
        force, moment = _link_force(constants, work, i, frame, (force, moment), acceleration)
        store_pair(work.reaction, i, force, moment)
        axis, m = load(constants.axis, i), constants.motor[i]
        rotor_torque, motor_inertia = _rotor_torque(constants, i, frame[1], acceleration), 0.0
        if is_zero(constants.carried_inertia[i]):
            motor_inertia = constants.rotor_inertia[i]
        out[i] = dot(axis, moment)
        if m >= 0:
            out[m] = motor_inertia * acceleration[m] + rotor_torque
        else:
            out[i] += motor_inertia * acceleration[i] + rotor_torque
        moment = add(add_scaled(moment, rotor_torque, axis), load(work.rotor_bias, i))
        c = load_matrix(work.rotation, i)
        force, moment = apply(c, force), apply(c, moment)


@kernel
def inertial_jacobian(tables, motion, out):
    """Set out (d + 3, 3 d) to the exact Jacobian of [M v' + h (d,), tip velocity (3,)], see `tangents`.

    Args:
        tables: `arguments.TangentTables` of constants with derivatives of zero and of scratch arrays.
        motion: (3, d) coordinates x, speeds v and accelerations v'; the columns of out are their entries in this order.
        out: (d + 3, 3 d), overwritten; the tip velocity is in the base frame, m/s.
    """
    constants, work = constants_of(tables, 0), work_of(tables, 0)
    d, directions = motion.shape[1], ARMS_PER_GROUP - 1
    result = work.stages[3]
    for first in range(0, 3 * d, directions):
        for j in range(d):
            work.stages[0, j], work.stages[1, j], work.stages[2, j] = motion[0, j], motion[1, j], motion[2, j]
        count = min(directions, 3 * d - first)
        for k in range(count):
            insert_lane(work.stages[(first + k) // d], (first + k) % d, 1 + k, 1.0)
        x, v, acceleration = work.stages[0, :d], work.stages[1, :d], work.stages[2, :d]
        _inertial_forces(constants, work, x, v, acceleration, result[:d])
        velocity = load(work.tip_velocity, 0)
        for i in range(len(constants.mass) - 1, -1, -1):
            velocity = apply(load_matrix(work.rotation, i), velocity)
        result[d], result[d + 1], result[d + 2] = velocity
        for row in range(d + 3):
            for k in range(count):
                out[row, first + k] = extract_lane(result, row, 1 + k)


@inner
def _rotor_torque(constants, i, angular, acceleration):
    """Return the torque (N m) on carried rotor i for the angular acceleration of link i and accelerations (d,) of x."""
    m = constants.motor[i]
    rate = acceleration[m] if m >= 0 else acceleration[i]
    return constants.carried_inertia[i] * (rate + dot(load(constants.axis, i), angular) - acceleration[i])


@inner
def _link_force(constants, work, i, frame, tip, acceleration):
    """Return force (N) and moment (N m) at the origin of link i for accelerations of its frame and tip loads `tip`."""
    elastic = len(acceleration) - len(constants.first_moment_shape)
    linear, angular = frame
    c = load(work.moment, i)
    force, moment = load_pair(work.bias, i)
    force = add(add_scaled(force, constants.mass[i], linear), add(cross(angular, c), tip[0]))
    moment = add(add(moment, cross(c, linear)), apply(load_matrix(work.inertia, i), angular))
    moment = add(moment, add(tip[1], cross(load(work.tip, i), tip[0])))
    for a in range(constants.elastic_start[i], constants.elastic_start[i + 1]):
        rate = acceleration[elastic + a]
        force = add_scaled(force, rate, load(work.moment_shape, a))
        moment = add_scaled(moment, rate, load(work.coupling, a))
    return force, moment


@inner
def _elastic_forces(constants, work, i, frame, tip, acceleration, out):
    """Set the entries of out for the elastic coordinates of link i; `tip` is force and moment at its tip."""
    start = constants.elastic_start[i]
    k = constants.elastic_start[i + 1] - start
    first = len(out) - len(constants.first_moment_shape) + start
    for a in range(k):
        row = constants.square_start[i] + a * k
        translation, rotation = load_pair(work.tip_shape, start + a)
        value = work.elastic_bias[start + a] + dot(translation, tip[0]) + dot(rotation, tip[1])
        value += dot(frame[0], load(work.moment_shape, start + a))
        value += dot(frame[1], load(work.coupling, start + a))
        for b in range(k):
            value += constants.elastic_mass[row + b] * acceleration[first + b]
        out[first + a] = value
    _add_axial_forces(constants, work, i, acceleration, first - start, out)


@inner
def _add_axial_forces(constants, work, i, rates, elastic, out):
    """Add to out (d,) the forces of axial station motion of link i for generalised accelerations `rates` (d,)."""
    start, first = elastic + constants.elastic_start[i], constants.station_start[i]
    k = constants.elastic_start[i + 1] - constants.elastic_start[i]
    for s in range(constants.station_start[i + 1] - first):
        row, force = constants.station_row[i] + s * constants.station_width[i], 0.0
        for a in range(k):
            force += constants.station_mass[first + s] * work.stretch[row + a] * rates[start + a]
        for a in range(k):
            out[start + a] += force * work.stretch[row + a]


EQUILIBRIUM_ITERATIONS, EQUILIBRIUM_TOLERANCE = 100, 1e-12  # largest number of iterations; relative change at the end
BISECTIONS = 64  # halvings of the interval of a twist, to rounding


@kernel
def linear_twists(constants, x):
    """Set joint angles in x (d,) so that linear springs of joint_stiffness have the torques of the springs with knees.

    The forces of all springs at the given coordinates are then the stiffness matrix times x.
    """
    _linear_twists(constants, field(x))


@inner
def _linear_twists(constants, x):
    """Do what `linear_twists` does."""
    for i in range(len(constants.mass)):
        m = constants.motor[i]
        if m >= 0 and has_knees(constants, i):
            x[i] = x[m] - spring_torque(constants, i, x[m] - x[i]) / constants.joint_stiffness[i]


@kernel
def spring_slopes(constants, x, out):
    """Set out (n,) to the tangent stiffness (N m/rad) of the joint springs at coordinates x (d,); 0 if rigid."""
    x = field(x)
    for i in range(len(constants.mass)):
        m = constants.motor[i]
        out[i] = spring_slope(constants, i, x[m] - x[i]) if m >= 0 else 0.0


@inner
def _knee_twists(constants, x):
    """Revert `linear_twists`; a torque of zero to rounding has the twist 0, in the middle of the backlash."""
    for i in range(len(constants.mass)):
        m = constants.motor[i]
        if m >= 0 and has_knees(constants, i):
            twist = x[m] - x[i]
            torque, low, high = constants.joint_stiffness[i] * abs(twist), 0.0, 2.0 * abs(twist)
            if abs(twist) < EQUILIBRIUM_TOLERANCE:
                torque, high = 0.0, 0.0
            while spring_torque(constants, i, high) < torque:
                high += high
            for _ in range(BISECTIONS):
                middle = 0.5 * (low + high)
                if spring_torque(constants, i, middle) < torque:
                    low = middle
                else:
                    high = middle
            x[i] = x[m] - math.copysign(high, twist)


@kernel
def solve_equilibrium(constants, work, stiffness, compliance, free, rest, x, force):
    """Solve for the static equilibrium of the arm under gravity, by a fixed-point iteration.

    Springs with knees are inverted in every iteration: the unknowns are the twists of `linear_twists`.

    Args:
        constants: constants of the model.
        work: scratch arrays of the kernels.
        stiffness: (d, d) stiffness matrix without gravity.
        compliance: (f, f) inverse of the stiffness matrix of the free coordinates.
        free: (f,) indices of the free coordinates; all other coordinates are constant.
        rest: (d,) zeros, for speeds and accelerations.
        x: (d,) coordinates; first guess, overwritten by the solution.
        force: (d,) residual forces, overwritten.

    Returns:
        The largest change in the last iteration, relative to the largest coordinate or to 1.
    """
    x, rest, force = field(x), field(rest), field(force)
    largest = 1.0
    for _ in range(EQUILIBRIUM_ITERATIONS):
        _inertial_forces(constants, work, x, rest, rest, force)
        _linear_twists(constants, x)
        for i in range(len(free)):
            for j in range(len(x)):
                force[free[i]] += stiffness[free[i], j] * x[j]
        largest, size = 0.0, 1.0
        for i in range(len(free)):
            change = 0.0
            for j in range(len(free)):
                change += compliance[i, j] * force[free[j]]
            x[free[i]] -= change
            largest = max(largest, abs(change))
        for j in range(len(x)):
            size = max(size, abs(x[j]))
        _knee_twists(constants, x)
        largest /= size
        if not largest > EQUILIBRIUM_TOLERANCE:
            break
    return largest

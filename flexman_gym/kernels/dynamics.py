"""Forward dynamics by the articulated-body algorithm: solves Eq. 40-46 of the paper (see `layout`) in O(n) operations.

From the tip to the base, the elastic coordinates and then the joint of each link are eliminated, which leaves an
articulated-body inertia (6, 6) at the tip of the inboard link (Featherstone's algorithm with elastic coordinates). With
a shift (g, h), g in s and h in s^2, the matrix of the linear system is M + g D + h K instead of M, with damping D and
stiffness K of links, joint springs and motor friction: an implicit step costs as much as an explicit one. The shift
(0, 0) gives the accelerations. An inertia is a triple of 3 x 3 blocks: force per linear acceleration, force per angular
acceleration, and moment per angular acceleration.

A rotor turns about its joint axis only (Eq. 23 of the paper), or, if its inertia J is carried, as a body in the frame
of the inboard link: with the angular velocity w of this frame, the joint axis a and the motor rate p, its kinetic
energy is J (a . w + p)^2 / 2, and its reaction acts on the frame. In `_eliminate_joint`, `total` is the
rotor inertia with the shifted spring and friction; its elimination leaves `joint` for the joint, `frame` for the
inertia of the frame about the axis, and `mixed` for their coupling.
"""

import math

from flexman_gym.kernels.arguments import field
from flexman_gym.kernels.compile import inner, kernel
from flexman_gym.kernels.forces import applied_forces, has_knees
from flexman_gym.kernels.foundation import base_spin, base_spin_rate
from flexman_gym.kernels.kinematics import compute_kinematics
from flexman_gym.kernels.lanes import (
    add_weighted_rows,
    fma,
    gather_lanes,
    group_size,
    is_zero,
    load_lanes,
    select_below,
    store_lanes,
)
from flexman_gym.kernels.linalg import (
    ZERO,
    add,
    add_matrix,
    add_scaled,
    apply,
    apply_transposed,
    copy,
    cross,
    dot,
    load,
    load_matrix,
    load_pair,
    product,
    store,
    store_matrix,
    store_pair,
    subtract_outer,
    transposed,
)


@inner
def _eliminate_joint(constants, work, i, shift, inertia):
    """Return the articulated-body inertia (6, 6) of link i and its outboard chain as seen across joint i.

    The joint is free, with rotor and spring, or has a prescribed motion. `shift` = (g, h), see the module; `inertia` is
    the articulated-body inertia for the locked joint, as three blocks.
    """
    force, mixed_block, moment = inertia
    axis, rotor, carried = load(constants.axis, i), constants.rotor_inertia[i], constants.carried_inertia[i]
    total = rotor + shift[0] * work.friction_slope[i]
    if constants.passive[i]:
        total += shift[1] * constants.passive_stiffness[i]
    spring, joint, mixed, frame = 0.0, total, carried, carried
    if constants.motor[i] >= 0:
        stiffness = work.spring_slope[i] if has_knees(constants, i) else constants.joint_stiffness[i]
        spring = shift[0] * constants.joint_damping[i] + shift[1] * stiffness
        if constants.prescribed[i]:
            joint, mixed = spring, 0.0
        else:
            joint = spring * total / (total + spring)
            total += spring
            mixed, frame = spring * carried / total, carried * (total - carried) / total
    work.spring[i], work.motor_inertia[i] = spring, total
    linear, angular = apply(mixed_block, axis), apply(moment, axis)
    pivot = joint + dot(axis, angular)
    angular = add_scaled(angular, mixed, axis)
    work.joint_pivot[i] = pivot
    store_pair(work.joint_column, i, linear, angular)
    if not is_zero(frame):
        moment = subtract_outer(moment, add_scaled(ZERO, -frame, axis), axis)
    if constants.prescribed[i] and constants.motor[i] < 0:
        return force, mixed_block, moment
    scaled, turned = add_scaled(ZERO, 1.0 / pivot, linear), add_scaled(ZERO, 1.0 / pivot, angular)
    force, mixed_block = subtract_outer(force, scaled, linear), subtract_outer(mixed_block, scaled, angular)
    return force, mixed_block, subtract_outer(moment, turned, angular)


@inner
def _joint_force(constants, work, i, total, bias):
    """Return force and moment transmitted by the free joint i if its inboard side has the acceleration `bias`.

    `total` is force (N) and moment (N m) on the outboard link for the locked joint and no acceleration. Sets
    work.joint_force[i].
    """
    axis, angular_bias = load(constants.axis, i), load(work.joint_bias, i)
    torque, acceleration, rotor_torque = work.force[i] - dot(axis, total[1]), work.drive[i], 0.0
    m = constants.motor[i]
    if m >= 0:
        rotor_acceleration = work.force[m] / work.motor_inertia[i]
        if constants.prescribed[i]:
            rotor_acceleration = acceleration
        torque += work.spring[i] * rotor_acceleration
        rotor_torque = constants.carried_inertia[i] * rotor_acceleration
    work.joint_force[i] = torque
    share = torque / work.joint_pivot[i]
    if m < 0 and constants.prescribed[i]:
        share = acceleration
    linear, angular = load_pair(work.joint_column, i)
    blocks, j = work.articulated, 3 * i
    inertia = load_matrix(blocks, j), load_matrix(blocks, j + 1), load_matrix(blocks, j + 2)
    if i == 0:
        bias = (ZERO, ZERO)  # the base has no velocity-product acceleration
    force, moment = _apply_inertia(inertia, (bias[0], add(bias[1], angular_bias)))
    moment = add(add_scaled(moment, rotor_torque, axis), load(work.rotor_bias, i))
    return add(add_scaled(total[0], share, linear), force), add(add_scaled(total[1], share, angular), moment)


@inner
def _joint_acceleration(constants, work, i, frame, out):
    """Return the acceleration of joint i for an acceleration of its frame; store joint and motor accelerations in out.

    Sets work.motor_torque[i] to the torque (N m) that produces a prescribed motion, exact for the shift (0, 0).
    """
    linear, angular = load_pair(work.joint_column, i)
    m, torque = constants.motor[i], work.joint_force[i] - dot(linear, frame[0]) - dot(angular, frame[1])
    value = torque / work.joint_pivot[i]
    if m < 0:
        if constants.prescribed[i]:
            value = work.drive[i]
            work.motor_torque[i] = work.joint_pivot[i] * value - torque
        out[i] = value
        return value
    out[i] = value
    carried = constants.carried_inertia[i] * dot(load(constants.axis, i), frame[1])
    if constants.prescribed[i]:
        out[m] = work.drive[i]
        reaction = work.spring[i] * (out[m] - value)
        work.motor_torque[i] = work.motor_inertia[i] * out[m] + carried - work.force[m] + reaction
    else:
        out[m] = (work.force[m] + work.spring[i] * value - carried) / work.motor_inertia[i]
    return value


@inner
def prescribed_power(constants, work, v):
    """Return the power (W) of motors with prescribed motion and of a rotating base, after `solve`, shift (0, 0).

    The base supplies the product of its angular velocity and the moment on the first link about the base origin.
    """
    power = 0.0
    if constants.rotating[0]:
        c, blocks = load_matrix(work.rotation, 0), work.articulated
        linear = apply_transposed(c, add_scaled(ZERO, -1.0, load(work.field, 0)))
        angular = apply_transposed(c, base_spin_rate(constants, work))
        inertia = load_matrix(blocks, 0), load_matrix(blocks, 1), load_matrix(blocks, 2)
        _, moment = _apply_inertia(inertia, (linear, angular))
        power = dot(base_spin(constants, work), add(load(work.base_moment, 0), apply(c, moment)))
    for i in range(len(constants.mass)):
        if constants.prescribed[i]:
            m = constants.motor[i]
            power += work.motor_torque[i] * v[m if m >= 0 else i]
    return power


@inner
def _eliminate_elastic(constants, work, i, shift, tip, inertia):
    """Return an inertia of link i and its outboard chain after elimination of the elastic coordinates of the link.

    Fills work.factor row by row: R of the factorisation R^T diag(R)^-1 R of the shifted elastic mass matrix, with
    inverted diagonal, then six columns of the coupling with the frame.
    """
    start, width, first = constants.elastic_start[i], constants.factor_width[i], constants.factor_start[i]
    k, factor = constants.elastic_start[i + 1] - start, work.factor
    force, mixed, moment = inertia
    _tip_coupling(constants, work, i, tip)
    for a in range(k):
        row = first + a * width
        _elastic_row(constants, work, i, a, shift)
        linear, angular = _frame_coupling(constants, work, i, a)
        for c in range(a):
            j, multiplier = first + c * width + k, work.row_sums[c]
            linear = add_scaled(linear, multiplier, (factor[j], factor[j + 1], factor[j + 2]))
            angular = add_scaled(angular, multiplier, (factor[j + 3], factor[j + 4], factor[j + 5]))
        # at extreme states M may not be positive definite: NaN ends the integration as diverged
        pivot = select_below(factor[row + a], 0.0, math.nan, 1.0 / factor[row + a])
        factor[row + a] = pivot
        # stored last, because the padding of the row overlaps these columns
        for j in range(3):
            factor[row + k + j], factor[row + k + 3 + j] = linear[j], angular[j]
        scaled, turned = add_scaled(ZERO, pivot, linear), add_scaled(ZERO, pivot, angular)
        force = subtract_outer(force, scaled, linear)
        mixed = subtract_outer(mixed, scaled, angular)
        moment = subtract_outer(moment, turned, angular)
    return force, mixed, moment


@inner
def _elastic_row(constants, work, i, a, shift):
    """Set row a of work.factor for link i to a row of the shifted elastic mass matrix minus multiples of rows above.

    Entries left of the diagonal are invalid. work.row_sums[c] is the multiplier of row c.
    """
    start, square, width = constants.elastic_start[i], constants.square_start[i], constants.factor_width[i]
    first, length, factor, carried = constants.factor_start[i], constants.station_width[i], work.factor, work.carried
    k, size = constants.elastic_start[i + 1] - start, group_size(factor)
    linear, angular = load_pair(work.tip_shape, start + a)
    for c in range(a):
        work.row_sums[c] = -factor[first + c * width + a] * factor[first + c * width + c]
    for group in range(a - a % size, k, size):
        j = square + a * k + group
        total = load_lanes(constants.elastic_mass, j)
        if constants.coupled[i] or group <= a:  # other entries of diagonal matrices are zero
            total = fma(shift[0], load_lanes(constants.damping, j), total)
            total = fma(shift[1], load_lanes(constants.stiffness, j), total)
        if start + a >= constants.tip_linear_start[i]:
            total = fma(linear[0], load_lanes(carried, group), total)
            total = fma(linear[1], load_lanes(carried, length + group), total)
            total = fma(linear[2], load_lanes(carried, 2 * length + group), total)
            total = fma(angular[0], load_lanes(carried, 3 * length + group), total)
            total = fma(angular[1], load_lanes(carried, 4 * length + group), total)
            total = fma(angular[2], load_lanes(carried, 5 * length + group), total)
        elif start + a >= constants.tip_start[i]:
            total = fma(linear[0], load_lanes(carried, group), total)
        if len(constants.station_mass) > 0:
            total = _add_axial_mass(constants, work, i, a, group, total)
        for c in range(a):
            total = fma(work.row_sums[c], load_lanes(factor, first + c * width + group), total)
        store_lanes(factor, first + a * width + group, total)


@inner
def _add_axial_mass(constants, work, i, a, group, total):
    """Return total + the mass matrix entries of axial station motion of link i for a group of row a."""
    first, width, stretch = constants.station_start[i], constants.station_width[i], work.stretch
    for s in range(0, constants.station_start[i + 1] - first, group_size(work.foreshortening)):
        j = constants.station_row[i] + s * width
        factors = load_lanes(constants.station_mass, first + s) * gather_lanes(stretch, j + a, width)
        total = add_weighted_rows(total, (factors,), (stretch,), j + group, width)
    return total


@inner
def _frame_coupling(constants, work, i, a):
    """Return force and moment on the fixed frame of link i for unit acceleration of its elastic coordinate a."""
    start, length, carried = constants.elastic_start[i], constants.station_width[i], work.carried
    force = moment = ZERO
    if start + a >= constants.tip_start[i]:
        force = carried[a], carried[length + a], carried[2 * length + a]
        moment = carried[3 * length + a], carried[4 * length + a], carried[5 * length + a]
    moment = add(add(moment, cross(load(work.tip, i), force)), load(work.coupling, start + a))
    return add(force, load(work.moment_shape, start + a)), moment


@inner
def _tip_coupling(constants, work, i, tip):
    """Set work.carried to the inertia `tip` outboard of link i times the tip motion per elastic coordinate."""
    start, length = constants.elastic_start[i], constants.station_width[i]
    carried = work.carried
    for a in range(constants.tip_start[i], constants.elastic_start[i + 1]):
        if a < constants.tip_linear_start[i]:
            along = (work.tip_shape[a, 0], 0.0, 0.0)
            force, moment = apply(tip[0], along), apply_transposed(tip[1], along)
        else:
            force, moment = _apply_inertia(tip, load_pair(work.tip_shape, a))
        for j in range(3):
            carried[j * length + a - start] = force[j]
            carried[(3 + j) * length + a - start] = moment[j]


@kernel
def accelerations(constants, work, x, v, drive, out):
    """Set out (d,) to the accelerations at coordinates x and speeds v (d,) for inputs `drive` (n + 6,) of `layout`."""
    x, v = field(x), field(v)
    copy(field(drive), work.drive)
    compute_kinematics(constants, work, x, v)
    factorise(constants, work, (0.0, 0.0))
    applied_forces(constants, work, x, v)
    solve(constants, work, field(out))


@inner
def factorise(constants, work, shift):
    """Eliminate elastic coordinates and joints from tip to base with a shift (g, h), after `compute_kinematics`.

    Overwrites the scratch arrays of the group `factorisation`.
    """
    tip = _payload_inertia(constants, work)
    for i in range(len(constants.mass) - 1, -1, -1):
        inertia = _eliminate_elastic(constants, work, i, shift, tip, _link_inertia(constants, work, i, tip))
        inertia = _eliminate_joint(constants, work, i, shift, inertia)
        for j in range(3):
            store_matrix(work.articulated, 3 * i + j, inertia[j])
        tip = _rotate_inertia(inertia, load_matrix(work.rotation, i))


@inner
def _product_skew(a, d):
    """Return the product of a matrix and the skew matrix of d: the cross products of its rows and d."""
    return (
        fma(a[1], d[2], -a[2] * d[1]), fma(a[2], d[0], -a[0] * d[2]), fma(a[0], d[1], -a[1] * d[0]),
        fma(a[4], d[2], -a[5] * d[1]), fma(a[5], d[0], -a[3] * d[2]), fma(a[3], d[1], -a[4] * d[0]),
        fma(a[7], d[2], -a[8] * d[1]), fma(a[8], d[0], -a[6] * d[2]), fma(a[6], d[1], -a[7] * d[0]),
    )  # fmt: skip


@inner
def _payload_inertia(constants, work):
    """Return the inertia of the payload about the tip of the last link."""
    m, c = constants.payload_mass[0], load(work.payload_moment, 0)
    mixed = (0.0, c[2], -c[1], -c[2], 0.0, c[0], c[1], -c[0], 0.0)
    return (m, 0.0, 0.0, 0.0, m, 0.0, 0.0, 0.0, m), mixed, load_matrix(work.payload_rotary, 0)


@inner
def _apply_inertia(inertia, acceleration):
    """Return force (N) and moment (N m) of an inertia for a linear and an angular acceleration."""
    linear, angular = acceleration
    force, mixed, moment = inertia
    return add(apply(force, linear), apply(mixed, angular)), add(
        apply_transposed(mixed, linear), apply(moment, angular)
    )


@inner
def _link_inertia(constants, work, i, tip):
    """Return the inertia of link i and of the inertia `tip` at its tip, with locked elastic coordinates and joint."""
    d, c, mass = load(work.tip, i), load(work.moment, i), constants.mass[i]
    force, mixed, moment = tip
    moment = add_matrix(moment, -1.0, _product_skew(transposed(mixed), d))
    mixed = add_matrix(mixed, -1.0, _product_skew(force, d))
    # the product of the skew matrix of d and mixed, as a transpose
    moment = add_matrix(moment, -1.0, transposed(_product_skew(transposed(mixed), d)))
    moment = add_matrix(moment, 1.0, load_matrix(work.inertia, i))
    force = add_matrix(force, mass, (1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0))
    mixed = add_matrix(mixed, 1.0, (0.0, c[2], -c[1], -c[2], 0.0, c[0], c[1], -c[0], 0.0))
    return force, mixed, moment


@inner
def _rotate_inertia(inertia, c):
    """Return an inertia in the inboard frame, given in the frame rotated by c."""
    back = transposed(c)
    force, mixed, moment = inertia
    return product(product(c, force), back), product(product(c, mixed), back), product(product(c, moment), back)


@inner
def solve(constants, work, out):
    """Set out (d,) to the accelerations under work.force and the quadratic velocity forces, after `factorise`.

    Overwrites the scratch arrays of the group `accelerations`.

    Returns:
        Linear acceleration minus gravity (m/s^2) and angular acceleration of the tip, in the frame of the last link.
    """
    n = len(constants.mass)
    elastic = len(out) - constants.elastic_start[n]
    force, moment = payload_force(constants, work, load_pair(work.tip_bias, n - 1))
    force = add_scaled(force, -1.0, load(work.tip_force, 0))
    for i in range(n - 1, -1, -1):
        c = load_matrix(work.rotation, i)
        force, moment = _link_bias_force(constants, work, i, elastic, (force, moment))
        linear, angular = load_pair(work.tip_bias, max(i - 1, 0))
        bias = (apply_transposed(c, linear), apply_transposed(c, angular))
        force, moment = _joint_force(constants, work, i, (force, moment), bias)
        force, moment = apply(c, force), apply(c, moment)
    store(work.base_moment, 0, moment)
    linear = add_scaled(ZERO, -1.0, load(work.field, 0))
    angular = base_spin_rate(constants, work)
    for i in range(n):
        c = load_matrix(work.rotation, i)
        linear = apply_transposed(c, linear)
        angular = add(apply_transposed(c, angular), load(work.joint_bias, i))
        rate = _joint_acceleration(constants, work, i, (linear, angular), out)
        angular = add_scaled(angular, rate, load(constants.axis, i))
        _elastic_accelerations(constants, work, i, (linear, angular), out)
        linear, angular = link_tip_acceleration(constants, work, i, (linear, angular), out)
    return linear, angular


@inner
def payload_force(constants, work, acceleration):
    """Return force and moment on the payload, at the tip, for an acceleration (linear, angular) of the tip."""
    force, moment = _apply_inertia(_payload_inertia(constants, work), acceleration)
    bias = load_pair(work.payload_bias, 0)
    return add(force, bias[0]), add(moment, bias[1])


@inner
def _link_bias_force(constants, work, i, elastic, tip):
    """Return force and moment on link i and its outboard chain for no acceleration of its frame.

    Elastic coordinates are free. `tip` is force and moment on the outboard chain at the tip; `elastic` is the index in
    x of the first elastic coordinate.
    """
    factor, load_vector = work.factor, work.elastic_force
    start, stop = constants.elastic_start[i], constants.elastic_start[i + 1]
    k = stop - start
    first, width = constants.factor_start[i], constants.factor_width[i]
    force, moment = load_pair(work.bias, i)
    force, moment = add(force, tip[0]), add(moment, add(tip[1], cross(load(work.tip, i), tip[0])))
    for a in range(start, stop):
        load_vector[a] = work.elastic_bias[a] - work.force[elastic + a]
    for a in range(constants.tip_start[i], constants.tip_linear_start[i]):
        load_vector[a] = fma(work.tip_shape[a, 0], tip[0][0], load_vector[a])
    for a in range(constants.tip_linear_start[i], stop):
        translation, rotation = load_pair(work.tip_shape, a)
        load_vector[a] += dot(translation, tip[0]) + dot(rotation, tip[1])
    for c in range(k):
        top = first + c * width
        value = load_vector[start + c] * factor[top + c]
        load_vector[start + c] = value
        for b in range(c + 1, k):
            load_vector[start + b] = fma(-value, factor[top + b], load_vector[start + b])
        j = top + k
        force = add_scaled(force, -value, (factor[j], factor[j + 1], factor[j + 2]))
        moment = add_scaled(moment, -value, (factor[j + 3], factor[j + 4], factor[j + 5]))
    return force, moment


@inner
def _elastic_accelerations(constants, work, i, frame, out):
    """Set out to the accelerations of the elastic coordinates of link i, by back substitution.

    `frame` is the acceleration of the frame of the link.
    """
    start, factor = constants.elastic_start[i], work.factor
    k = constants.elastic_start[i + 1] - start
    first = len(out) - len(constants.first_moment_shape) + start
    linear, angular = frame
    for c in range(k - 1, -1, -1):
        row = constants.factor_start[i] + c * constants.factor_width[i]
        j = row + k
        value = dot(linear, (factor[j], factor[j + 1], factor[j + 2]))
        value += dot(angular, (factor[j + 3], factor[j + 4], factor[j + 5]))
        for a in range(c + 1, k):
            value = fma(factor[row + a], out[first + a], value)
        out[first + c] = fma(-value, factor[row + c], -work.elastic_force[start + c])


@inner
def link_tip_acceleration(constants, work, i, frame, rates):
    """Return the acceleration of the tip of link i.

    `frame` is the acceleration of the frame of the link; `rates` (d,) are generalised accelerations.
    """
    elastic = len(rates) - len(constants.first_moment_shape)
    linear, angular = load_pair(work.tip_bias, i)
    linear = add(add(linear, frame[0]), cross(frame[1], load(work.tip, i)))
    angular = add(angular, frame[1])
    for a in range(constants.tip_start[i], constants.tip_linear_start[i]):
        linear = (linear[0] + work.tip_shape[a, 0] * rates[elastic + a], linear[1], linear[2])
    for a in range(constants.tip_linear_start[i], constants.elastic_start[i + 1]):
        translation, rotation = load_pair(work.tip_shape, a)
        rate = rates[elastic + a]
        linear, angular = add_scaled(linear, rate, translation), add_scaled(angular, rate, rotation)
    return linear, angular

"""Dynamics of the chain: a recursion that is equal to Eq. 40-46 and costs the same for every link.

Going inward, each link's elastic coordinates and then its joint are eliminated, so that the link before it sees one six by
six inertia (the articulated-body algorithm of Featherstone with elastic coordinates). With a shift g > 0 the eliminated
blocks are M + g damping + g^2 K instead of M, with the damping and stiffness of links and joint springs: that solves the
linear system of a linearly implicit step at the cost of an explicit one. g = 0 gives accelerations.
"""

import math

from flexman_gym.kernels.kinematics import positions, velocities
from flexman_gym.kernels.linalg import (
    cross,
    inner,
    kernel,
    load,
    load_linear_angular,
    rotate,
    rotate_back,
    rotate_inertia,
)


@kernel
def accelerations(constants, work, x, v, torque, out):
    """out (d,) = generalised accelerations at coordinates x (d,), speeds v (d,) under motor torques (n,) in N m."""
    positions(constants, work, x)
    velocities(constants, work, x, v)
    factorise(constants, work, 0.0)
    applied_forces(constants, work, x, v, torque)
    solve(constants, work, out)


@kernel
def applied_forces(constants, work, x, v, torque):
    """work.force (d,) = motor torques, springs and dampers of joints (Eq. 23) and links (Eq. 18); returns two powers.

    Those are the power of the motors at the speeds v and the power lost in the dampers (W).
    """
    n = len(constants.mass)
    elastic = len(x) - constants.elastic_start[n]
    supplied = 0.0
    lost = 0.0
    for i in range(n):
        m = constants.motor[i]
        if m < 0:
            work.force[i] = torque[i]
            supplied += torque[i] * v[i]
            continue
        slip = v[m] - v[i]
        reaction = constants.joint_stiffness[i] * (x[m] - x[i]) + constants.joint_damping[i] * slip
        work.force[i] = reaction
        work.force[m] = torque[i] - reaction
        supplied += torque[i] * v[m]
        lost += constants.joint_damping[i] * slip * slip
    for i in range(n):
        start = constants.elastic_start[i]
        k = constants.elastic_start[i + 1] - start
        square = constants.square_start[i]
        for a in range(k):
            restoring = 0.0
            drag = 0.0
            for b in range(k):
                restoring += constants.stiffness[square + a * k + b] * x[elastic + start + b]
                drag += constants.damping[square + a * k + b] * v[elastic + start + b]
            work.force[elastic + start + a] = -restoring - drag
            lost += drag * v[elastic + start + a]
    return supplied, lost


@kernel
def factorise(constants, work, g):
    """Eliminates elastic coordinates and joints from tip to base, with the shift g (s). Needs `positions`.

    Overwrites the work space group `factorisation`.
    """
    n = len(constants.mass)
    inertia = work.tip_inertia
    for j in range(6):
        for k in range(6):
            inertia[j, k] = 0.0
    for j in range(3):
        inertia[j, j] = constants.payload_mass[0]
    for i in range(n - 1, -1, -1):
        link_inertia(constants, work, i)
        eliminate_elastic(constants, work, i, g)
        eliminate_joint(constants, work, i, g)
        if i > 0:
            rotate_inertia(work.articulated, i, work.rotation, inertia)


@inner
def link_inertia(constants, work, i):
    """articulated[i] = inertia of link i and of what its tip carries, elastic coordinates and joint locked."""
    articulated = work.articulated
    tip = work.tip_inertia
    mass = constants.mass[i]
    c0, c1, c2 = load(work.moment, i)
    d0, d1, d2 = load(work.tip, i)
    # coupling of force and angular acceleration: tip block minus its product with the skew matrix of the tip position
    for j in range(3):
        h0 = tip[j, 3] - (tip[j, 1] * d2 - tip[j, 2] * d1)
        h1 = tip[j, 4] - (tip[j, 2] * d0 - tip[j, 0] * d2)
        h2 = tip[j, 5] - (tip[j, 0] * d1 - tip[j, 1] * d0)
        articulated[i, j, 3], articulated[i, j, 4], articulated[i, j, 5] = h0, h1, h2
        for k in range(3):
            articulated[i, j, k] = tip[j, k]
    for j in range(3):
        e0, e1, e2 = tip[3 + j, 0], tip[3 + j, 1], tip[3 + j, 2]
        articulated[i, 3 + j, 3] = work.inertia[i, j, 0] + tip[3 + j, 3] - (e1 * d2 - e2 * d1)
        articulated[i, 3 + j, 4] = work.inertia[i, j, 1] + tip[3 + j, 4] - (e2 * d0 - e0 * d2)
        articulated[i, 3 + j, 5] = work.inertia[i, j, 2] + tip[3 + j, 5] - (e0 * d1 - e1 * d0)
    for j in range(3):
        h0, h1, h2 = articulated[i, 0, 3 + j], articulated[i, 1, 3 + j], articulated[i, 2, 3 + j]
        articulated[i, 3, 3 + j] += d1 * h2 - d2 * h1
        articulated[i, 4, 3 + j] += d2 * h0 - d0 * h2
        articulated[i, 5, 3 + j] += d0 * h1 - d1 * h0
        articulated[i, j, j] += mass
    articulated[i, 0, 4] += c2
    articulated[i, 0, 5] -= c1
    articulated[i, 1, 3] -= c2
    articulated[i, 1, 5] += c0
    articulated[i, 2, 3] += c1
    articulated[i, 2, 4] -= c0
    for j in range(3):
        for k in range(3):
            articulated[i, 3 + k, j] = articulated[i, j, 3 + k]


@inner
def eliminate_elastic(constants, work, i, g):
    """Removes the elastic coordinates of link i from articulated[i] by a Cholesky factorisation in place."""
    start = constants.elastic_start[i]
    k = constants.elastic_start[i + 1] - start
    if k == 0:
        return
    elastic_block(constants, work, i, g)
    factor, row, square = work.elastic_factor, work.elastic_row, constants.square_start[i]
    for c in range(k):
        pivot = 1.0 / math.sqrt(factor[square + c * k + c])
        factor[square + c * k + c] = pivot
        for a in range(c + 1, k):
            factor[square + c * k + a] *= pivot
        for j in range(6):
            row[start + c, j] *= pivot
        for b in range(c + 1, k):
            value = factor[square + c * k + b]
            for a in range(b, k):
                factor[square + b * k + a] -= value * factor[square + c * k + a]
            for j in range(6):
                row[start + b, j] -= value * row[start + c, j]
    for a in range(start, start + k):
        for j in range(6):
            value = row[a, j]
            for m in range(6):
                work.articulated[i, j, m] -= value * row[a, m]


@inner
def elastic_block(constants, work, i, g):
    """elastic_factor = M + g damping + g^2 K of link i with what its tip carries (upper half); elastic_row = coupling."""
    start = constants.elastic_start[i]
    k = constants.elastic_start[i + 1] - start
    square = constants.square_start[i]
    shape, carried, tip = work.tip_shape, work.carried, work.tip_inertia
    d = load(work.tip, i)
    for a in range(start, start + k):
        for j in range(6):
            carried[a, j] = (
                tip[j, 0] * shape[a, 0] + tip[j, 1] * shape[a, 1] + tip[j, 2] * shape[a, 2]
                + tip[j, 3] * shape[a, 3] + tip[j, 4] * shape[a, 4] + tip[j, 5] * shape[a, 5]
            )  # fmt: skip
        force, moment = load_linear_angular(carried, a)
        lever = cross(d, force)
        for j in range(3):
            work.elastic_row[a, j] = constants.first_moment_shape[a, j] + force[j]
            work.elastic_row[a, 3 + j] = work.coupling[a, j] + moment[j] + lever[j]
    for a in range(k):
        p, q = load_linear_angular(shape, start + a)
        for b in range(a, k):
            j = square + a * k + b
            f, m = load_linear_angular(carried, start + b)
            work.elastic_factor[j] = (
                constants.elastic_mass[j] + g * (constants.damping[j] + g * constants.stiffness[j])
                + p[0] * f[0] + p[1] * f[1] + p[2] * f[2] + q[0] * m[0] + q[1] * m[1] + q[2] * m[2]
            )  # fmt: skip


@inner
def eliminate_joint(constants, work, i, g):
    """Frees joint i, with its rotor and spring, in articulated[i]."""
    articulated, column = work.articulated, work.joint_column
    s0, s1, s2 = load(constants.axis, i)
    for j in range(6):
        column[i, j] = articulated[i, j, 3] * s0 + articulated[i, j, 4] * s1 + articulated[i, j, 5] * s2
    pivot = column[i, 3] * s0 + column[i, 4] * s1 + column[i, 5] * s2
    rotor = constants.rotor_inertia[i]
    spring = 0.0
    if constants.motor[i] < 0:
        pivot += rotor
    else:
        spring = g * (constants.joint_damping[i] + g * constants.joint_stiffness[i])
        pivot += spring * rotor / (rotor + spring)
    work.spring[i] = spring
    work.joint_pivot[i] = pivot
    for j in range(6):
        value = column[i, j] / pivot
        for k in range(6):
            articulated[i, j, k] -= value * column[i, k]


@kernel
def solve(constants, work, out):
    """out (d,) = accelerations under work.force and the quadratic velocity forces. Needs the other three groups.

    Overwrites the work space group `forces and accelerations`, except force.
    """
    n = len(constants.mass)
    elastic = len(out) - constants.elastic_start[n]
    force = work.tip_force
    for j in range(6):
        force[j] = 0.0
    for j in range(3):
        force[j] = constants.payload_mass[0] * work.tip_bias[n - 1, j]
    for i in range(n - 1, -1, -1):
        gather_forces(constants, work, i, elastic)
        free_joint(constants, work, i)
        if i > 0:
            linear, angular = load_linear_angular(work.articulated_force, i)
            linear, angular = rotate(work.rotation, i, linear), rotate(work.rotation, i, angular)
            for j in range(3):
                force[j], force[3 + j] = linear[j], angular[j]
            # what the bias acceleration of the tip before this joint costs
            bring_bias(work, i)
    base_acceleration(constants, work)
    for i in range(n):
        carry_acceleration(constants, work, i, out)
        elastic_accelerations(constants, work, i, elastic, out)
        tip_acceleration(constants, work, i, out, elastic)


@inner
def bring_bias(work, i):
    """Adds articulated inertia of link i times the tip bias of link i - 1 to tip_force."""
    linear, angular = load_linear_angular(work.tip_bias, i - 1)
    a, b = rotate_back(work.rotation, i, linear), rotate_back(work.rotation, i, angular)
    inertia = work.articulated
    f0 = f1 = f2 = m0 = m1 = m2 = 0.0
    for j in range(3):
        f0 += inertia[i, 0, j] * a[j] + inertia[i, 0, 3 + j] * b[j]
        f1 += inertia[i, 1, j] * a[j] + inertia[i, 1, 3 + j] * b[j]
        f2 += inertia[i, 2, j] * a[j] + inertia[i, 2, 3 + j] * b[j]
        m0 += inertia[i, 3, j] * a[j] + inertia[i, 3, 3 + j] * b[j]
        m1 += inertia[i, 4, j] * a[j] + inertia[i, 4, 3 + j] * b[j]
        m2 += inertia[i, 5, j] * a[j] + inertia[i, 5, 3 + j] * b[j]
    linear, angular = rotate(work.rotation, i, (f0, f1, f2)), rotate(work.rotation, i, (m0, m1, m2))
    for j in range(3):
        work.tip_force[j] += linear[j]
        work.tip_force[3 + j] += angular[j]


@inner
def gather_forces(constants, work, i, elastic):
    """articulated_force[i] = force that link i needs without acceleration, elastic coordinates free."""
    force, total, k = work.tip_force, work.articulated_force, constants.elastic_start[i + 1] - constants.elastic_start[i]
    start, square = constants.elastic_start[i], constants.square_start[i]
    lever = cross(load(work.tip, i), (force[0], force[1], force[2]))
    for j in range(3):
        total[i, j] = work.bias[i, j] + force[j]
        total[i, 3 + j] = work.bias[i, 3 + j] + force[3 + j] + lever[j]
    demand = work.elastic_force
    for a in range(start, start + k):
        value = work.elastic_bias[a] - work.force[elastic + a]
        for j in range(6):
            value += work.tip_shape[a, j] * force[j]
        demand[a] = value
    for c in range(k):
        value = demand[start + c] * work.elastic_factor[square + c * k + c]
        demand[start + c] = value
        for b in range(c + 1, k):
            demand[start + b] -= value * work.elastic_factor[square + c * k + b]
        for j in range(6):
            total[i, j] -= value * work.elastic_row[start + c, j]


@inner
def free_joint(constants, work, i):
    """joint_force[i] = torque left to accelerate joint i; articulated_force[i] then has the joint free."""
    total, column, inertia = work.articulated_force, work.joint_column, work.articulated
    s, bias = load(constants.axis, i), load(work.joint_bias, i)
    torque = work.force[i]
    m = constants.motor[i]
    if m >= 0:
        torque += work.spring[i] / (constants.rotor_inertia[i] + work.spring[i]) * work.force[m]
    torque -= s[0] * total[i, 3] + s[1] * total[i, 4] + s[2] * total[i, 5]
    work.joint_force[i] = torque
    share = torque / work.joint_pivot[i]
    for j in range(6):
        total[i, j] += (
            share * column[i, j] + inertia[i, j, 3] * bias[0] + inertia[i, j, 4] * bias[1] + inertia[i, j, 5] * bias[2]
        )


@inner
def base_acceleration(constants, work):
    """tip_acceleration = that of the base: gravity as an upward acceleration."""
    for j in range(3):
        work.tip_acceleration[j] = -constants.gravity[j]
        work.tip_acceleration[3 + j] = 0.0


@inner
def arrive(constants, work, i):
    """acceleration[i] = tip_acceleration in the frame of link i with the joint's bias, before the joint accelerates."""
    carried = work.tip_acceleration
    linear = rotate_back(work.rotation, i, (carried[0], carried[1], carried[2]))
    angular = rotate_back(work.rotation, i, (carried[3], carried[4], carried[5]))
    for j in range(3):
        work.acceleration[i, j] = linear[j]
        work.acceleration[i, 3 + j] = angular[j] + work.joint_bias[i, j]


@inner
def carry_acceleration(constants, work, i, out):
    """Acceleration of joint i and of its motor, and of the frame of link i."""
    arrive(constants, work, i)
    value = work.joint_force[i]
    for j in range(6):
        value -= work.joint_column[i, j] * work.acceleration[i, j]
    value /= work.joint_pivot[i]
    out[i] = value
    for j in range(3):
        work.acceleration[i, 3 + j] += value * constants.axis[i, j]
    m = constants.motor[i]
    if m >= 0:
        out[m] = (work.force[m] + work.spring[i] * value) / (constants.rotor_inertia[i] + work.spring[i])


@inner
def elastic_accelerations(constants, work, i, elastic, out):
    """Back substitution for the elastic coordinates of link i."""
    start, square = constants.elastic_start[i], constants.square_start[i]
    k = constants.elastic_start[i + 1] - start
    for c in range(k - 1, -1, -1):
        value = -work.elastic_force[start + c]
        for j in range(6):
            value -= work.elastic_row[start + c, j] * work.acceleration[i, j]
        for a in range(c + 1, k):
            value -= work.elastic_factor[square + c * k + a] * out[elastic + start + a]
        out[elastic + start + c] = value * work.elastic_factor[square + c * k + c]


@inner
def tip_acceleration(constants, work, i, rates, elastic):
    """tip_acceleration of link i from its frame's acceleration and its elastic accelerations in `rates` (d,)."""
    linear, angular = load_linear_angular(work.acceleration, i)
    turned = cross(angular, load(work.tip, i))
    for j in range(3):
        work.tip_acceleration[j] = linear[j] + turned[j] + work.tip_bias[i, j]
        work.tip_acceleration[3 + j] = angular[j] + work.tip_bias[i, 3 + j]
    for a in range(constants.elastic_start[i], constants.elastic_start[i + 1]):
        for j in range(6):
            work.tip_acceleration[j] += rates[elastic + a] * work.tip_shape[a, j]

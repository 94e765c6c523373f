"""Dynamics of the chain: a recursion that is equal to Eq. 40-46 and costs the same for every link.

Going inward, each link's elastic coordinates and then its joint are eliminated, so that the link before it sees one six
by six inertia (the articulated-body algorithm of Featherstone with elastic coordinates). With a shift (g, h) the
eliminated blocks are M + g damping + h K instead of M, with the damping and stiffness of links and joint springs: that
solves the linear system of an implicit step at the cost of an explicit one. No shift gives accelerations.

An inertia is a triple: force by linear, force by angular and moment by angular acceleration.
"""

from flexman_gym.kernels.compile import inner, kernel
from flexman_gym.kernels.elastic import eliminate_elastic
from flexman_gym.kernels.forces import applied_forces
from flexman_gym.kernels.joints import eliminate_joint, free_joint, joint_acceleration, prescribed_power
from flexman_gym.kernels.kinematics import positions, velocities
from flexman_gym.kernels.lanes import fused
from flexman_gym.kernels.linalg import (
    ZERO,
    add,
    add_matrix,
    add_scaled,
    apply,
    apply_back,
    apply_inertia,
    copy,
    cross,
    dot,
    load,
    load_matrix,
    load_pair,
    product,
    product_skew,
    store_matrix,
    transposed,
)


@kernel
def accelerations(constants, work, x, v, drive, out):
    """out (d,) = generalised accelerations at coordinates x (d,), speeds v (d,) under a drive (n + 6,)."""
    copy(drive, work.drive)
    accelerate(constants, work, x, v, out)


@inner
def accelerate(constants, work, x, v, out):
    """out (d,) = generalised accelerations under work.drive; returns the power supplied and the power lost (W)."""
    positions(constants, work, x)
    velocities(constants, work, v)
    factorise(constants, work, (0.0, 0.0))
    supplied, lost = applied_forces(constants, work, x, v)
    solve(constants, work, out)
    return supplied + prescribed_power(constants, work, v), lost


@inner
def factorise(constants, work, shift):
    """Eliminates elastic coordinates and joints from tip to base, with the shift (s, s^2). Needs `positions`.

    Overwrites the work space group `factorisation`.
    """
    tip = payload_inertia(constants, work)
    for i in range(len(constants.mass) - 1, -1, -1):
        inertia = eliminate_elastic(constants, work, i, shift, tip, link_inertia(constants, work, i, tip))
        inertia = eliminate_joint(constants, work, i, shift, inertia)
        for j in range(3):
            store_matrix(work.articulated, 3 * i + j, inertia[j])
        tip = rotate_inertia(inertia, load_matrix(work.rotation, i))


@inner
def payload_inertia(constants, work):
    """Inertia of the payload about the tip of the last link."""
    m, c = constants.payload_mass[0], load(work.payload_moment, 0)
    mixed = (0.0, c[2], -c[1], -c[2], 0.0, c[0], c[1], -c[0], 0.0)
    return (m, 0.0, 0.0, 0.0, m, 0.0, 0.0, 0.0, m), mixed, load_matrix(work.payload_rotary, 0)


@inner
def link_inertia(constants, work, i, tip):
    """Inertia of link i and of what its tip carries, elastic coordinates and joint locked."""
    d, c, mass = load(work.tip, i), load(work.moment, i), constants.mass[i]
    force, mixed, moment = tip
    moment = add_matrix(moment, -1.0, product_skew(transposed(mixed), d))
    mixed = add_matrix(mixed, -1.0, product_skew(force, d))
    # the skew matrix of d times mixed, as the transpose of mixed^T times its transpose
    moment = add_matrix(moment, -1.0, transposed(product_skew(transposed(mixed), d)))
    moment = add_matrix(moment, 1.0, load_matrix(work.inertia, i))
    force = add_matrix(force, mass, (1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0))
    mixed = add_matrix(mixed, 1.0, (0.0, c[2], -c[1], -c[2], 0.0, c[0], c[1], -c[0], 0.0))
    return force, mixed, moment


@inner
def rotate_inertia(inertia, c):
    """An inertia in the frame before the rotation c."""
    back = transposed(c)
    force, mixed, moment = inertia
    return product(product(c, force), back), product(product(c, mixed), back), product(product(c, moment), back)


@inner
def solve(constants, work, out):
    """out (d,) = accelerations under work.force and the quadratic velocity forces. Needs the other three groups.

    Overwrites the work space group `accelerations`; returns the linear and angular acceleration of the tip in the frame
    of the last link, less gravity.
    """
    n = len(constants.mass)
    elastic = len(out) - constants.elastic_start[n]
    force, moment = payload_force(constants, work, load_pair(work.tip_bias, n - 1))
    force = add_scaled(force, -1.0, load(work.tip_force, 0))
    for i in range(n - 1, -1, -1):
        c = load_matrix(work.rotation, i)
        force, moment = gather_forces(constants, work, i, elastic, (force, moment))
        linear, angular = load_pair(work.tip_bias, max(i - 1, 0))
        bias = (apply_back(c, linear), apply_back(c, angular))
        force, moment = free_joint(constants, work, i, (force, moment), bias)
        force, moment = apply(c, force), apply(c, moment)
    linear = add_scaled(ZERO, -1.0, load(work.field, 0))
    angular = ZERO
    for i in range(n):
        c = load_matrix(work.rotation, i)
        linear = apply_back(c, linear)
        angular = add(apply_back(c, angular), load(work.joint_bias, i))
        rate = joint_acceleration(constants, work, i, (linear, angular), out)
        angular = add_scaled(angular, rate, load(constants.axis, i))
        elastic_accelerations(constants, work, i, (linear, angular), out)
        linear, angular = tip_acceleration(constants, work, i, (linear, angular), out)
    return linear, angular


@inner
def payload_force(constants, work, acceleration):
    """Force and moment at the tip that the payload needs for an acceleration of the tip."""
    force, moment = apply_inertia(payload_inertia(constants, work), acceleration)
    bias = load_pair(work.payload_bias, 0)
    return add(force, bias[0]), add(moment, bias[1])


@inner
def gather_forces(constants, work, i, elastic, tip):
    """Force and moment that link i needs without acceleration, elastic coordinates free, with those at its tip."""
    factor, demand = work.factor, work.elastic_force
    start, stop = constants.elastic_start[i], constants.elastic_start[i + 1]
    k = stop - start
    first, width = constants.factor_start[i], constants.factor_width[i]
    force, moment = load_pair(work.bias, i)
    force, moment = add(force, tip[0]), add(moment, add(tip[1], cross(load(work.tip, i), tip[0])))
    for a in range(start, stop):
        demand[a] = work.elastic_bias[a] - work.force[elastic + a]
    for a in range(constants.carrying[i], constants.turning[i]):
        demand[a] = fused(work.tip_shape[a, 0], tip[0][0], demand[a])
    for a in range(constants.turning[i], stop):
        translation, rotation = load_pair(work.tip_shape, a)
        demand[a] += dot(translation, tip[0]) + dot(rotation, tip[1])
    for c in range(k):
        top = first + c * width
        value = demand[start + c] * factor[top + c]
        demand[start + c] = value
        for b in range(c + 1, k):
            demand[start + b] = fused(-value, factor[top + b], demand[start + b])
        j = top + k
        force = add_scaled(force, -value, (factor[j], factor[j + 1], factor[j + 2]))
        moment = add_scaled(moment, -value, (factor[j + 3], factor[j + 4], factor[j + 5]))
    return force, moment


@inner
def elastic_accelerations(constants, work, i, frame, out):
    """Back substitution for the elastic coordinates of link i, for the acceleration of its frame."""
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
            value = fused(factor[row + a], out[first + a], value)
        out[first + c] = fused(-value, factor[row + c], -work.elastic_force[start + c])


@inner
def tip_acceleration(constants, work, i, frame, rates):
    """Acceleration of the tip of link i for that of its frame and the accelerations `rates` (d,)."""
    elastic = len(rates) - len(constants.first_moment_shape)
    linear, angular = load_pair(work.tip_bias, i)
    linear = add(add(linear, frame[0]), cross(frame[1], load(work.tip, i)))
    angular = add(angular, frame[1])
    for a in range(constants.carrying[i], constants.turning[i]):
        linear = (linear[0] + work.tip_shape[a, 0] * rates[elastic + a], linear[1], linear[2])
    for a in range(constants.turning[i], constants.elastic_start[i + 1]):
        translation, rotation = load_pair(work.tip_shape, a)
        rate = rates[elastic + a]
        linear, angular = add_scaled(linear, rate, translation), add_scaled(angular, rate, rotation)
    return linear, angular

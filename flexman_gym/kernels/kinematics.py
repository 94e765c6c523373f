"""Kinematics of the chain, outward: where links are, how they move, and what their motion alone demands (Eq. 24-33)."""

from flexman_gym.kernels.compile import inner
from flexman_gym.kernels.lanes import fma, is_zero
from flexman_gym.kernels.linalg import (
    IDENTITY,
    ZERO,
    add,
    add_matrix,
    add_scaled,
    apply,
    apply_transposed,
    cross,
    dot,
    load,
    load_matrix,
    load_pair,
    product,
    rotation_matrix,
    sine_versine,
    store,
    store_matrix,
    store_pair,
    subtract_outer,
    tangent_coefficients,
    transposed,
)
from flexman_gym.kernels.stiffening import foreshorten_forces, foreshorten_mass, foreshorten_tip


@inner
def positions(constants, work, x):
    """Relative rotations, tips, tip shapes and mass integrals of all links at the coordinates x (d,).

    Overwrites the work space group `positions`.
    """
    n = len(constants.mass)
    elastic = len(x) - constants.elastic_start[n]
    for i in range(n):
        _joint_rotation(constants, work, i, x[i])
        _tip_position(constants, work, i, x, elastic)
        _mass_integrals(constants, work, i, x, elastic)
    _payload_position(constants, work, n - 1)


@inner
def _payload_position(constants, work, last):
    """First moment and inertia of the payload about the tip of the last link, in that link's frame."""
    c = load_matrix(constants.payload_mount, 0)
    if constants.elastic_start[last + 1] > constants.elastic_start[last]:
        c = product(tip_rotation(work, last), c)
    offset, mass = apply(c, load(constants.payload_offset, 0)), constants.payload_mass[0]
    store(work.payload_moment, 0, add_scaled(ZERO, mass, offset))
    rotary = product(product(c, load_matrix(constants.payload_inertia, 0)), transposed(c))
    rotary = add_matrix(rotary, mass * dot(offset, offset), IDENTITY)
    store_matrix(work.payload_rotary, 0, subtract_outer(rotary, offset, load(work.payload_moment, 0)))


@inner
def tip_rotation(work, i):
    """exp(S_r q) of link i."""
    deflected = load(work.deflected, i)
    sine = 1.0 - dot(deflected, deflected) * work.tangent[i, 1]
    return rotation_matrix(sine, work.tangent[i, 0], deflected)


@inner
def _joint_rotation(constants, work, i, angle):
    """C of link i = exp(S_r q of the previous link) mount exp(axis angle)."""
    sine, versine = sine_versine(angle)
    turned = rotation_matrix(sine, versine, load(constants.axis, i))
    c = product(load_matrix(constants.mount, i), turned)
    if i > 0 and constants.elastic_start[i] > constants.elastic_start[i - 1]:
        c = product(tip_rotation(work, i - 1), c)
    store_matrix(work.rotation, i, c)


@inner
def _tip_position(constants, work, i, x, elastic):
    """Tip of link i and its change with the elastic coordinates (Eq. 26 with the tangent operator)."""
    tip = (constants.length[i], 0.0, 0.0)
    deflected = ZERO
    for a in range(constants.turning[i], constants.elastic_start[i + 1]):
        q = x[elastic + a]
        tip = add_scaled(tip, q, load(constants.tip_translation, a))
        deflected = add_scaled(deflected, q, load(constants.tip_rotation, a))
    store(work.tip, i, tip)
    store(work.deflected, i, deflected)
    b, c, db, dc = tangent_coefficients(dot(deflected, deflected))
    work.tangent[i, 0], work.tangent[i, 1], work.tangent[i, 2], work.tangent[i, 3] = b, c, db, dc
    tangent = rotation_matrix(b, c, deflected)
    for a in range(constants.turning[i], constants.elastic_start[i + 1]):
        turned = apply(tangent, load(constants.tip_rotation, a))
        store_pair(work.tip_shape, a, load(constants.tip_translation, a), turned)
    if len(constants.station_mass) > 0:
        foreshorten_tip(constants, work, i, x, elastic)


@inner
def _mass_integrals(constants, work, i, x, elastic):
    """First moment, J, U and the coupling of rotation and elastic coordinates of link i (the blocks of Eq. 13)."""
    start, stop = constants.elastic_start[i], constants.elastic_start[i + 1]
    shape = work.shape
    for j in range(9 * start, 9 * stop):
        value = constants.position_shape[j]
        for e in range(constants.shape_start[j], constants.shape_start[j + 1]):
            value = fma(x[elastic + constants.shape_source[e]], constants.shape_value[e], value)
        shape[j] = value
    moment = load(constants.first_moment, i)
    xx, xy, xz, _, yy, yz, _, _, zz = load_matrix(constants.second_moment, i)
    for a in range(start, stop):
        q = x[elastic + a]
        store(work.moment_shape, a, load(constants.first_moment_shape, a))
        moment = add_scaled(moment, q, load(constants.first_moment_shape, a))
        # P = integral of r r^T, with r = r0 + S q; U holds r S^T, position_shape r0 S^T
        u, u0 = load_matrix(shape, a), load_matrix(constants.position_shape, a)
        xx = fma(q, u[0] + u0[0], xx)
        yy = fma(q, u[4] + u0[4], yy)
        zz = fma(q, u[8] + u0[8], zz)
        xy = fma(q, u[1] + u0[3], xy)
        xz = fma(q, u[2] + u0[6], xz)
        yz = fma(q, u[5] + u0[7], yz)
        store(work.coupling, a, (u[5] - u[7], u[6] - u[2], u[1] - u[3]))
    if len(constants.station_mass) > 0:
        change = foreshorten_mass(constants, work, i)
        moment = (moment[0] + change[0], moment[1], moment[2])
        xx, xy, xz = xx + change[1], xy + change[2], xz + change[3]
    store(work.moment, i, moment)
    store_matrix(work.inertia, i, (yy + zz, -xy, -xz, -xy, xx + zz, -yz, -xz, -yz, xx + yy))


@inner
def velocities(constants, work, v):
    """Velocities and velocity-dependent accelerations and forces of all links, for speeds v (d,).

    Needs `positions`; overwrites the work space group `velocities`.
    """
    n = len(constants.mass)
    elastic = len(v) - constants.elastic_start[n]
    spin = ZERO
    velocity = ZERO
    for i in range(n):
        c = load_matrix(work.rotation, i)
        spin, velocity = apply_transposed(c, spin), apply_transposed(c, velocity)
        axis = load(constants.axis, i)
        turn = add_scaled(ZERO, v[i], axis)
        store(work.joint_bias, i, cross(spin, turn))
        if not is_zero(constants.carried_inertia[i]):
            rate = dot(axis, spin) + v[constants.motor[i] if constants.motor[i] >= 0 else i]
            store(work.rotor_bias, i, add_scaled(ZERO, constants.carried_inertia[i] * rate, cross(spin, axis)))
        spin = add(spin, turn)
        store(work.spin, i, spin)
        store(work.velocity, i, velocity)
        _quadratic_forces(constants, work, i, v, elastic)
        linear, angular = _tip_motion(constants, work, i, v, elastic)
        velocity = add(add(velocity, cross(spin, load(work.tip, i))), linear)
        spin = add(spin, angular)
    store(work.payload_spin, 0, spin)
    store(work.tip_velocity, 0, velocity)
    force = cross(spin, cross(spin, load(work.payload_moment, 0)))
    store_pair(work.payload_bias, 0, force, cross(spin, apply(load_matrix(work.payload_rotary, 0), spin)))


@inner
def _tip_motion(constants, work, i, v, elastic):
    """Elastic velocity of the tip of link i, linear and angular; stores the tip's bias acceleration (Eq. 32, 33)."""
    linear = angular = turning = ZERO
    for a in range(constants.carrying[i], constants.turning[i]):
        linear = (linear[0] + v[elastic + a] * work.tip_shape[a, 0], 0.0, 0.0)
    for a in range(constants.turning[i], constants.elastic_start[i + 1]):
        rate = v[elastic + a]
        translation, rotation = load_pair(work.tip_shape, a)
        linear, angular = add_scaled(linear, rate, translation), add_scaled(angular, rate, rotation)
        turning = add_scaled(turning, rate, load(constants.tip_rotation, a))
    spin, deflected = load(work.spin, i), load(work.deflected, i)
    bias = add_scaled(cross(spin, cross(spin, load(work.tip, i))), 2.0, cross(spin, linear))
    # T' phi' = b' phi x phi' + c' phi x (phi x phi') + c phi' x (phi x phi')
    change = 2.0 * dot(deflected, turning)
    once = cross(deflected, turning)
    turned = add_scaled(cross(spin, angular), change * work.tangent[i, 2], once)
    turned = add_scaled(turned, change * work.tangent[i, 3], cross(deflected, once))
    turned = add_scaled(turned, work.tangent[i, 1], cross(turning, once))
    if constants.station_start[i + 1] > constants.station_start[i]:
        bias = (bias[0] + work.pulled[constants.station_start[i]], bias[1], bias[2])
    store_pair(work.tip_bias, i, bias, turned)
    return linear, angular


@inner
def _quadratic_forces(constants, work, i, v, elastic):
    """Quadratic velocity force, torque and elastic forces of link i (Eq. 14), on the side of M times acceleration."""
    spin = load(work.spin, i)
    square = dot(spin, spin)
    linear = relative = ZERO  # sum of q' S dm, and (tr(N) I - N^T) w with N = sum of q'_a U_a
    for a in range(constants.elastic_start[i], constants.elastic_start[i + 1]):
        rate = v[elastic + a]
        linear = add_scaled(linear, rate, load(work.moment_shape, a))
        u = load_matrix(work.shape, a)
        trace = u[0] + u[4] + u[8]
        turned = apply_transposed(u, spin)
        relative = add_scaled(relative, rate, add_scaled(add_scaled(ZERO, trace, spin), -1.0, turned))
        bias = dot(turned, spin) - trace * square
        for j in range(3):
            turning = 0.0  # integral of q' S_b x S_a dm
            for e in range(constants.cross_start[3 * a + j], constants.cross_start[3 * a + j + 1]):
                turning = fma(v[elastic + constants.cross_source[e]], constants.cross_value[e], turning)
            bias = fma(2.0 * work.spin[i, j], turning, bias)
        work.elastic_bias[a] = bias
    force = add_scaled(cross(spin, cross(spin, load(work.moment, i))), 2.0, cross(spin, linear))
    moment = add_scaled(cross(spin, apply(load_matrix(work.inertia, i), spin)), 2.0, relative)
    store_pair(work.bias, i, force, moment)
    if len(constants.station_mass) > 0:
        foreshorten_forces(constants, work, i, v, elastic)

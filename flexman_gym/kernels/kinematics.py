"""Kinematics from the base to the tip: positions, velocities and bias terms (Eq. 24-33 of the paper, see `layout`).

Symbols as in `layout`: q are elastic coordinates, S_t and S_r translation and rotation vector of the tip per unit of q,
C the rotation from the frame of a link to the frame of the previous link, J the inertia about the origin of the link,
and U_a the integral of r S_a^T dm over the link.

Foreshortening: bending does not change the length of the centreline, so a point at x moves towards the joint by 1/2 q^T
G(x) q (its displacement along x is - 1/2 q^T G(x) q), the integral of half the squared slopes from 0 to x. Its inertia
terms are exact derivatives of the positions of the stations, mass points on the centreline (see `model.beam`); with
terms expanded to second order the mass matrix would not stay positive definite at deflections of a few percent of the
length. The stations of a link begin with the tip and fill whole groups of LANES; stations that pad the last group have
no mass.
"""

import math

from flexman_gym.kernels.compile import inner
from flexman_gym.kernels.foundation import base_spin
from flexman_gym.kernels.lanes import (
    add_products,
    add_weighted_rows,
    fma,
    group_size,
    is_below,
    is_zero,
    load_lanes,
    scatter_lanes,
    select_below,
    store_lanes,
)
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
    transposed,
)


@inner
def compute_kinematics(constants, work, x, v):
    """Compute the kinematics of all links at the coordinates x and speeds v (d,), outward from the base.

    Overwrites the scratch arrays of the groups `positions` and `velocities`.
    """
    _positions(constants, work, x)
    _velocities(constants, work, v)


@inner
def _positions(constants, work, x):
    """Compute relative rotations, tips, tip shapes and mass integrals of all links at the coordinates x (d,).

    Overwrites the scratch arrays of the group `positions`.
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
    """Compute first moment and inertia of the payload about the tip of the last link, in the frame of that link."""
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
    """Return the rotation exp(S_r q) of the tip of link i."""
    phi = load(work.rotation_vector, i)
    sine = 1.0 - dot(phi, phi) * work.tangent[i, 1]
    return rotation_matrix(sine, work.tangent[i, 0], phi)


@inner
def _joint_rotation(constants, work, i, angle):
    """Compute C of link i: tip rotation exp(S_r q) of the previous link times mount exp(axis angle), angle in rad."""
    sine, versine = sine_versine(angle)
    turned = rotation_matrix(sine, versine, load(constants.axis, i))
    c = product(load_matrix(constants.mount, i), turned)
    if i > 0 and constants.elastic_start[i] > constants.elastic_start[i - 1]:
        c = product(tip_rotation(work, i - 1), c)
    store_matrix(work.rotation, i, c)


@inner
def _tip_position(constants, work, i, x, elastic):
    """Compute the tip of link i and its derivatives with respect to elastic coordinates (Eq. 26 of the paper, with T).

    `elastic`, here and below, is the index in x of the first elastic coordinate.
    """
    tip = (constants.length[i], 0.0, 0.0)
    phi = ZERO
    for a in range(constants.tip_linear_start[i], constants.elastic_start[i + 1]):
        q = x[elastic + a]
        tip = add_scaled(tip, q, load(constants.tip_translation, a))
        phi = add_scaled(phi, q, load(constants.tip_rotation, a))
    store(work.tip, i, tip)
    store(work.rotation_vector, i, phi)
    b, c, db, dc = _tangent_coefficients(dot(phi, phi))
    work.tangent[i, 0], work.tangent[i, 1], work.tangent[i, 2], work.tangent[i, 3] = b, c, db, dc
    tangent = rotation_matrix(b, c, phi)
    for a in range(constants.tip_linear_start[i], constants.elastic_start[i + 1]):
        turned = apply(tangent, load(constants.tip_rotation, a))
        store_pair(work.tip_shape, a, load(constants.tip_translation, a), turned)
    if len(constants.station_mass) > 0:
        _foreshorten_tip(constants, work, i, x, elastic)


@inner
def _tangent_coefficients(z):
    """Return b = (1 - cos p)/p^2 and c = (p - sin p)/p^3 of T = I + b X + c X^2, and db/dz and dc/dz for z = p^2.

    X is the skew matrix of the rotation vector phi, p its length.
    """
    # Taylor series, exact to rounding: the quotients below lose all digits at zero
    b = 1 / 2 - z * (1 / 24 - z * (1 / 720 - z * (1 / 40320 - z * (1 / 3628800 - z * (1 / 479001600)))))
    c = 1 / 6 - z * (1 / 120 - z * (1 / 5040 - z * (1 / 362880 - z * (1 / 39916800 - z * (1 / 6227020800)))))
    db = -1 / 24 + z * (1 / 360 - z * (1 / 13440 - z * (1 / 907200 - z * (1 / 95800320 - z * (1 / 14529715200)))))
    dc = 1 / 120960 - z * (1 / 9979200 - z * (1 / 1245404160 - z * (1 / 217945728000)))
    dc = -1 / 120 + z * (1 / 2520 - z * dc)
    if is_below(z, 0.25):
        return b, c, db, dc
    p = math.sqrt(z)
    s = math.sin(p) / p
    far_b = (1.0 - math.cos(p)) / z
    far_c = (1.0 - s) / z
    far_db, far_dc = (s - 2.0 * far_b) / (2.0 * z), (far_b - 3.0 * far_c) / (2.0 * z)
    return (
        select_below(z, 0.25, b, far_b), select_below(z, 0.25, c, far_c),
        select_below(z, 0.25, db, far_db), select_below(z, 0.25, dc, far_dc),
    )  # fmt: skip


@inner
def _mass_integrals(constants, work, i, x, elastic):
    """Compute first moment, J, U_a and coupling of rotation and elastic coordinates of link i (Eq. 13 of the paper)."""
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
        change = _foreshorten_mass(constants, work, i)
        moment = (moment[0] + change[0], moment[1], moment[2])
        xx, xy, xz = xx + change[1], xy + change[2], xz + change[3]
    store(work.moment, i, moment)
    store_matrix(work.inertia, i, (yy + zz, -xy, -xz, -xy, xx + zz, -yz, -xz, -yz, xx + yy))


@inner
def _velocities(constants, work, v):
    """Compute velocities, and velocity-dependent terms of accelerations and forces, for speeds v (d,).

    These bias terms remain if all generalised accelerations are zero. Call `_positions` first. Overwrites the scratch
    arrays of the group `velocities`.
    """
    n = len(constants.mass)
    elastic = len(v) - constants.elastic_start[n]
    spin = base_spin(constants, work)
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
    """Return the elastic velocity (linear, angular) of the tip of link i; set its bias (Eq. 32, 33 of the paper)."""
    linear = angular = phi_rate = ZERO
    for a in range(constants.tip_start[i], constants.tip_linear_start[i]):
        linear = (linear[0] + v[elastic + a] * work.tip_shape[a, 0], 0.0, 0.0)
    for a in range(constants.tip_linear_start[i], constants.elastic_start[i + 1]):
        rate = v[elastic + a]
        translation, rotation = load_pair(work.tip_shape, a)
        linear, angular = add_scaled(linear, rate, translation), add_scaled(angular, rate, rotation)
        phi_rate = add_scaled(phi_rate, rate, load(constants.tip_rotation, a))
    spin, phi = load(work.spin, i), load(work.rotation_vector, i)
    bias = add_scaled(cross(spin, cross(spin, load(work.tip, i))), 2.0, cross(spin, linear))
    # T' phi' = b' phi x phi' + c' phi x (phi x phi') + c phi' x (phi x phi')
    change = 2.0 * dot(phi, phi_rate)
    once = cross(phi, phi_rate)
    turned = add_scaled(cross(spin, angular), change * work.tangent[i, 2], once)
    turned = add_scaled(turned, change * work.tangent[i, 3], cross(phi, once))
    turned = add_scaled(turned, work.tangent[i, 1], cross(phi_rate, once))
    if constants.station_start[i + 1] > constants.station_start[i]:
        bias = (bias[0] + work.axial_bias[constants.station_start[i]], bias[1], bias[2])
    store_pair(work.tip_bias, i, bias, turned)
    return linear, angular


@inner
def _quadratic_forces(constants, work, i, v, elastic):
    """Compute the quadratic velocity forces h(q, v) of link i in M v' + h = Q; h = -Q_v, Eq. 14 of the paper."""
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
            coriolis = 0.0  # integral of q' S_b x S_a dm
            for e in range(constants.cross_start[3 * a + j], constants.cross_start[3 * a + j + 1]):
                coriolis = fma(v[elastic + constants.cross_source[e]], constants.cross_value[e], coriolis)
            bias = fma(2.0 * work.spin[i, j], coriolis, bias)
        work.elastic_bias[a] = bias
    force = add_scaled(cross(spin, cross(spin, load(work.moment, i))), 2.0, cross(spin, linear))
    moment = add_scaled(cross(spin, apply(load_matrix(work.inertia, i), spin)), 2.0, relative)
    store_pair(work.bias, i, force, moment)
    if len(constants.station_mass) > 0:
        _foreshorten_forces(constants, work, i, v, elastic)


@inner
def _foreshorten_tip(constants, work, i, x, elastic):
    """Compute motion and foreshortening of the stations of link i; add foreshortening to tip and tip shape."""
    start, stop, first = constants.elastic_start[i], constants.elastic_start[i + 1], constants.station_start[i]
    count = constants.station_start[i + 1] - first
    width, row = constants.station_width[i], constants.station_row[i]
    for s in range(0, count, group_size(work.foreshortening)):
        displacement = _station_motion(constants, i, s, x, elastic)
        store_lanes(work.displacement, 3 * first + s, displacement[0])
        for c in range(1, 3):
            offset = load_lanes(constants.station_offset, 2 * first + (c - 1) * count + s)
            store_lanes(work.displacement, 3 * first + c * count + s, displacement[c] + offset)
        foreshortening = 0.0
        for a in range(start, stop):
            bend = _station_bend(constants, i, s, a, x, elastic)
            foreshortening = fma(-0.5 * x[elastic + a], bend, foreshortening)
            store_lanes(work.bend_stations, row + (a - start) * count + s, bend)
            scatter_lanes(work.bend, row + s * width + a - start, width, bend)
        store_lanes(work.foreshortening, first + s, foreshortening)
    for a in range(start, stop):
        work.tip_shape[a, 0] = constants.tip_translation[a, 0] - work.bend[row + a - start]
    if count > 0:
        work.tip[i, 0] += work.foreshortening[first]


@inner
def _station_motion(constants, i, s, rates, elastic):
    """Return displacements x, y, z, for elastic entries of `rates` (d,), of the group of stations s of link i."""
    count = constants.station_start[i + 1] - constants.station_start[i]
    start, source = constants.displacement_start, constants.displacement_source
    values, first = constants.displacement_value, constants.displacement_row[i] + s
    x = y = z = 0.0
    for e in range(start[3 * i], start[3 * i + 1]):
        x = fma(rates[elastic + source[e]], load_lanes(values, first + e * count), x)
    for e in range(start[3 * i + 1], start[3 * i + 2]):
        y = fma(rates[elastic + source[e]], load_lanes(values, first + e * count), y)
    for e in range(start[3 * i + 2], start[3 * i + 3]):
        z = fma(rates[elastic + source[e]], load_lanes(values, first + e * count), z)
    return x, y, z


@inner
def _station_bend(constants, i, s, a, rates, elastic):
    """Return row a of G_s q' at stations s of link i: foreshortening matrices G_s, elastic part q' of `rates`."""
    count = constants.station_start[i + 1] - constants.station_start[i]
    bend, value = 0.0, constants.bend_row[i] + s
    for e in range(constants.bend_start[a], constants.bend_start[a + 1]):
        bend = fma(rates[elastic + constants.bend_source[e]], load_lanes(constants.bend_value, value + e * count), bend)
    return bend


@inner
def _foreshorten_mass(constants, work, i):
    """Add foreshortening to work.moment_shape and work.coupling of link i, after `_foreshorten_tip`.

    Returns the changes of the first moment along x and of the entries xx, xy, xz of P.
    """
    first, row, width = constants.station_start[i], constants.station_row[i], constants.station_width[i]
    count, weight, total = constants.station_start[i + 1] - first, work.weight, work.row_sums
    moment_x = xx = xy = xz = 0.0
    for s in range(0, count, group_size(work.foreshortening)):
        mass, j = load_lanes(constants.station_mass, first + s), 3 * first + s
        foreshortening = load_lanes(work.foreshortening, first + s)
        along = load_lanes(constants.station_position, first + s) + load_lanes(work.displacement, j)
        y, z = load_lanes(work.displacement, j + count), load_lanes(work.displacement, j + 2 * count)
        shift, j = mass * foreshortening, 4 * first + s
        store_lanes(weight, j, shift)
        store_lanes(weight, j + count, mass * y)
        store_lanes(weight, j + 2 * count, mass * z)
        moment_x = add_products(moment_x, shift, 1.0)
        xx = add_products(xx, shift, 2.0 * along + foreshortening)
        xy, xz = add_products(xy, shift, y), add_products(xz, shift, z)
    for group in range(0, width, group_size(work.foreshortening)):
        moment = across_y = across_z = 0.0
        for s in range(0, count, group_size(work.foreshortening)):
            weights, j = 4 * first + s, row + s * width + group
            shift = load_lanes(weight, weights)
            moment = add_weighted_rows(moment, (load_lanes(constants.station_mass, first + s),), (work.bend,), j, width)
            factors, rows = (load_lanes(weight, weights + count), shift), (work.bend, constants.station_shape[1])
            across_y = add_weighted_rows(across_y, factors, rows, j, width)
            factors, rows = (load_lanes(weight, weights + 2 * count), shift), (work.bend, constants.station_shape[2])
            across_z = add_weighted_rows(across_z, factors, rows, j, width)
        store_lanes(total, group, moment)
        store_lanes(total, width + group, across_z)
        store_lanes(total, 2 * width + group, across_y)
    for j in range(row, row + count * width, group_size(work.foreshortening)):
        store_lanes(work.stretch, j, load_lanes(constants.station_shape[0], j) - load_lanes(work.bend, j))
    start = constants.elastic_start[i]
    for a in range(constants.elastic_start[i + 1] - start):
        work.moment_shape[start + a, 0] -= total[a]
        work.coupling[start + a, 1] -= total[width + a]
        work.coupling[start + a, 2] += total[2 * width + a]
    return moment_x, xx, xy, xz


@inner
def _foreshorten_forces(constants, work, i, v, elastic):
    """Add the quadratic velocity forces of foreshortening to link i, after `_foreshorten_mass` at these coordinates."""
    first, row, width = constants.station_start[i], constants.station_row[i], constants.station_width[i]
    count, weight, w = constants.station_start[i + 1] - first, work.weight, load(work.spin, i)
    square = dot(w, w)
    force = moment_x = moment_y = moment_z = 0.0
    for s in range(0, count, group_size(work.foreshortening)):
        mass, j = load_lanes(constants.station_mass, first + s), 3 * first + s
        foreshortening = load_lanes(work.foreshortening, first + s)
        x = load_lanes(constants.station_position, first + s) + load_lanes(work.displacement, j) + foreshortening
        y, z = load_lanes(work.displacement, j + count), load_lanes(work.displacement, j + 2 * count)
        rate = _station_motion(constants, i, s, v, elastic)
        shortening_rate, axial_bias = _station_rates(constants, work, i, s, v, elastic)
        store_lanes(work.axial_rate, first + s, rate[0] + shortening_rate)
        store_lanes(work.axial_bias, first + s, axial_bias)
        # Coriolis acceleration 2 w x velocity, of foreshortening (`turn`) and of the remaining displacement (`plain`);
        # `whole` is the x component of the acceleration for zero generalised accelerations
        turn_y, turn_z = 2.0 * w[2] * shortening_rate, -2.0 * w[1] * shortening_rate
        plain_y, plain_z = 2.0 * (w[2] * rate[0] - w[0] * rate[2]), 2.0 * (w[0] * rate[1] - w[1] * rate[0])
        whole = w[0] * dot(w, (x, y, z)) - square * x + 2.0 * (w[1] * rate[2] - w[2] * rate[1]) + axial_bias
        j = 4 * first + s
        store_lanes(weight, j, mass * ((w[0] * w[0] - square) * foreshortening + axial_bias))
        store_lanes(weight, j + count, mass * (w[0] * w[1] * foreshortening + turn_y))
        store_lanes(weight, j + 2 * count, mass * (w[0] * w[2] * foreshortening + turn_z))
        store_lanes(weight, j + 3 * count, (-1.0 * mass) * whole)
        force = add_products(force, mass, axial_bias)
        moment_x = add_products(moment_x, mass * (y * turn_z - z * turn_y), 1.0)
        moment_y = add_products(moment_y, mass * (z * axial_bias - x * turn_z - foreshortening * plain_z), 1.0)
        moment_z = add_products(moment_z, mass * (x * turn_y - y * axial_bias + foreshortening * plain_y), 1.0)
    work.bias[i, 0] += force
    work.bias[i, 3] += moment_x
    work.bias[i, 4] += moment_y
    work.bias[i, 5] += moment_z
    for group in range(0, width, group_size(work.foreshortening)):
        total = 0.0
        for s in range(0, count, group_size(work.foreshortening)):
            weights, j = 4 * first + s, row + s * width + group
            factors = (
                load_lanes(weight, weights), load_lanes(weight, weights + count),
                load_lanes(weight, weights + 2 * count), load_lanes(weight, weights + 3 * count),
            )  # fmt: skip
            shapes = constants.station_shape
            total = add_weighted_rows(total, factors, (shapes[0], shapes[1], shapes[2], work.bend), j, width)
        store_lanes(work.row_sums, group, total)
    start = constants.elastic_start[i]
    for a in range(constants.elastic_start[i + 1] - start):
        work.elastic_bias[start + a] += work.row_sums[a]


@inner
def _station_rates(constants, work, i, s, v, elastic):
    """Return - q'^T G q (rate of the displacement by foreshortening) and - q'^T G q' at stations s of link i."""
    start, row = constants.elastic_start[i], constants.station_row[i] + s
    count = constants.station_start[i + 1] - constants.station_start[i]
    shortening_rate = axial_bias = 0.0
    for a in range(start, constants.elastic_start[i + 1]):
        shortening_rate = fma(
            -v[elastic + a], load_lanes(work.bend_stations, row + (a - start) * count), shortening_rate
        )
        axial_bias = fma(-v[elastic + a], _station_bend(constants, i, s, a, v, elastic), axial_bias)
    return shortening_rate, axial_bias

"""Kinematics of the chain, outward: where links are, how they move, and what their motion alone demands (Eq. 24-33)."""

import math

from flexman_gym.kernels.linalg import (
    cross,
    inner,
    kernel,
    load,
    product,
    rotate,
    rotate_back,
    rotation_matrix,
    tangent_coefficients,
)


@kernel
def positions(constants, work, x):
    """Relative rotations, tips, tip shapes and mass integrals of all links at the coordinates x (d,).

    Overwrites the work space group `positions`.
    """
    n = len(constants.mass)
    elastic = len(x) - constants.elastic_start[n]
    deflected = (0.0, 0.0, 0.0)
    for i in range(n):
        joint_rotation(constants, work, i, x[i], deflected)
        deflected = tip_position(constants, work, i, x, elastic)
        mass_integrals(constants, work, i, x, elastic)


@inner
def joint_rotation(constants, work, i, angle, deflected):
    """C of link i = exp(deflected) mount exp(axis angle), with the tip rotation vector of the previous link."""
    mount = constants.mount[i]
    c = product(
        (
            mount[0, 0], mount[0, 1], mount[0, 2],
            mount[1, 0], mount[1, 1], mount[1, 2],
            mount[2, 0], mount[2, 1], mount[2, 2],
        ),
        rotation_matrix(math.sin(angle), 1.0 - math.cos(angle), load(constants.axis, i)),
    )  # fmt: skip
    z = deflected[0] ** 2 + deflected[1] ** 2 + deflected[2] ** 2
    if z > 0.0:
        b, t, _, _ = tangent_coefficients(z)
        c = product(rotation_matrix(1.0 - z * t, b, deflected), c)
    for j in range(9):
        work.rotation[i, j // 3, j % 3] = c[j]


@inner
def tip_position(constants, work, i, x, elastic):
    """Tip of link i and its change with the elastic coordinates (Eq. 26 with the tangent operator); returns S_r q."""
    start, stop = constants.elastic_start[i], constants.elastic_start[i + 1]
    d0, d1, d2 = constants.length[i], 0.0, 0.0
    p0 = p1 = p2 = 0.0
    for a in range(start, stop):
        q = x[elastic + a]
        d0 += q * constants.tip_translation[a, 0]
        d1 += q * constants.tip_translation[a, 1]
        d2 += q * constants.tip_translation[a, 2]
        p0 += q * constants.tip_rotation[a, 0]
        p1 += q * constants.tip_rotation[a, 1]
        p2 += q * constants.tip_rotation[a, 2]
    work.tip[i, 0], work.tip[i, 1], work.tip[i, 2] = d0, d1, d2
    b, t, _, _ = tangent_coefficients(p0 * p0 + p1 * p1 + p2 * p2)
    tangent = rotation_matrix(b, t, (p0, p1, p2))
    for a in range(start, stop):
        s0, s1, s2 = load(constants.tip_rotation, a)
        work.tip_shape[a, 0] = constants.tip_translation[a, 0]
        work.tip_shape[a, 1] = constants.tip_translation[a, 1]
        work.tip_shape[a, 2] = constants.tip_translation[a, 2]
        work.tip_shape[a, 3] = tangent[0] * s0 + tangent[1] * s1 + tangent[2] * s2
        work.tip_shape[a, 4] = tangent[3] * s0 + tangent[4] * s1 + tangent[5] * s2
        work.tip_shape[a, 5] = tangent[6] * s0 + tangent[7] * s1 + tangent[8] * s2
    return p0, p1, p2


@inner
def mass_integrals(constants, work, i, x, elastic):
    """First moment, J, U and the coupling of rotation and elastic coordinates of link i (the blocks of Eq. 13)."""
    start, stop = constants.elastic_start[i], constants.elastic_start[i + 1]
    k = stop - start
    shape = work.shape
    for a in range(start, stop):
        for j in range(9):
            shape[a, j] = constants.position_shape[a, j]
    for b in range(k):
        q = x[elastic + start + b]
        row = constants.square_start[i] + b * k
        for a in range(k):
            for j in range(9):
                shape[start + a, j] += q * constants.shape_shape[row + a, j]
    c0, c1, c2 = load(constants.first_moment, i)
    second = constants.second_moment[i]
    xx, yy, zz = second[0, 0], second[1, 1], second[2, 2]
    xy, xz, yz = second[0, 1], second[0, 2], second[1, 2]
    for a in range(start, stop):
        q = x[elastic + a]
        c0 += q * constants.first_moment_shape[a, 0]
        c1 += q * constants.first_moment_shape[a, 1]
        c2 += q * constants.first_moment_shape[a, 2]
        # P = integral of r r^T, with r = r0 + S q; U holds r S^T, position_shape r0 S^T
        xx += q * (shape[a, 0] + constants.position_shape[a, 0])
        yy += q * (shape[a, 4] + constants.position_shape[a, 4])
        zz += q * (shape[a, 8] + constants.position_shape[a, 8])
        xy += q * (shape[a, 1] + constants.position_shape[a, 3])
        xz += q * (shape[a, 2] + constants.position_shape[a, 6])
        yz += q * (shape[a, 5] + constants.position_shape[a, 7])
        work.coupling[a, 0] = shape[a, 5] - shape[a, 7]
        work.coupling[a, 1] = shape[a, 6] - shape[a, 2]
        work.coupling[a, 2] = shape[a, 1] - shape[a, 3]
    work.moment[i, 0], work.moment[i, 1], work.moment[i, 2] = c0, c1, c2
    inertia = work.inertia
    inertia[i, 0, 0], inertia[i, 1, 1], inertia[i, 2, 2] = yy + zz, xx + zz, xx + yy
    inertia[i, 0, 1] = inertia[i, 1, 0] = -xy
    inertia[i, 0, 2] = inertia[i, 2, 0] = -xz
    inertia[i, 1, 2] = inertia[i, 2, 1] = -yz


@kernel
def velocities(constants, work, x, v):
    """Velocities and velocity-dependent accelerations and forces of all links, for speeds v (d,).

    Needs `positions` at the same x; overwrites the work space group `velocities`.
    """
    n = len(constants.mass)
    elastic = len(v) - constants.elastic_start[n]
    w = (0.0, 0.0, 0.0)
    u = (0.0, 0.0, 0.0)
    for i in range(n):
        w = rotate_back(work.rotation, i, w)
        u = rotate_back(work.rotation, i, u)
        axis = load(constants.axis, i)
        rate = v[i]
        turn = (axis[0] * rate, axis[1] * rate, axis[2] * rate)
        work.joint_bias[i, 0], work.joint_bias[i, 1], work.joint_bias[i, 2] = cross(w, turn)
        w = (w[0] + turn[0], w[1] + turn[1], w[2] + turn[2])
        work.spin[i, 0], work.spin[i, 1], work.spin[i, 2] = w
        work.velocity[i, 0], work.velocity[i, 1], work.velocity[i, 2] = u
        quadratic_forces(constants, work, i, v, elastic)
        linear, angular = tip_motion(constants, work, i, x, v, elastic)
        d = cross(w, load(work.tip, i))
        u = (u[0] + d[0] + linear[0], u[1] + d[1] + linear[1], u[2] + d[2] + linear[2])
        w = (w[0] + angular[0], w[1] + angular[1], w[2] + angular[2])


@inner
def tip_motion(constants, work, i, x, v, elastic):
    """Elastic velocity of the tip of link i, as two three-tuples; stores the bias acceleration of the tip (Eq. 32, 33)."""
    start, stop = constants.elastic_start[i], constants.elastic_start[i + 1]
    l0 = l1 = l2 = w0 = w1 = w2 = 0.0
    p0 = p1 = p2 = r0 = r1 = r2 = 0.0
    for a in range(start, stop):
        q, rate = x[elastic + a], v[elastic + a]
        l0 += rate * work.tip_shape[a, 0]
        l1 += rate * work.tip_shape[a, 1]
        l2 += rate * work.tip_shape[a, 2]
        w0 += rate * work.tip_shape[a, 3]
        w1 += rate * work.tip_shape[a, 4]
        w2 += rate * work.tip_shape[a, 5]
        p0 += q * constants.tip_rotation[a, 0]
        p1 += q * constants.tip_rotation[a, 1]
        p2 += q * constants.tip_rotation[a, 2]
        r0 += rate * constants.tip_rotation[a, 0]
        r1 += rate * constants.tip_rotation[a, 1]
        r2 += rate * constants.tip_rotation[a, 2]
    spin = load(work.spin, i)
    centripetal = cross(spin, cross(spin, load(work.tip, i)))
    coriolis = cross(spin, (l0, l1, l2))
    # T' phi' = b' phi x phi' + c' phi x (phi x phi') + c phi' x (phi x phi')
    _, t, db, dt = tangent_coefficients(p0 * p0 + p1 * p1 + p2 * p2)
    change = 2.0 * (p0 * r0 + p1 * r1 + p2 * r2)
    once = cross((p0, p1, p2), (r0, r1, r2))
    twice = cross((p0, p1, p2), once)
    mixed = cross((r0, r1, r2), once)
    carried = cross(spin, (w0, w1, w2))
    for j in range(3):
        work.tip_bias[i, j] = centripetal[j] + 2.0 * coriolis[j]
        work.tip_bias[i, 3 + j] = carried[j] + change * (db * once[j] + dt * twice[j]) + t * mixed[j]
    return (l0, l1, l2), (w0, w1, w2)


@inner
def quadratic_forces(constants, work, i, v, elastic):
    """Quadratic velocity force, torque and elastic forces of link i (Eq. 14), as they stand beside M times acceleration."""
    start, stop = constants.elastic_start[i], constants.elastic_start[i + 1]
    k = stop - start
    w = load(work.spin, i)
    square = w[0] * w[0] + w[1] * w[1] + w[2] * w[2]
    l0 = l1 = l2 = 0.0
    n0 = n1 = n2 = 0.0  # (tr(N) I - N^T) w with N = sum of q'_a U_a
    for a in range(start, stop):
        rate = v[elastic + a]
        l0 += rate * constants.first_moment_shape[a, 0]
        l1 += rate * constants.first_moment_shape[a, 1]
        l2 += rate * constants.first_moment_shape[a, 2]
        u = work.shape[a]
        trace = u[0] + u[4] + u[8]
        t0 = u[0] * w[0] + u[3] * w[1] + u[6] * w[2]
        t1 = u[1] * w[0] + u[4] * w[1] + u[7] * w[2]
        t2 = u[2] * w[0] + u[5] * w[1] + u[8] * w[2]
        n0 += rate * (trace * w[0] - t0)
        n1 += rate * (trace * w[1] - t1)
        n2 += rate * (trace * w[2] - t2)
        work.elastic_bias[a] = t0 * w[0] + t1 * w[1] + t2 * w[2] - trace * square
    for b in range(k):
        rate = 2.0 * v[elastic + start + b]
        row = constants.square_start[i] + b * k
        for a in range(k):
            work.elastic_bias[start + a] += rate * (
                w[0] * constants.shape_cross[row + a, 0]
                + w[1] * constants.shape_cross[row + a, 1]
                + w[2] * constants.shape_cross[row + a, 2]
            )
    centripetal = cross(w, cross(w, load(work.moment, i)))
    coriolis = cross(w, (l0, l1, l2))
    gyroscopic = cross(w, rotate(work.inertia, i, w))
    relative = (n0, n1, n2)
    for j in range(3):
        work.bias[i, j] = centripetal[j] + 2.0 * coriolis[j]
        work.bias[i, 3 + j] = gyroscopic[j] + 2.0 * relative[j]

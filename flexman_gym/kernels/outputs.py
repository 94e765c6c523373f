"""What is read off a state: tip, deflection, energies."""

import math

from flexman_gym.kernels.kinematics import positions, velocities
from flexman_gym.kernels.linalg import cross, inner, kernel, load, product, rotate, rotation_matrix

IDENTITY = (1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0)


@kernel
def observe(constants, work, x, v, out):
    """out (OUTPUTS,) = tip, its velocity, its deflection and deflection rate in the base frame, and energies (J).

    The deflection (m) is measured from the tip of the rigid arm at the motor angles, its rate (m/s) from that arm's tip
    velocity, so that both vanish for an arm that does not bend. Columns: see `layout`.
    """
    positions(constants, work, x)
    velocities(constants, work, x, v)
    n = len(constants.mass)
    elastic = len(x) - constants.elastic_start[n]
    position, velocity, kinetic, gravitational = chain_outputs(constants, work, v, elastic)
    rigid, rate = rigid_tip(constants, x, v)
    for j in range(3):
        out[j], out[3 + j] = position[j], velocity[j]
        out[6 + j], out[9 + j] = position[j] - rigid[j], velocity[j] - rate[j]
    joints = 0.0
    for i in range(n):
        m = constants.motor[i]
        rotor_rate = v[i]
        if m >= 0:
            rotor_rate = v[m]
            joints += 0.5 * constants.joint_stiffness[i] * (x[m] - x[i]) ** 2
        kinetic += 0.5 * constants.rotor_inertia[i] * rotor_rate**2
    links = 0.0
    for i in range(n):
        links += 0.5 * square_form(constants.stiffness, constants, i, x, elastic)
    out[12], out[13], out[14], out[15] = kinetic, links, joints, gravitational


@inner
def square_form(matrices, constants, i, rates, elastic):
    """q^T matrix q for the packed (k, k) matrix of link i and the elastic part of `rates` (d,)."""
    start, square = constants.elastic_start[i], constants.square_start[i]
    k = constants.elastic_start[i + 1] - start
    value = 0.0
    for a in range(k):
        for b in range(k):
            value += rates[elastic + start + a] * matrices[square + a * k + b] * rates[elastic + start + b]
    return value


@inner
def chain_outputs(constants, work, v, elastic):
    """Tip position and velocity in the base frame, kinetic energy without rotors, gravitational energy."""
    n = len(constants.mass)
    frame = IDENTITY
    origin = (0.0, 0.0, 0.0)
    lifted = (0.0, 0.0, 0.0)  # sum of mass times position
    velocity = (0.0, 0.0, 0.0)
    kinetic = 0.0
    for i in range(n):
        c = work.rotation[i]
        frame = product(frame, (c[0, 0], c[0, 1], c[0, 2], c[1, 0], c[1, 1], c[1, 2], c[2, 0], c[2, 1], c[2, 2]))
        moment = turn(frame, load(work.moment, i))
        mass = constants.mass[i]
        lifted = (
            lifted[0] + mass * origin[0] + moment[0],
            lifted[1] + mass * origin[1] + moment[1],
            lifted[2] + mass * origin[2] + moment[2],
        )
        kinetic += link_energy(constants, work, i, v, elastic)
        tip = load(work.tip, i)
        velocity = tip_velocity(constants, work, i, v, elastic)
        step = turn(frame, tip)
        origin = (origin[0] + step[0], origin[1] + step[1], origin[2] + step[2])
    velocity = turn(frame, velocity)
    payload = constants.payload_mass[0]
    kinetic += 0.5 * payload * (velocity[0] ** 2 + velocity[1] ** 2 + velocity[2] ** 2)
    gravitational = 0.0
    for j in range(3):
        gravitational -= constants.gravity[j] * (lifted[j] + payload * origin[j])
    return origin, velocity, kinetic, gravitational


@inner
def turn(frame, a):
    """Rotation (nine numbers by rows) times a three-tuple."""
    return (
        frame[0] * a[0] + frame[1] * a[1] + frame[2] * a[2],
        frame[3] * a[0] + frame[4] * a[1] + frame[5] * a[2],
        frame[6] * a[0] + frame[7] * a[1] + frame[8] * a[2],
    )


@inner
def tip_velocity(constants, work, i, v, elastic):
    """Velocity of the tip of link i in its beam frame."""
    u, w = load(work.velocity, i), cross(load(work.spin, i), load(work.tip, i))
    u = (u[0] + w[0], u[1] + w[1], u[2] + w[2])
    for a in range(constants.elastic_start[i], constants.elastic_start[i + 1]):
        rate = v[elastic + a]
        shape = load(work.tip_shape, a)
        u = (u[0] + rate * shape[0], u[1] + rate * shape[1], u[2] + rate * shape[2])
    return u


@inner
def link_energy(constants, work, i, v, elastic):
    """Kinetic energy of link i, 1/2 v^T M v with the blocks of Eq. 13."""
    u, w = load(work.velocity, i), load(work.spin, i)
    momentum = cross(w, load(work.moment, i))
    rotary = rotate(work.inertia, i, w)
    value = 0.5 * square_form(constants.elastic_mass, constants, i, v, elastic)
    for j in range(3):
        value += u[j] * (0.5 * constants.mass[i] * u[j] + momentum[j]) + 0.5 * w[j] * rotary[j]
    for a in range(constants.elastic_start[i], constants.elastic_start[i + 1]):
        rate = v[elastic + a]
        for j in range(3):
            value += rate * (u[j] * constants.first_moment_shape[a, j] + w[j] * work.coupling[a, j])
    return value


@inner
def rigid_tip(constants, x, v):
    """Tip position and velocity, in the base frame, of the rigid arm at the motor angles and rates."""
    frame = IDENTITY
    origin = (0.0, 0.0, 0.0)
    velocity = (0.0, 0.0, 0.0)
    spin = (0.0, 0.0, 0.0)
    for i in range(len(constants.mass)):
        m = constants.motor[i] if constants.motor[i] >= 0 else i
        c = constants.mount[i]
        axis = load(constants.axis, i)
        mount = (c[0, 0], c[0, 1], c[0, 2], c[1, 0], c[1, 1], c[1, 2], c[2, 0], c[2, 1], c[2, 2])
        frame = product(frame, product(mount, rotation_matrix(math.sin(x[m]), 1.0 - math.cos(x[m]), axis)))
        joint = turn(frame, axis)
        spin = (spin[0] + v[m] * joint[0], spin[1] + v[m] * joint[1], spin[2] + v[m] * joint[2])
        step = turn(frame, (constants.length[i], 0.0, 0.0))
        rate = cross(spin, step)
        origin = (origin[0] + step[0], origin[1] + step[1], origin[2] + step[2])
        velocity = (velocity[0] + rate[0], velocity[1] + rate[1], velocity[2] + rate[2])
    return origin, velocity

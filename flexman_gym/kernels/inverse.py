"""Inverse dynamics of the chain: the generalised forces that given accelerations demand, M v' + h (left side of Eq. 44)."""

from flexman_gym.kernels.dynamics import arrive, base_acceleration, tip_acceleration
from flexman_gym.kernels.kinematics import positions, velocities
from flexman_gym.kernels.linalg import cross, inner, kernel, load, load_linear_angular, rotate


@kernel
def inertial_forces(constants, work, x, v, acceleration, out):
    """out (d,) = generalised inertial and gravitational forces at x, v (d,) for accelerations (d,)."""
    positions(constants, work, x)
    velocities(constants, work, x, v)
    n = len(constants.mass)
    elastic = len(x) - constants.elastic_start[n]
    base_acceleration(constants, work)
    for i in range(n):
        arrive(constants, work, i)
        for j in range(3):
            work.acceleration[i, 3 + j] += acceleration[i] * constants.axis[i, j]
        tip_acceleration(constants, work, i, acceleration, elastic)
    for j in range(3):
        work.tip_force[j] = constants.payload_mass[0] * work.tip_acceleration[j]
        work.tip_force[3 + j] = 0.0
    for i in range(n - 1, -1, -1):
        elastic_forces(constants, work, i, acceleration, out)
        link_force(constants, work, i, acceleration, elastic)
        force, moment = load_linear_angular(work.articulated_force, i)
        s = load(constants.axis, i)
        out[i] = s[0] * moment[0] + s[1] * moment[1] + s[2] * moment[2]
        m = constants.motor[i]
        rotor = i if m < 0 else m
        if m >= 0:
            out[m] = 0.0
        out[rotor] += constants.rotor_inertia[i] * acceleration[rotor]
        force, moment = rotate(work.rotation, i, force), rotate(work.rotation, i, moment)
        for j in range(3):
            work.tip_force[j], work.tip_force[3 + j] = force[j], moment[j]


@inner
def link_force(constants, work, i, acceleration, elastic):
    """articulated_force[i] = force and moment at the origin of link i for the accelerations of its frame."""
    linear, angular = load_linear_angular(work.acceleration, i)
    outboard = (work.tip_force[0], work.tip_force[1], work.tip_force[2])
    c = load(work.moment, i)
    tangential = cross(angular, c)
    static = cross(c, linear)
    lever = cross(load(work.tip, i), outboard)
    rotary = rotate(work.inertia, i, angular)
    total = work.articulated_force
    for j in range(3):
        total[i, j] = constants.mass[i] * linear[j] + tangential[j] + work.bias[i, j] + outboard[j]
        total[i, 3 + j] = static[j] + rotary[j] + work.bias[i, 3 + j] + work.tip_force[3 + j] + lever[j]
    for a in range(constants.elastic_start[i], constants.elastic_start[i + 1]):
        rate = acceleration[elastic + a]
        for j in range(3):
            total[i, j] += rate * constants.first_moment_shape[a, j]
            total[i, 3 + j] += rate * work.coupling[a, j]


@inner
def elastic_forces(constants, work, i, acceleration, out):
    """The entries of out that belong to the elastic coordinates of link i, for the force at its tip in tip_force."""
    start, square = constants.elastic_start[i], constants.square_start[i]
    k = constants.elastic_start[i + 1] - start
    elastic = len(out) - len(constants.first_moment_shape) + start
    linear, angular = load_linear_angular(work.acceleration, i)
    for a in range(k):
        value = work.elastic_bias[start + a]
        for j in range(3):
            value += linear[j] * constants.first_moment_shape[start + a, j] + angular[j] * work.coupling[start + a, j]
        for j in range(6):
            value += work.tip_shape[start + a, j] * work.tip_force[j]
        for b in range(k):
            value += constants.elastic_mass[square + a * k + b] * acceleration[elastic + b]
        out[elastic + a] = value

"""Forces: what motors, springs, dampers, friction and disturbances apply to the chain, and the power of each."""

import math

from flexman_gym.kernels.compile import inner
from flexman_gym.kernels.lanes import fma, is_zero, select_below
from flexman_gym.kernels.layout import AMPLITUDE, FREQUENCY, OFFSET, PHASE, SLOPE, START, STOP
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
    store,
)


@inner
def evaluate_drive(table, time, out):
    """out (n + 6,) = the drive of a table (7, n + 6) at the time (s); without one (None) out holds it, constant."""
    if table is not None:
        for i in range(len(out)):
            value = table[OFFSET, i]
            if not is_zero(table[SLOPE, i]):
                value += table[SLOPE, i] * time
            if not is_zero(table[AMPLITUDE, i]):
                angle = 2.0 * math.pi * table[FREQUENCY, i] * time + table[PHASE, i]
                value += table[AMPLITUDE, i] * math.sin(angle)
            out[i] = select_below(time, table[START, i], 0.0, select_below(time, table[STOP, i], value, 0.0))


@inner
def applied_forces(constants, work, x, v):
    """work.force (d,) = work.drive with friction, springs and dampers of joints (Eq. 23) and links (Eq. 18).

    Sets work.field and work.tip_force. Needs `velocities`; returns the power supplied (without that of prescribed
    motions) and the power lost (W).
    """
    supplied, lost = motor_forces(constants, work, v)
    lost += structural_forces(constants, work, x, v)
    return supplied + apply_disturbance(constants, work, v), lost


@inner
def motor_forces(constants, work, v):
    """work.force (d,) = the torques of work.drive less friction; returns the power supplied and the power lost (W)."""
    supplied, lost = 0.0, 0.0
    for j in range(len(work.force)):
        work.force[j] = 0.0
    for i in range(len(constants.mass)):
        m = constants.motor[i] if constants.motor[i] >= 0 else i
        friction = constants.viscous_friction[i] * v[m]
        if constants.rubbing[i]:
            friction += constants.coulomb_friction[i] * math.tanh(v[m] / constants.coulomb_rate[i])
        torque = 0.0 if constants.prescribed[i] else work.drive[i]
        work.force[m] = torque - friction
        supplied += torque * v[m]
        lost += friction * v[m]
    return supplied, lost


@inner
def structural_forces(constants, work, x, v):
    """Adds the forces of springs and dampers of joints and links to work.force; returns the power lost (W)."""
    n = len(constants.mass)
    elastic = len(x) - constants.elastic_start[n]
    lost = 0.0
    for i in range(n):
        m = constants.motor[i]
        if m >= 0:
            slip = v[m] - v[i]
            reaction = constants.joint_stiffness[i] * (x[m] - x[i]) + constants.joint_damping[i] * slip
            work.force[i] += reaction
            work.force[m] -= reaction
            lost += constants.joint_damping[i] * slip * slip
    for i in range(n):
        start = constants.elastic_start[i]
        k = constants.elastic_start[i + 1] - start
        first = elastic + start
        for a in range(k):
            row = constants.square_start[i] + a * k
            restoring = 0.0
            drag = 0.0
            for b in range(k):
                restoring = fma(constants.stiffness[row + b], x[first + b], restoring)
                drag = fma(constants.damping[row + b], v[first + b], drag)
            work.force[first + a] -= restoring + drag
            lost = fma(drag, v[first + a], lost)
    return lost


@inner
def secant_friction(constants, work, v):
    """work.friction_slope (n,) = friction torque over motor rate at the speeds v (d,).

    The tangent would vanish wherever the rate is not small, and a large step would jump over the stop and back; with
    the secant it stops there, and the order of a W-method does not depend on it.
    """
    for i in range(len(constants.mass)):
        slope = constants.viscous_friction[i]
        if constants.rubbing[i]:
            part = v[constants.motor[i] if constants.motor[i] >= 0 else i] / constants.coulomb_rate[i]
            steepness = constants.coulomb_friction[i] / constants.coulomb_rate[i]
            # at rest tanh(part) / part is 1 to rounding
            slope += steepness * select_below(part * part, 1e-16, 1.0, math.tanh(part) / part)
        work.friction_slope[i] = slope


@inner
def shift_friction(constants, work, change):
    """Adds to work.force what friction changes by, to first order, for a change (d,) of the speeds."""
    for i in range(len(constants.mass)):
        m = constants.motor[i] if constants.motor[i] >= 0 else i
        work.force[m] -= work.friction_slope[i] * change[m]


@inner
def apply_disturbance(constants, work, v):
    """work.field and work.tip_force from the last six numbers of work.drive; returns the power of both (W)."""
    n = len(constants.mass)
    drive, gravity = work.drive, constants.gravity
    force, base = (drive[n], drive[n + 1], drive[n + 2]), (drive[n + 3], drive[n + 4], drive[n + 5])
    store(work.field, 0, add_scaled((gravity[0], gravity[1], gravity[2]), -1.0, base))
    if not is_zero(dot(force, force)):
        for i in range(n):
            force = apply_transposed(load_matrix(work.rotation, i), force)
    store(work.tip_force, 0, force)
    power = dot(force, load(work.tip_velocity, 0))
    if not is_zero(dot(base, base)):
        power -= dot(base, _momentum(constants, work, v))
    return power


@inner
def _momentum(constants, work, v):
    """Linear momentum of links and payload in the base frame (kg m/s). Needs `velocities`."""
    n = len(constants.mass)
    elastic = len(v) - constants.elastic_start[n]
    total = cross(load(work.payload_spin, 0), load(work.payload_moment, 0))
    total = add_scaled(total, constants.payload_mass[0], load(work.tip_velocity, 0))
    for i in range(n - 1, -1, -1):
        own = add_scaled(ZERO, constants.mass[i], load(work.velocity, i))
        own = add(own, cross(load(work.spin, i), load(work.moment, i)))
        for a in range(constants.elastic_start[i], constants.elastic_start[i + 1]):
            own = add_scaled(own, v[elastic + a], load(work.moment_shape, a))
        total = apply(load_matrix(work.rotation, i), add(total, own))
    return total

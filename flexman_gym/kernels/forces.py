"""Generalised forces of motors, springs, dampers, friction, tip force and base acceleration, and their power."""

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
    """Set out (n + 6,) to the inputs of a drive table (7, n + 6) of `layout` at a time (s); `table` None keeps out."""
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
    """Set work.force (d,) to the generalised forces of motors, friction, springs and dampers at x and v (d,).

    Joints as in Eq. 23, links as in Eq. 18 (see `layout`), with damping. Sets work.field and work.tip_force, too. Call
    `compute_kinematics` before.

    Returns:
        Power (W) supplied, without the power of motors with prescribed motion, and power dissipated.
    """
    supplied, dissipated = _motor_forces(constants, work, v)
    dissipated += _structural_forces(constants, work, x, v)
    return supplied + _apply_disturbance(constants, work, v), dissipated


@inner
def _motor_forces(constants, work, v):
    """Set work.force (d,) to the motor torques minus friction; return the power supplied and dissipated (W)."""
    supplied, dissipated = 0.0, 0.0
    for j in range(len(work.force)):
        work.force[j] = 0.0
    for i in range(len(constants.mass)):
        m = constants.motor[i] if constants.motor[i] >= 0 else i
        friction = constants.viscous_friction[i] * v[m]
        if constants.has_coulomb_friction[i]:
            friction += constants.coulomb_friction[i] * math.tanh(v[m] / constants.coulomb_rate[i])
        torque = 0.0 if constants.prescribed[i] else work.drive[i]
        work.force[m] = torque - friction
        supplied += torque * v[m]
        dissipated += friction * v[m]
    return supplied, dissipated


@inner
def _structural_forces(constants, work, x, v):
    """Add the springs and dampers of joints and links to work.force; return the power dissipated (W)."""
    n = len(constants.mass)
    elastic = len(x) - constants.elastic_start[n]
    dissipated = 0.0
    for i in range(n):
        m = constants.motor[i]
        if m >= 0:
            twist_rate = v[m] - v[i]
            reaction = constants.joint_stiffness[i] * (x[m] - x[i]) + constants.joint_damping[i] * twist_rate
            work.force[i] += reaction
            work.force[m] -= reaction
            dissipated += constants.joint_damping[i] * twist_rate * twist_rate
    for i in range(n):
        start = constants.elastic_start[i]
        k = constants.elastic_start[i + 1] - start
        first = elastic + start
        for a in range(k):
            row = constants.square_start[i] + a * k
            restoring = 0.0
            drag = 0.0
            # a diagonal matrix is multiplied entry by entry
            for b in range(0 if constants.coupled[i] else a, k if constants.coupled[i] else a + 1):
                restoring = fma(constants.stiffness[row + b], x[first + b], restoring)
                drag = fma(constants.damping[row + b], v[first + b], drag)
            work.force[first + a] -= restoring + drag
            dissipated = fma(drag, v[first + a], dissipated)
    return dissipated


@inner
def secant_friction(constants, work, v):
    """Set work.friction_slope (n,) to the friction torque divided by the motor rate, at the speeds v (d,).

    The tangent of Coulomb friction vanishes except at small rates, so that large steps would reverse the motion again
    and again. With the secant, a motor comes to rest; a W-method has its order with any approximate Jacobian.
    """
    for i in range(len(constants.mass)):
        slope = constants.viscous_friction[i]
        if constants.has_coulomb_friction[i]:
            part = v[constants.motor[i] if constants.motor[i] >= 0 else i] / constants.coulomb_rate[i]
            steepness = constants.coulomb_friction[i] / constants.coulomb_rate[i]
            # at rest tanh(part) / part is 1 to rounding
            slope += steepness * select_below(part * part, 1e-16, 1.0, math.tanh(part) / part)
        work.friction_slope[i] = slope


@inner
def _shift_friction(constants, work, change):
    """Add to work.force the first-order change of friction for a change (d,) of the speeds."""
    for i in range(len(constants.mass)):
        m = constants.motor[i] if constants.motor[i] >= 0 else i
        work.force[m] -= work.friction_slope[i] * change[m]


@inner
def stage_forces(constants, work, v, x_implicit, v_implicit, change):
    """Set work.force, work.field and work.tip_force for an implicit stage at speeds v (d,), after `compute_kinematics`.

    Springs and dampers are evaluated at x_implicit and v_implicit (d,), friction at the speeds v + change (d,), to
    first order in the change.
    """
    _motor_forces(constants, work, v)
    _shift_friction(constants, work, change)
    _structural_forces(constants, work, x_implicit, v_implicit)
    _apply_disturbance(constants, work, v)


@inner
def shift_forces(constants, work, x_change, v_change):
    """Add to work.force the first-order change of spring, damper and friction forces for changes (d,) of x and v."""
    _structural_forces(constants, work, x_change, v_change)
    _shift_friction(constants, work, v_change)


@inner
def _apply_disturbance(constants, work, v):
    """Set work.field and work.tip_force from tip force and base acceleration in work.drive; return their power (W)."""
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
    """Return the linear momentum of links and payload in the base frame (kg m/s), after `compute_kinematics`."""
    n = len(constants.mass)
    elastic = len(v) - constants.elastic_start[n]
    total = cross(load(work.payload_spin, 0), load(work.payload_moment, 0))
    total = add_scaled(total, constants.payload_mass[0], load(work.tip_velocity, 0))
    for i in range(n - 1, -1, -1):
        momentum = add_scaled(ZERO, constants.mass[i], load(work.velocity, i))
        momentum = add(momentum, cross(load(work.spin, i), load(work.moment, i)))
        for a in range(constants.elastic_start[i], constants.elastic_start[i + 1]):
            momentum = add_scaled(momentum, v[elastic + a], load(work.moment_shape, a))
        total = apply(load_matrix(work.rotation, i), add(total, momentum))
    return total

"""Generalised forces of motors, springs, dampers, friction, tip force and base acceleration, and their power."""

import math

from flexman_gym.kernels.compile import inner
from flexman_gym.kernels.foundation import base_gravity, evaluate_foundation
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
def evaluate_drive(work, table, time):
    """Set work.drive to the inputs of a drive table of `layout` at a time (s), and to the motion of a rotating base.

    The table None keeps the n + 6 inputs.
    """
    if table is not None:
        for i in range(len(work.motor_torque) + 6):
            value = table[OFFSET, i]
            if not is_zero(table[SLOPE, i]):
                value += table[SLOPE, i] * time
            if not is_zero(table[AMPLITUDE, i]):
                angle = 2.0 * math.pi * table[FREQUENCY, i] * time + table[PHASE, i]
                value += table[AMPLITUDE, i] * math.sin(angle)
            value = select_below(time, table[START, i], 0.0, select_below(time, table[STOP, i], value, 0.0))
            work.drive[i] = value
    evaluate_foundation(work, time)


@inner
def applied_forces(constants, work, x, v):
    """Set work.force (d,) to the generalised forces of motors, friction, springs and dampers at x and v (d,).

    Joints as in Eq. 23, links as in Eq. 18 (see `layout`), with damping. Sets work.field and work.tip_force, too. Call
    `compute_kinematics` before.

    Returns:
        Power (W) supplied, without the power of motors with prescribed motion, and power dissipated.
    """
    supplied, dissipated = _motor_forces(constants, work, x, v)
    dissipated += _structural_forces(constants, work, x, v, True)
    return supplied + _apply_disturbance(constants, work, v), dissipated


@inner
def _motor_forces(constants, work, x, v):
    """Set work.force (d,) to the motor torques minus friction; return the power supplied and dissipated (W).

    Torque ripple is part of the motor torque and of the power supplied.
    """
    supplied, dissipated = 0.0, 0.0
    for j in range(len(work.force)):
        work.force[j] = 0.0
    for i in range(len(constants.mass)):
        m = constants.motor[i] if constants.motor[i] >= 0 else i
        friction = constants.rotor_damping[i] * v[m]
        if constants.has_coulomb_friction[i]:
            friction += _coulomb_torque(constants, i, v[m])
        torque = 0.0 if constants.prescribed[i] else work.drive[i]
        if constants.has_ripple[i] and not constants.prescribed[i]:
            torque += ripple_torque(constants, i, x[m])
        work.force[m] = torque - friction
        supplied += torque * v[m]
        dissipated += friction * v[m]
    return supplied, dissipated


@inner
def _coulomb_torque(constants, i, rate):
    """Return the friction torque (N m) of motor i at a rate (rad/s), without its viscous part.

    With the Coulomb friction c, the width r, the static excess s and the Stribeck rate p, it is
    c tanh(rate / r) (1 + s / (1 + (rate / p)^2)).
    """
    slip = rate / constants.stribeck_rate[i]
    coulomb = constants.coulomb_friction[i] * math.tanh(rate / constants.coulomb_rate[i])
    return coulomb + constants.static_excess[i] * coulomb / (1.0 + slip * slip)


@inner
def ripple_torque(constants, i, angle):
    """Return the torque ripple (N m) of motor i at a motor angle (rad, at the joint)."""
    return constants.ripple_torque[i] * math.sin(constants.ripple_cycles[i] * angle + constants.ripple_phase[i])


@inner
def has_knees(constants, i):
    """Return True if the torque-twist curve of joint i has knees."""
    return constants.knee_start[i + 1] > constants.knee_start[i]


@inner
def _clamp(value, width):
    """Return a value limited to -width and width."""
    return select_below(value, -width, -width, select_below(width, value, width, value))


@inner
def _ramp(value, width):
    """Return a value if above the width, 0 if below -width, and in between a parabola with the same slopes."""
    rounded = _clamp(value, width) + width
    return rounded * rounded / (4.0 * width) + (select_below(value, width, width, value) - width)


@inner
def _ramp_integral(value, width):
    """Return the integral of `_ramp` from -infinity to a value."""
    rounded, above = _clamp(value, width) + width, select_below(value, width, width, value)
    return rounded * rounded * rounded / (12.0 * width) + 0.5 * (above * above - width * width)


@inner
def spring_torque(constants, i, twist):
    """Return the torque (N m) of the spring of joint i at a twist (rad), an odd function.

    The torque-twist curve is linear between its knees. Knee e at the twist a adds the stiffness knee_share[e]
    joint_stiffness beyond a, by a parabola from a - w to a + w with the width w. A first knee at half the backlash has
    no stiffness before it. All terms at a = 0 would make a linear spring.
    """
    if not has_knees(constants, i):
        return constants.joint_stiffness[i] * twist
    share, width = 0.0 * twist, constants.knee_width[i]
    for e in range(constants.knee_start[i], constants.knee_start[i + 1]):
        knee = constants.knee_twist[e]
        share += constants.knee_share[e] * (_ramp(twist - knee, width) - _ramp(-twist - knee, width))
    return constants.joint_stiffness[i] * share


@inner
def spring_slope(constants, i, twist):
    """Return the tangent stiffness (N m/rad) of the spring of joint i at a twist (rad)."""
    if not has_knees(constants, i):
        return constants.joint_stiffness[i]
    share, width = 0.0 * twist, constants.knee_width[i]
    for e in range(constants.knee_start[i], constants.knee_start[i + 1]):
        knee = constants.knee_twist[e]
        rounded = _clamp(twist - knee, width) + _clamp(-twist - knee, width)
        share += constants.knee_share[e] * (rounded + 2.0 * width) / (2.0 * width)
    return constants.joint_stiffness[i] * share


@inner
def spring_energy(constants, i, twist):
    """Return the elastic energy (J) of the spring of joint i at a twist (rad), the integral of its torque."""
    if not has_knees(constants, i):
        return 0.5 * constants.joint_stiffness[i] * twist * twist
    share, width = 0.0 * twist, constants.knee_width[i]
    for e in range(constants.knee_start[i], constants.knee_start[i + 1]):
        knee = constants.knee_twist[e]
        energy = _ramp_integral(twist - knee, width) + _ramp_integral(-twist - knee, width)
        share += constants.knee_share[e] * (energy - 2.0 * _ramp_integral(-knee, width))
    return constants.joint_stiffness[i] * share


@inner
def tangent_springs(constants, work, x):
    """Set work.spring_slope and work.spring_offset (n,) to the tangents of joint springs with knees at x (d,)."""
    for i in range(len(constants.mass)):
        m = constants.motor[i]
        if m >= 0 and has_knees(constants, i):
            twist = x[m] - x[i]
            work.spring_slope[i] = spring_slope(constants, i, twist)
            work.spring_offset[i] = spring_torque(constants, i, twist) - work.spring_slope[i] * twist


@inner
def _structural_forces(constants, work, x, v, exact):
    """Add the springs and dampers of joints and links to work.force; return the power dissipated (W).

    Unless `exact`, joint springs with knees have the torque work.spring_slope times the twist.
    """
    n = len(constants.mass)
    elastic = len(x) - constants.elastic_start[n]
    dissipated = 0.0
    for i in range(n):
        m = constants.motor[i]
        if m >= 0:
            twist, twist_rate = x[m] - x[i], v[m] - v[i]
            if exact or not has_knees(constants, i):
                torque = spring_torque(constants, i, twist)
            else:
                torque = work.spring_slope[i] * twist
            reaction = torque + constants.joint_damping[i] * twist_rate
            work.force[i] += reaction
            work.force[m] -= reaction
            dissipated += constants.joint_damping[i] * twist_rate * twist_rate
        elif constants.passive[i]:
            work.force[i] -= constants.passive_stiffness[i] * x[i]
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
        slope = constants.rotor_damping[i]
        if constants.has_coulomb_friction[i]:
            part = v[constants.motor[i] if constants.motor[i] >= 0 else i] / constants.coulomb_rate[i]
            slip = part * constants.coulomb_rate[i] / constants.stribeck_rate[i]
            steepness = constants.coulomb_friction[i] / constants.coulomb_rate[i]
            steepness += constants.static_excess[i] * steepness / (1.0 + slip * slip)
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
def stage_forces(constants, work, x, v, x_implicit, v_implicit, change):
    """Set work.force, work.field and work.tip_force for an implicit stage at x and v (d,), after `compute_kinematics`.

    Springs and dampers are evaluated at x_implicit and v_implicit (d,), springs with knees by their tangents, friction
    at the speeds v + change (d,), to first order in the change. Torque ripple is that at x.
    """
    _motor_forces(constants, work, x, v)
    _shift_friction(constants, work, change)
    _structural_forces(constants, work, x_implicit, v_implicit, False)
    for i in range(len(constants.mass)):
        if constants.motor[i] >= 0 and has_knees(constants, i):
            work.force[i] += work.spring_offset[i]
            work.force[constants.motor[i]] -= work.spring_offset[i]
    _apply_disturbance(constants, work, v)


@inner
def shift_forces(constants, work, x_change, v_change):
    """Add to work.force the first-order change of spring, damper and friction forces for changes (d,) of x and v."""
    _structural_forces(constants, work, x_change, v_change, False)
    _shift_friction(constants, work, v_change)


@inner
def _apply_disturbance(constants, work, v):
    """Set work.field and work.tip_force from tip force and base acceleration in work.drive; return their power (W)."""
    n = len(constants.mass)
    drive, gravity = work.drive, base_gravity(constants, work)
    force, base = (drive[n], drive[n + 1], drive[n + 2]), (drive[n + 3], drive[n + 4], drive[n + 5])
    store(work.field, 0, add_scaled(gravity, -1.0, base))
    if not _vanishes(force):
        for i in range(n):
            force = apply_transposed(load_matrix(work.rotation, i), force)
    store(work.tip_force, 0, force)
    power = dot(force, load(work.tip_velocity, 0))
    if not _vanishes(base):
        power -= dot(base, _momentum(constants, work, v))
    return power


@inner
def _vanishes(vector):
    """Return True if a vector (3,) is zero, with its derivatives, which a product with itself would omit."""
    return is_zero(vector[0]) and is_zero(vector[1]) and is_zero(vector[2])


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

"""Joints: how a joint, with its rotor, spring, friction or prescribed motion, is eliminated from the recursion.

A rotor is accelerated by its motor alone (Eq. 23), or, where its inertia is carried, spins as a body in the frame that
carries its joint: with the angular velocity w of that frame, along the axis a, its energy is J (a . w + rate)^2 / 2,
and the frame feels what that demands. `total` below is the rotor with its implicit spring and friction; eliminated, it
leaves the three numbers `joint`, `mixed` and `frame` that joint and frame see.
"""

from flexman_gym.kernels.compile import inner
from flexman_gym.kernels.lanes import vanishes
from flexman_gym.kernels.linalg import (
    ZERO,
    add,
    add_scaled,
    apply,
    apply_inertia,
    dot,
    load,
    load_matrix,
    load_pair,
    store_pair,
    subtract_outer,
)


@inner
def eliminate_joint(constants, work, i, shift, inertia):
    """What is left of an inertia when joint i, with its rotor and spring, is free, or moves as prescribed."""
    force, mixed_block, moment = inertia
    axis, rotor, carried = load(constants.axis, i), constants.rotor_inertia[i], constants.carried_inertia[i]
    total = rotor + shift[0] * work.friction_slope[i]
    spring, joint, mixed, frame = 0.0, total, carried, carried
    if constants.motor[i] >= 0:
        spring = shift[0] * constants.joint_damping[i] + shift[1] * constants.joint_stiffness[i]
        if constants.prescribed[i]:
            joint, mixed = spring, 0.0
        else:
            joint = spring * total / (total + spring)
            total += spring
            mixed, frame = spring * carried / total, carried * (total - carried) / total
    work.spring[i], work.motor_inertia[i] = spring, total
    linear, angular = apply(mixed_block, axis), apply(moment, axis)
    pivot = joint + dot(axis, angular)
    angular = add_scaled(angular, mixed, axis)
    work.joint_pivot[i] = pivot
    store_pair(work.joint_column, i, linear, angular)
    if not vanishes(frame):
        moment = subtract_outer(moment, add_scaled(ZERO, -frame, axis), axis)
    if constants.prescribed[i] and constants.motor[i] < 0:
        return force, mixed_block, moment
    scaled, turned = add_scaled(ZERO, 1.0 / pivot, linear), add_scaled(ZERO, 1.0 / pivot, angular)
    force, mixed_block = subtract_outer(force, scaled, linear), subtract_outer(mixed_block, scaled, angular)
    return force, mixed_block, subtract_outer(moment, turned, angular)


@inner
def free_joint(constants, work, i, total, bias):
    """Force and moment that joint i passes on when it is free and its near side has the bias acceleration."""
    axis, angular_bias = load(constants.axis, i), load(work.joint_bias, i)
    torque, given, pushed = work.force[i] - dot(axis, total[1]), work.drive[i], 0.0
    m = constants.motor[i]
    if m >= 0:
        push = work.force[m] / work.motor_inertia[i]
        if constants.prescribed[i]:
            push = given
        torque += work.spring[i] * push
        pushed = constants.carried_inertia[i] * push
    work.joint_force[i] = torque
    share = torque / work.joint_pivot[i]
    if m < 0 and constants.prescribed[i]:
        share = given
    linear, angular = load_pair(work.joint_column, i)
    blocks, j = work.articulated, 3 * i
    inertia = load_matrix(blocks, j), load_matrix(blocks, j + 1), load_matrix(blocks, j + 2)
    if i == 0:
        bias = (ZERO, ZERO)  # the base does not move by itself
    force, moment = apply_inertia(inertia, (bias[0], add(bias[1], angular_bias)))
    moment = add(add_scaled(moment, pushed, axis), load(work.rotor_bias, i))
    return add(add_scaled(total[0], share, linear), force), add(add_scaled(total[1], share, angular), moment)


@inner
def joint_acceleration(constants, work, i, frame, out):
    """Acceleration of joint i, returned too, and of its motor, for that of the frame without the joint's share.

    work.motor_torque[i] is the torque that a prescribed motion takes, with spring and friction after the shift.
    """
    linear, angular = load_pair(work.joint_column, i)
    m, torque = constants.motor[i], work.joint_force[i] - dot(linear, frame[0]) - dot(angular, frame[1])
    value = torque / work.joint_pivot[i]
    if m < 0:
        if constants.prescribed[i]:
            value = work.drive[i]
            work.motor_torque[i] = work.joint_pivot[i] * value - torque
        out[i] = value
        return value
    out[i] = value
    carried = constants.carried_inertia[i] * dot(load(constants.axis, i), frame[1])
    if constants.prescribed[i]:
        out[m] = work.drive[i]
        reaction = work.spring[i] * (out[m] - value)
        work.motor_torque[i] = work.motor_inertia[i] * out[m] + carried - work.force[m] + reaction
    else:
        out[m] = (work.force[m] + work.spring[i] * value - carried) / work.motor_inertia[i]
    return value


@inner
def any_prescribed(constants):
    """Whether the motion of any motor is prescribed."""
    for i in range(len(constants.prescribed)):
        if constants.prescribed[i]:
            return True
    return False


@inner
def prescribed_power(constants, work, v):
    """Power (W) of the motors whose motion is prescribed, after a solution without shift."""
    power = 0.0
    for i in range(len(constants.mass)):
        if constants.prescribed[i]:
            m = constants.motor[i]
            power += work.motor_torque[i] * v[m if m >= 0 else i]
    return power


@inner
def rotor_push(constants, i, angular, acceleration):
    """Change of the angular momentum of carried rotor i, for its joint frame's acceleration and those of x (d,)."""
    m = constants.motor[i]
    rate = acceleration[m] if m >= 0 else acceleration[i]
    return constants.carried_inertia[i] * (rate + dot(load(constants.axis, i), angular) - acceleration[i])

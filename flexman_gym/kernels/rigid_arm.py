"""Kinematics of the rigid arm, whose joints turn by the motor angles: tip position, and inverse kinematics."""

import math

from flexman_gym.kernels.arguments import field
from flexman_gym.kernels.compile import inner, kernel
from flexman_gym.kernels.linalg import (
    IDENTITY,
    ZERO,
    add,
    add_scaled,
    apply,
    cross,
    dot,
    load,
    load_matrix,
    product,
    rotation_matrix,
    sine_versine,
    store,
)

MAX_ITERATIONS = 8  # largest number of Newton iterations
MAX_TURN, DIFFERENCE_STEP = 0.5, 1e-7  # rad; largest change of a motor angle in an iteration; step of differences


@inner
def rigid_tip(constants, x, v):
    """Return tip position (m) and velocity (m/s), in the base frame, of the rigid arm at coordinates x, v (d,)."""
    frame = IDENTITY
    origin = velocity = spin = ZERO
    for i in range(len(constants.mass)):
        m = constants.motor[i] if constants.motor[i] >= 0 else i
        axis = load(constants.axis, i)
        sine, versine = sine_versine(x[m])
        turned = product(load_matrix(constants.mount, i), rotation_matrix(sine, versine, axis))
        frame = product(frame, turned)
        spin = add_scaled(spin, v[m], apply(frame, axis))
        arm = apply(frame, (constants.length[i], 0.0, 0.0))
        origin, velocity = add(origin, arm), add(velocity, cross(spin, arm))
    return origin, velocity


@kernel
def rigid_tips(constants, states, out):
    """Set out (r, 3) to the tips (m, base frame) of the rigid arm at the motor angles of states (r, 2 d)."""
    states, out = field(states), field(out)
    d = states.shape[1] // 2
    for r in range(len(states)):
        store(out, r, rigid_tip(constants, states[r, :d], states[r, d:])[0])


@kernel
def inverse_kinematics(constants, targets, x, jacobian, accuracy, damping, out):
    """Set out (r, n) to motor angles at which the tip of the rigid arm is at the targets, by damped Newton iterations.

    For a redundant arm, an iteration takes the smallest change of the angles.

    Args:
        constants: constants of the model.
        targets: (r, 3) target positions, m, base frame.
        x: (d,) coordinates, overwritten.
        jacobian: (n, 3) derivatives of the tip position, m/rad, overwritten.
        accuracy: distance from the target at which the iteration ends, m.
        damping: damping of the Newton iteration, m/rad; singular values of the Jacobian below it are suppressed.
        out: (r, n) motor angles, rad; first guess, overwritten by the solution.

    Returns:
        The largest distance between tip and target at the end, m.
    """
    n, largest = len(constants.mass), 0.0
    for r in range(len(targets)):
        distance = 2.0 * accuracy
        for _ in range(MAX_ITERATIONS):
            tip = _turned_tip(constants, out, r, -1, x)
            missing = (targets[r, 0] - tip[0], targets[r, 1] - tip[1], targets[r, 2] - tip[2])
            distance = math.sqrt(dot(missing, missing))
            if not distance > accuracy:
                break
            rows = ((damping * damping, 0.0, 0.0), (0.0, damping * damping, 0.0), (0.0, 0.0, damping * damping))
            for i in range(n):
                moved = _turned_tip(constants, out, r, i, x)
                column = (
                    (moved[0] - tip[0]) / DIFFERENCE_STEP,
                    (moved[1] - tip[1]) / DIFFERENCE_STEP,
                    (moved[2] - tip[2]) / DIFFERENCE_STEP,
                )
                jacobian[i, 0], jacobian[i, 1], jacobian[i, 2] = column
                rows = (
                    add_scaled(rows[0], column[0], column),
                    add_scaled(rows[1], column[1], column),
                    add_scaled(rows[2], column[2], column),
                )
            direction = _solve_cramer(rows, missing)
            for i in range(n):
                turn = jacobian[i, 0] * direction[0] + jacobian[i, 1] * direction[1] + jacobian[i, 2] * direction[2]
                out[r, i] += min(max(turn, -MAX_TURN), MAX_TURN)
        largest = max(largest, distance)
    return largest


@inner
def _turned_tip(constants, angles, r, turned, x):
    """Return the tip (3,), m, at row r of motor angles (rad), with the angle of index `turned` increased by a step.

    The step is DIFFERENCE_STEP; -1 increases no angle.
    """
    for i in range(len(constants.mass)):
        m = constants.motor[i] if constants.motor[i] >= 0 else i
        x[m] = angles[r, i]
        if i == turned:
            x[m] += DIFFERENCE_STEP
    return rigid_tip(constants, x, x)[0]


@inner
def _solve_cramer(rows, vector):
    """Return the solution of three linear equations by Cramer's rule."""
    a, b, c = cross(rows[1], rows[2]), cross(rows[2], rows[0]), cross(rows[0], rows[1])
    scale = 1.0 / dot(rows[0], a)
    out = add_scaled(ZERO, vector[0] * scale, a)
    return add_scaled(add_scaled(out, vector[1] * scale, b), vector[2] * scale, c)

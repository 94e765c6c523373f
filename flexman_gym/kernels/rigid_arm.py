"""Kinematics of the rigid arm: its tip at given motor angles, and the motor angles that bring it to a place."""

import math

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

MAX_ITERATIONS = 8  # of Newton's method
MAX_TURN, DIFFERENCE_STEP = 0.5, 1e-7  # rad, at most in an iteration; of differences


@inner
def rigid_tip(constants, x, v):
    """Tip position and velocity, in the base frame, of the rigid arm at the motor angles and rates."""
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
    """out (r, 3) = tips, in the base frame, of the rigid arm at the motor angles of states (r, 2 d)."""
    d = states.shape[1] // 2
    for r in range(len(states)):
        store(out, r, rigid_tip(constants, states[r, :d], states[r, d:])[0])


@kernel
def inverse_kinematics(constants, wanted, x, slopes, accuracy, damping, out):
    """out (r, n) = motor angles at which the tip of the rigid arm is at places wanted (r, 3), by Newton's method.

    It starts from what `out` holds, and turns least of all where a joint is more than the tip needs; slopes below the
    damping (m) turn nothing. Overwrites x (d,) and slopes (n, 3); returns the largest distance that is left (m).
    """
    n, left = len(constants.mass), 0.0
    for r in range(len(wanted)):
        far = 2.0 * accuracy
        for _ in range(MAX_ITERATIONS):
            tip = _turned_tip(constants, out, r, -1, x)
            missing = (wanted[r, 0] - tip[0], wanted[r, 1] - tip[1], wanted[r, 2] - tip[2])
            far = math.sqrt(dot(missing, missing))
            if not far > accuracy:
                break
            rows = ((damping * damping, 0.0, 0.0), (0.0, damping * damping, 0.0), (0.0, 0.0, damping * damping))
            for i in range(n):
                moved = _turned_tip(constants, out, r, i, x)
                slope = (
                    (moved[0] - tip[0]) / DIFFERENCE_STEP,
                    (moved[1] - tip[1]) / DIFFERENCE_STEP,
                    (moved[2] - tip[2]) / DIFFERENCE_STEP,
                )
                slopes[i, 0], slopes[i, 1], slopes[i, 2] = slope
                rows = (
                    add_scaled(rows[0], slope[0], slope),
                    add_scaled(rows[1], slope[1], slope),
                    add_scaled(rows[2], slope[2], slope),
                )
            way = _solve_cramer(rows, missing)
            for i in range(n):
                turn = slopes[i, 0] * way[0] + slopes[i, 1] * way[1] + slopes[i, 2] * way[2]
                out[r, i] += min(max(turn, -MAX_TURN), MAX_TURN)
        left = max(left, far)
    return left


@inner
def _turned_tip(constants, angles, r, turned, x):
    """Tip of the rigid arm at row r of angles (r, n), one motor turned by STEP more (-1: none); overwrites x (d,)."""
    for i in range(len(constants.mass)):
        m = constants.motor[i] if constants.motor[i] >= 0 else i
        x[m] = angles[r, i]
        if i == turned:
            x[m] += DIFFERENCE_STEP
    return rigid_tip(constants, x, x)[0]


@inner
def _solve_cramer(rows, right):
    """The solution of three equations, by Cramer's rule."""
    a, b, c = cross(rows[1], rows[2]), cross(rows[2], rows[0]), cross(rows[0], rows[1])
    scale = 1.0 / dot(rows[0], a)
    out = add_scaled(ZERO, right[0] * scale, a)
    return add_scaled(add_scaled(out, right[1] * scale, b), right[2] * scale, c)

"""Prescribed rotation of the base: its polynomials of time, see `layout`, and what they are at a time.

The base frame has the attitude A, the rotation from the base frame to the world frame, given by a unit quaternion p
(scalar first). With angular velocity w and angular acceleration in the base frame, p' = p (0, w) / 2, and gravity in
the base frame, g = A^T g_world, has the rate g x w: their Taylor coefficients follow from those of w one after the
other. Speeds of an arm remain those of its joints; its velocities and kinetic energy are in a frame with the origin of
the base and the axes of the world.
"""

import math

from flexman_gym.kernels.compile import inner, kernel
from flexman_gym.kernels.lanes import fma
from flexman_gym.kernels.layout import FOUNDATION_COLUMNS, FOUNDATION_DEGREE, FOUNDATION_PART
from flexman_gym.kernels.linalg import ZERO


@inner
def load_foundation(work, table):
    """Set work.foundation to the foundation row in the last columns of a drive table of `layout`."""
    first = len(work.motor_torque) + 6
    for j in range(len(work.foundation)):
        work.foundation[j] = table[j // FOUNDATION_COLUMNS, first + j % FOUNDATION_COLUMNS]


@inner
def evaluate_foundation(work, time):
    """Set the last 9 numbers of work.drive to the motion of a rotating base at a time (s)."""
    if len(work.foundation) > 0:
        _evaluate_polynomials(work, time - work.foundation[0])


@inner
def evaluate_foundation_end(work):
    """Set the last 9 numbers of work.drive to the motion of a rotating base at the end of its interval."""
    if len(work.foundation) > 0:
        _evaluate_polynomials(work, work.foundation[1])


@inner
def _evaluate_polynomials(work, time):
    """Set gravity, angular velocity and angular acceleration in work.drive at a time after the start (s)."""
    row, first = work.foundation, len(work.motor_torque) + 6
    for j in range(6):
        end = 1 + (j + 1) * FOUNDATION_PART
        value, slope = row[end], 0.0 * row[end]
        for k in range(1, FOUNDATION_PART):
            slope = fma(slope, time, value)
            value = fma(value, time, row[end - k])
        work.drive[first + j] = value
        if j >= 3:
            work.drive[first + 3 + j] = slope


@inner
def base_gravity(constants, work):
    """Return the acceleration of gravity in the base frame (m/s^2)."""
    gravity, first = constants.gravity, len(constants.mass) + 6
    if constants.rotating[0]:
        return work.drive[first], work.drive[first + 1], work.drive[first + 2]
    return gravity[0], gravity[1], gravity[2]


@inner
def base_spin(constants, work):
    """Return the angular velocity of the base in the base frame (rad/s)."""
    first = len(constants.mass) + 9
    if constants.rotating[0]:
        return work.drive[first], work.drive[first + 1], work.drive[first + 2]
    return ZERO


@inner
def base_spin_rate(constants, work):
    """Return the angular acceleration of the base in the base frame (rad/s^2)."""
    first = len(constants.mass) + 12
    if constants.rotating[0]:
        return work.drive[first], work.drive[first + 1], work.drive[first + 2]
    return ZERO


@kernel
def turn_foundation(attitudes, rates, accelerations, gravity, span, rows, series):
    """Set the foundation rows of b bases, and advance their attitudes and angular velocities to the end of an interval.

    Args:
        attitudes: (b, 4) unit quaternions, base frame to world frame, overwritten.
        rates: (b, 3) angular velocities, base frame, rad/s, overwritten.
        accelerations: (b, 3, FOUNDATION_DEGREE) Taylor coefficients of the angular accelerations at the start.
        gravity: (3,) acceleration of gravity, world frame, m/s^2.
        span: length of the interval, s; written in rows[:, 1]. rows[:, 0], the start, does not change.
        rows: (b, FOUNDATION) foundation rows, overwritten.
        series: (4, FOUNDATION_PART) scratch array.
    """
    for b in range(len(rows)):
        row, q = rows[b], attitudes[b]
        row[1] = span
        for j in range(3):
            at = 2 + (3 + j) * FOUNDATION_PART
            row[at] = rates[b, j]
            for k in range(FOUNDATION_DEGREE):
                row[at + k + 1] = accelerations[b, j, k] / (k + 1.0)
            row[2 + j * FOUNDATION_PART] = _turned_gravity(q, gravity, j)
        for k in range(FOUNDATION_DEGREE):
            for j in range(3):
                total, one, two = 0.0, (j + 1) % 3, (j + 2) % 3
                for m in range(k + 1):
                    g, w = 2 + k - m, 2 + 3 * FOUNDATION_PART + m
                    total += row[g + one * FOUNDATION_PART] * row[w + two * FOUNDATION_PART]
                    total -= row[g + two * FOUNDATION_PART] * row[w + one * FOUNDATION_PART]
                row[2 + j * FOUNDATION_PART + k + 1] = total / (k + 1.0)
        _advance_attitude(row, q, span, series)
        for j in range(3):
            at, value = 2 + (3 + j) * FOUNDATION_PART, 0.0
            for k in range(FOUNDATION_DEGREE, -1, -1):
                value = value * span + row[at + k]
            rates[b, j] = value


@inner
def _turned_gravity(q, gravity, j):
    """Return component j of gravity (3,) of the world frame in a base frame of attitude q (4,)."""
    one, two = (j + 1) % 3, (j + 2) % 3
    s, a, b, c = q[0], q[1 + j], q[1 + one], q[1 + two]
    value = (s * s + a * a - b * b - c * c) * gravity[j]
    return value + 2.0 * ((a * b + s * c) * gravity[one] + (a * c - s * b) * gravity[two])


@inner
def _advance_attitude(row, q, span, series):
    """Advance a unit quaternion q (4,) over the interval of a foundation row, by its Taylor series.

    `series` (4, FOUNDATION_PART) is overwritten by the coefficients.
    """
    spin = 2 + 3 * FOUNDATION_PART
    for i in range(4):
        series[i, 0] = q[i]
    for k in range(FOUNDATION_DEGREE):
        for i in range(4):
            series[i, k + 1] = 0.0
        for m in range(k + 1):
            s, x, y, z = series[0, k - m], series[1, k - m], series[2, k - m], series[3, k - m]
            a, b, c = row[spin + m], row[spin + FOUNDATION_PART + m], row[spin + 2 * FOUNDATION_PART + m]
            series[0, k + 1] -= x * a + y * b + z * c
            series[1, k + 1] += s * a + y * c - z * b
            series[2, k + 1] += s * b + z * a - x * c
            series[3, k + 1] += s * c + x * b - y * a
        for i in range(4):
            series[i, k + 1] *= 0.5 / (k + 1.0)
    square = 0.0
    for i in range(4):
        value = 0.0
        for k in range(FOUNDATION_DEGREE, -1, -1):
            value = value * span + series[i, k]
        q[i] = value
        square += value * value
    for i in range(4):
        q[i] /= math.sqrt(square)

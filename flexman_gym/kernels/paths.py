"""Paths: Fourier series of many arms at once, and the motor angles with which a rigid arm reaches places."""

import math

from flexman_gym.kernels.compile import inner, kernel
from flexman_gym.kernels.lanes import fma
from flexman_gym.kernels.linalg import ZERO, add_scaled, cross, dot
from flexman_gym.kernels.outputs import rigid_tip

ITERATIONS = 8  # of Newton's method
TURN, STEP = 0.5, 1e-7  # rad, at most in an iteration; of differences


@kernel
def fourier_series(series, phases, out):
    """out (r, p, s) = Fourier series (r, s, 2 h + 1) at phases (r, p): mean, then cosine and sine of each harmonic."""
    for r in range(phases.shape[0]):
        for p in range(phases.shape[1]):
            first, second = math.cos(phases[r, p]), math.sin(phases[r, p])
            for s in range(series.shape[1]):
                cosine, sine = first, second
                value = series[r, s, 0]
                for h in range(1, series.shape[2], 2):
                    value = fma(series[r, s, h], cosine, fma(series[r, s, h + 1], sine, value))
                    cosine, sine = cosine * first - sine * second, sine * first + cosine * second
                out[r, p, s] = value


@kernel
def inverse_kinematics(constants, wanted, x, slopes, accuracy, damping, out):
    """out (r, n) = motor angles at which the tip of the rigid arm is at places wanted (r, 3), by Newton's method.

    It starts from what `out` holds, and turns least of all where a joint is more than the tip needs; slopes below the
    damping (m) turn nothing. Overwrites x (d,) and slopes (n, 3); returns the largest distance that is left (m).
    """
    n, left = len(constants.mass), 0.0
    for r in range(len(wanted)):
        far = 2.0 * accuracy
        for _ in range(ITERATIONS):
            tip = _turned_tip(constants, out, r, -1, x)
            missing = (wanted[r, 0] - tip[0], wanted[r, 1] - tip[1], wanted[r, 2] - tip[2])
            far = math.sqrt(dot(missing, missing))
            if not far > accuracy:
                break
            rows = ((damping * damping, 0.0, 0.0), (0.0, damping * damping, 0.0), (0.0, 0.0, damping * damping))
            for i in range(n):
                moved = _turned_tip(constants, out, r, i, x)
                slope = ((moved[0] - tip[0]) / STEP, (moved[1] - tip[1]) / STEP, (moved[2] - tip[2]) / STEP)
                slopes[i, 0], slopes[i, 1], slopes[i, 2] = slope
                rows = (
                    add_scaled(rows[0], slope[0], slope),
                    add_scaled(rows[1], slope[1], slope),
                    add_scaled(rows[2], slope[2], slope),
                )
            way = _solve_cramer(rows, missing)
            for i in range(n):
                turn = slopes[i, 0] * way[0] + slopes[i, 1] * way[1] + slopes[i, 2] * way[2]
                out[r, i] += min(max(turn, -TURN), TURN)
        left = max(left, far)
    return left


@inner
def _turned_tip(constants, angles, r, turned, x):
    """Tip of the rigid arm at row r of angles (r, n), one motor turned by STEP more (-1: none); overwrites x (d,)."""
    for i in range(len(constants.mass)):
        m = constants.motor[i] if constants.motor[i] >= 0 else i
        x[m] = angles[r, i]
        if i == turned:
            x[m] += STEP
    return rigid_tip(constants, x, x)[0]


@inner
def _solve_cramer(rows, right):
    """The solution of three equations, by Cramer's rule."""
    a, b, c = cross(rows[1], rows[2]), cross(rows[2], rows[0]), cross(rows[0], rows[1])
    scale = 1.0 / dot(rows[0], a)
    out = add_scaled(ZERO, right[0] * scale, a)
    return add_scaled(add_scaled(out, right[1] * scale, b), right[2] * scale, c)

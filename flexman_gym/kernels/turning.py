"""Turning: sine and versine of angles, of one arm and of several with the same bits.

The mathematical library knows single numbers only: it took half the time of all positions of several arms abreast, and
its last digits are those of the machine's library.
"""

from flexman_gym.kernels.compile import inner
from flexman_gym.kernels.lanes import fused

HALF_TURN, HALF_TURN_REST = 3.141592653589793, 1.2246467991473532e-16  # pi and what its last digit leaves
ROUNDING = 1.5 * 2.0**52  # added and taken away again it rounds to a whole number


@inner
def sine_versine(angle):
    """The sine and 1 - cosine of an angle (rad) up to 1e6, each within 4e-16; small versines keep their digits."""
    turns = (angle * (1.0 / HALF_TURN) + ROUNDING) - ROUNDING
    odd = turns - 2.0 * ((0.5 * turns + ROUNDING) - ROUNDING)  # -1, 0 or 1
    odd = odd * odd
    rest = fused(-turns, HALF_TURN_REST, fused(-turns, HALF_TURN, angle))
    z = rest * rest
    # Taylor's series to rounding at a quarter turn
    sine = fused(z, 1 / 51090942171709440000, -1 / 121645100408832000)
    sine = fused(z, fused(z, sine, 1 / 355687428096000), -1 / 1307674368000)
    sine = fused(z, fused(z, sine, 1 / 6227020800), -1 / 39916800)
    sine = fused(z, fused(z, sine, 1 / 362880), -1 / 5040)
    sine = fused(z, fused(z, sine, 1 / 120), -1 / 6)
    sine = fused(rest * z, sine, rest)
    versine = fused(z, 1 / 1124000727777607680000, -1 / 2432902008176640000)
    versine = fused(z, fused(z, versine, 1 / 6402373705728000), -1 / 20922789888000)
    versine = fused(z, fused(z, versine, 1 / 87178291200), -1 / 479001600)
    versine = fused(z, fused(z, versine, 1 / 3628800), -1 / 40320)
    versine = fused(z, fused(z, versine, 1 / 720), -1 / 24)
    versine = z * fused(z, versine, 0.5)
    sign = 1.0 - 2.0 * odd
    return sign * sine, fused(sign, versine, 2.0 * odd)

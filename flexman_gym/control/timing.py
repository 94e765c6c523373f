"""Timing: how far along a path a motion is at each time, from rest or from a motion that goes on."""

import numpy as np

from flexman_gym.arrays import Array


def quintic(place: Array, speed: Array, change: Array, durations: Array) -> Array:
    """Gives coefficients (..., 6), lowest power first, of the polynomial in time that comes to rest at place 1.

    Between rests it is the minimum-jerk motion (Flash and Hogan, Journal of Neuroscience 5, 1985, 1688).

    Args:
        place, speed, change: where it starts, how fast (1/s), and second derivative there (1/s^2).
        durations: s.
    """
    left, squared = 1.0 - place, durations**2
    cubic = (20.0 * left - 12.0 * speed * durations - 3.0 * change * squared) / (2.0 * durations**3)
    fourth = (-30.0 * left + 16.0 * speed * durations + 3.0 * change * squared) / (2.0 * durations**4)
    fifth = (12.0 * left - 6.0 * speed * durations - change * squared) / (2.0 * durations**5)
    result: Array = np.stack(np.broadcast_arrays(place, speed, 0.5 * change, cubic, fourth, fifth), axis=-1)
    return result


def values_at(coefficients: Array, times: Array) -> tuple[Array, Array, Array]:
    """Gives place, speed (1/s) and second derivative (1/s^2) of polynomials (..., 6) at times (...) s."""
    a, b, c, d, e, f = np.moveaxis(coefficients, -1, 0)
    place = a + times * (b + times * (c + times * (d + times * (e + times * f))))
    speed = b + times * (2.0 * c + times * (3.0 * d + times * (4.0 * e + times * 5.0 * f)))
    return place, speed, 2.0 * c + times * (6.0 * d + times * (12.0 * e + times * 20.0 * f))

"""Timing: how far along a path a motion is at each time, from rest or from a motion that goes on."""

from typing import NamedTuple

import numpy as np

from flexman_gym.arrays import Array, IntArray
from flexman_gym.checks import physical


class Motion(NamedTuple):
    """A motion from rest to rest whose place is a polynomial of time in each of k phases.

    Attributes:
        begins: (k,) s, of the phases.
        coefficients: (k, 6), lowest power of the time since a phase began first.
        duration: s.
    """

    begins: Array
    coefficients: Array
    duration: float

    def at(self, times: Array) -> tuple[Array, Array, Array]:
        """Gives place, speed (1/s) and acceleration (1/s^2) at times (T,) s; it rests before and after."""
        inside = np.clip(times, 0.0, self.duration)
        phases: IntArray = np.searchsorted(self.begins, inside, side="right") - 1
        place, speed, acceleration = values_at(self.coefficients[phases], inside - self.begins[phases])
        return place, speed, np.where(inside == times, acceleration, 0.0)


def trapezoid(way: float, speed: float, acceleration: float) -> Motion:
    """Gives the quickest motion over a way within limits of speed (1/s) and acceleration (1/s^2).

    Biagiotti and Melchiorri, Trajectory planning for automatic machines and robots, 2008, section 3.2.

    Raises:
        ValueError: for what is no number from 1e-30 to 1e30.
    """
    limits = physical("speed", speed, "1/s"), physical("acceleration", acceleration, "1/s^2"), np.inf
    return _phased(physical("way", way), *limits)


def double_s(way: float, speed: float, acceleration: float, jerk: float) -> Motion:
    """Gives the double S over a way: also within a limit of jerk (1/s^3).

    Biagiotti and Melchiorri, Trajectory planning for automatic machines and robots, 2008, section 3.4.

    Raises:
        ValueError: for what is no number from 1e-30 to 1e30.
    """
    limits = physical("speed", speed, "1/s"), physical("acceleration", acceleration, "1/s^2")
    return _phased(physical("way", way), *limits, physical("jerk", jerk, "1/s^3"))


def quintic(place: Array, speed: Array, change: Array, durations: Array) -> Array:
    """Gives coefficients (..., 6), lowest power first, of the polynomial in time that comes to rest at place 1.

    Between rests it is the minimum-jerk motion (Flash and Hogan, Journal of Neuroscience 5, 1985, 1688).

    Args:
        place: where it starts.
        speed: how fast it starts, 1/s.
        change: second derivative there, 1/s^2.
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


def _phased(way: float, speed: float, acceleration: float, jerk: float) -> Motion:
    """Seven phases of constant jerk, less those that take no time; where jerk is infinite, acceleration jumps."""
    most = min(acceleration, np.sqrt(speed * jerk))
    gaining = most / jerk + speed / most  # s, of speed
    steady = way / speed - gaining
    if steady < 0.0:  # the speed is not reached
        most, steady = min(acceleration, np.cbrt(0.5 * way * jerk**2)), 0.0
        gaining = 0.5 * most / jerk + np.sqrt((0.5 * most / jerk) ** 2 + way / most)
    ramp = most / jerk
    full = max(gaining - 2.0 * ramp, 0.0)
    lasting = np.array([ramp, full, ramp, steady, ramp, full, ramp])
    first, last = most * np.array([[0, 1, 1, 0, 0, -1, -1], [1, 1, 0, 0, -1, -1, 0]])
    first, last, lasting = (each[lasting > 0.0] for each in (first, last, lasting))
    begins, coefficients = np.cumsum(lasting) - lasting, np.zeros((len(lasting), 6))
    coefficients[:, 2], coefficients[:, 3] = first / 2.0, (last - first) / (6.0 * lasting)
    for before, after, time in zip(coefficients[:-1], coefficients[1:], lasting[:-1], strict=True):
        after[0], after[1], _ = values_at(before, time)
    return Motion(begins, coefficients, float(lasting.sum()))


LAWS = {  # of slews from 0 to 1 in a duration of 1; the phases of each last as long as each other
    "minimum-jerk": Motion(np.zeros(1), quintic(*np.array([[0.0], [0.0], [0.0], [1.0]])), 1.0),
    "trapezoid": trapezoid(1.0, 1.5, 4.5),
    "double-s": double_s(1.0, 1.75, 6.125, 42.875),
}


def minimum_jerk(parts: Array) -> tuple[Array, Array, Array]:
    """Gives position, speed and acceleration of the minimum-jerk motion from 0 to 1 at parts (T,) of its duration."""
    return LAWS["minimum-jerk"].at(parts)

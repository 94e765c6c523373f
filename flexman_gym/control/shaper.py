"""Shaper: impulses that, convolved with a command, leave no vibration of a mode.

A shaper delays: its last impulse comes 0.5 (ZV), 0.75 (MZV), 1 (ZVD, EI) or 1.5 (two-hump EI) periods of the mode after
the first. With its motors held, the lowest mode of `FlexRRR-v0` is at about 0.3 Hz: that is 1.5 to 4.6 s.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from flexman_gym.arrays import Array
from flexman_gym.checks import non_negative, one_of, physical, positive, refusal

TOLERANCE = 0.05  # residual that EI shapers allow
ROUNDS = 8  # for the parameter of an EI shaper; its error falls to less than a tenth in each
ROOT = np.sqrt(2.0)


def _two_hump(v: float) -> tuple[float, ...]:
    x = (v**2 * (np.sqrt(1.0 - v**2) + 1.0)) ** (1.0 / 3.0)
    outer = (3.0 * x**2 + 2.0 * x + 3.0 * v**2) / (16.0 * x)
    return outer, 0.5 - outer, 0.5 - outer, outer


# Name: periods of the mode between two impulses, and their amplitudes without damping for a tolerated residual.
# ZV and ZVD: Singer and Seering, J. of Dynamic Systems, Measurement, and Control 112 (1990), 76. EI: Singhose, Seering
# and Singer, J. of Mechanical Design 116 (1994), 654. Two-hump EI: Singhose, Porter, Tuttle and Singer, J. of Dynamic
# Systems, Measurement, and Control 119 (1997), 320. MZV: three impulses in three quarters of a period, as in printers
# (Klipper); Vaughan, Yano and Singhose, J. of Sound and Vibration 315 (2008), 797, compare shapers of all kinds.
SHAPERS: dict[str, tuple[float, Callable[[float], tuple[float, ...]]]] = {
    "zv": (0.5, lambda v: (0.5, 0.5)),
    "mzv": (0.375, lambda v: (1.0 - 1.0 / ROOT, ROOT - 1.0, 1.0 - 1.0 / ROOT)),
    "zvd": (0.5, lambda v: (0.25, 0.5, 0.25)),
    "ei": (0.5, lambda v: (0.25 * (1.0 + v), 0.5 * (1.0 - v), 0.25 * (1.0 + v))),
    "two-hump-ei": (0.5, _two_hump),
}


class Shaper(NamedTuple):
    """Impulses that a command is convolved with.

    Attributes:
        times: (k,) s, from 0 on.
        amplitudes: (k,), which sum to 1.
    """

    times: Array
    amplitudes: Array


def design(name: str, frequency: float, ratio: float = 0.0, tolerance: float = TOLERANCE) -> Shaper:
    """Designs a shaper for a mode.

    With damping, amplitudes fall as the mode decays from impulse to impulse, so that those of ZV, MZV, ZVD and two-hump
    EI still cancel. Those of EI leave the tolerance at the mode, and come near to zero on both sides of it.

    Args:
        name: of SHAPERS.
        frequency: natural frequency of the mode, Hz.
        ratio: damping ratio of the mode, from 0 on and below 1.
        tolerance: residual that EI and two-hump EI allow, a part.

    Raises:
        ValueError: one line, also for a mode so damped that EI impulses would be negative.
    """
    spacing, amplitudes = SHAPERS[one_of("shaper", name, SHAPERS)]
    rate = 2.0 * np.pi * physical("frequency", frequency, "Hz")
    if not non_negative("ratio", ratio) < 1.0:
        raise refusal("ratio", ratio, "a number >= 0 and < 1")
    if not positive("tolerance", tolerance) < 1.0:
        raise refusal("tolerance", tolerance, "a number > 0 and < 1")
    count = len(amplitudes(tolerance))
    times = spacing * np.arange(count) * 2.0 * np.pi / (rate * np.sqrt(1.0 - ratio**2))
    decay, own = np.exp(-ratio * rate * times), tolerance
    for _ in range(
        ROUNDS if name.endswith("ei") else 1
    ):  # what is left decays too, and is measured against impulses that sum to 1
        if not own < 1.0:
            raise refusal("ratio", ratio, f"a mode with less damping, or no {name}: its impulses would be negative")
        weighted = np.array(amplitudes(own)) * decay
        own = tolerance * float(weighted.sum() / decay[-1])
    return Shaper(times, weighted / weighted.sum())


def both(first: Shaper, second: Shaper) -> Shaper:
    """Gives the convolution of two shapers, which cancels the modes of both and lasts as long as both together."""
    times = np.add.outer(first.times, second.times).ravel()
    order = np.argsort(times, kind="stable")
    return Shaper(times[order], np.outer(first.amplitudes, second.amplitudes).ravel()[order])


def residual(shaper: Shaper, frequency: float | Array, ratio: float = 0.0) -> Any:
    """Gives the vibration that a shaper leaves, in percent of that after one impulse at once.

    After Singer and Seering (1990): exp(-r w t_k) |sum of A_i exp(r w t_i + j w_d t_i)| for the natural frequency w,
    the damping ratio r and the damped frequency w_d.

    Args:
        shaper: whose last impulse is at t_k.
        frequency: Hz, one or an array of them.
        ratio: damping ratio.
    """
    rate = 2.0 * np.pi * np.asarray(frequency, dtype=np.float64)
    pole = rate * (ratio + 1j * np.sqrt(1.0 - ratio**2))
    grown_since = np.exp(np.multiply.outer(shaper.times, pole) - shaper.times[-1] * pole.real)
    return 100.0 * np.abs(np.tensordot(shaper.amplitudes, grown_since, 1))


def sampled(shaper: Shaper, period: float) -> Array:
    """Gives the parts (m,) of a command that come 0, 1, ... control periods late.

    An impulse between two samples is split linearly between them. At a natural frequency w this adds at most
    100 (w period)^2 / 8 percent of residual: 0.02 % at 0.3 Hz and 20 ms.

    Args:
        shaper: whose impulses may fall between samples.
        period: s.
    """
    places = shaper.times / positive("period", period, "s")
    lower = np.floor(places).astype(int)
    result = np.zeros(lower[-1] + 2)
    np.add.at(result, lower, shaper.amplitudes * (1.0 - places + lower))
    np.add.at(result, lower + 1, shaper.amplitudes * (places - lower))
    return result

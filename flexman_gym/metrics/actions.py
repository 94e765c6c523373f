"""Actions: how much a controller asked of the motors, and how quickly it went to and fro."""

import numpy as np

from flexman_gym.arrays import Array
from flexman_gym.checks import physical, positive, refusal
from flexman_gym.metrics.samples import finite_samples, samples

CYCLES = 4  # of the frequency that a record must hold: the window tells no closer frequencies from a constant
ROUNDING = 1e-24  # of the mean square: a variance below is that of rounding


def effort(actions: Array) -> float:
    """Gives the mean square of actions (T, n), parts of the torque limits."""
    return float(np.mean(np.square(samples("actions", actions, 2))))


def roughness(actions: Array) -> float:
    """Gives the root mean square of the change of actions (T, n), parts of the torque limits, from period to period.

    A single action has none.
    """
    result = samples("actions", actions, 2)
    return float(np.sqrt(np.mean(np.square(np.diff(result, axis=0))))) if len(result) > 1 else 0.0


def power_above(actions: Array, period: float, frequency: float) -> float:
    """Gives the part of the variance of actions that lies above a frequency, from 0 to 1.

    Above the first natural frequency of the arm it is what the controller does to the vibrations, or what excites them.
    It is summed over the periodogram of all motors, with a Hann window (Harris, On the use of windows for harmonic
    analysis, Proceedings of the IEEE 1978), about the mean of each. A frequency is told from another one where they are
    2 / (T period) apart. Actions that stay constant have no variance, and none of it above.

    Args:
        actions: (T, n), parts of the torque limits.
        period: between samples, s.
        frequency: Hz, below half the rate of the samples.

    Raises:
        ValueError: for actions that are no such array of finite numbers or are shorter than 4 / frequency, a period
            that is not > 0, and a frequency that cannot be seen.
    """
    result = finite_samples("actions", actions, 2, least=CYCLES)
    period, frequency = physical("period", period, "s"), positive("frequency", frequency, "Hz")
    fastest = 0.5 / period
    if not frequency < fastest:
        raise refusal("frequency", frequency, f"a number > 0 and < {fastest:.6g} (Hz), half the rate of the samples")
    if len(result) * period * frequency < CYCLES * (1.0 - 1e-9):
        raise refusal("actions", actions, f"at least {CYCLES / frequency:.6g} s: {CYCLES} cycles of the frequency")
    window = np.sin(np.pi * np.arange(len(result)) / len(result))[:, None] ** 2
    swing = window * (result - result.mean(axis=0))
    power = np.square(np.abs(np.fft.rfft(swing, axis=0)))
    power[1 : (len(result) + 1) // 2] *= 2.0  # each stands for its negative frequency too
    if power.sum() <= ROUNDING * len(result) * np.square(result).sum():
        return 0.0
    return float(power[np.fft.rfftfreq(len(result), period) > frequency].sum() / power.sum())

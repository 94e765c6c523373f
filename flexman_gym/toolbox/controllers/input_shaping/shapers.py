"""Input shapers: modes excited by the motors, impulse sequences, and residual vibration over postures and payloads.

A shaper delays the command: its last impulse follows the first by 0.5 (ZV, zero vibration), 0.75 (MZV, modified ZV),
1 (ZVD, ZV and derivative; EI, extra-insensitive) or 1.5 (two-hump EI) periods of the mode. The lowest mode of
`FlexRRR-v0` with held motors is at about 0.3 Hz, so that the delay is 1.5 to 4.6 s.
"""

from collections.abc import Callable, Sequence
from functools import reduce
from typing import Any, NamedTuple, Self

import numpy as np

from flexman_gym.common.arrays import Array
from flexman_gym.common.checks import non_negative, one_of, physical, positive, sample_count
from flexman_gym.common.errors import value_error
from flexman_gym.model.model import Model
from flexman_gym.simulation.physical_parameters import varied_model
from flexman_gym.toolbox.controllers.excited_modes import excited_modes

DEFAULT_TOLERANCE = 0.05  # dimensionless; residual vibration tolerated by EI shapers
EI_ITERATIONS = 8  # iterations for the amplitudes of a damped EI shaper; each reduces the error at least tenfold
SQRT_2 = np.sqrt(2.0)


def _two_hump(v: float) -> tuple[float, ...]:
    """Return the undamped amplitudes of the two-hump EI shaper for a tolerated residual v (dimensionless)."""
    x = (v**2 * (np.sqrt(1.0 - v**2) + 1.0)) ** (1.0 / 3.0)
    outer = (3.0 * x**2 + 2.0 * x + 3.0 * v**2) / (16.0 * x)
    return outer, 0.5 - outer, 0.5 - outer, outer


# name -> time between two impulses in periods of the mode; undamped amplitudes as a function of the tolerated residual
# ZV and ZVD: Singer and Seering, J. of Dynamic Systems, Measurement, and Control 112 (1990), 76. EI: Singhose, Seering
# and Singer, J. of Mechanical Design 116 (1994), 654. Two-hump EI: Singhose, Porter, Tuttle and Singer, J. of Dynamic
# Systems, Measurement, and Control 119 (1997), 320. MZV: three impulses in three quarters of a period, as in printers
# (Klipper). Comparison: Vaughan, Yano and Singhose, J. of Sound and Vibration 315 (2008), 797.
SHAPERS: dict[str, tuple[float, Callable[[float], tuple[float, ...]]]] = {
    "zv": (0.5, lambda v: (0.5, 0.5)),
    "mzv": (0.375, lambda v: (1.0 - 1.0 / SQRT_2, SQRT_2 - 1.0, 1.0 - 1.0 / SQRT_2)),
    "zvd": (0.5, lambda v: (0.25, 0.5, 0.25)),
    "ei": (0.5, lambda v: (0.25 * (1.0 + v), 0.5 * (1.0 - v), 0.25 * (1.0 + v))),
    "two-hump-ei": (0.5, _two_hump),
}


class Shaper(NamedTuple):
    """Impulse sequence with which a command is convolved.

    Attributes:
        times: (k,) times of the impulses, s; the first is 0.
        amplitudes: (k,) amplitudes of the impulses, with sum 1.
    """

    times: Array
    amplitudes: Array

    def convolve(self, other: Self) -> Self:
        """Return the convolution with another shaper, for the modes of both; its delay is the sum of both delays."""
        times = np.add.outer(self.times, other.times).ravel()
        order = np.argsort(times, kind="stable")
        return type(self)(times[order], np.outer(self.amplitudes, other.amplitudes).ravel()[order])

    def sample(self, period: float) -> Array:
        """Return the sampled shaper: fractions (m,), with sum 1, of a command delayed by 0, 1, ... control periods.

        An impulse between two samples is split linearly between them. At a natural frequency w this adds at most
        100 (w period)^2 / 8 percent of residual: 0.02 % at 0.3 Hz and 20 ms.

        Args:
            period: control period, s.

        Raises:
            ValueError: for a delay of more than a million control periods.
        """
        sample_count("period", period, float(self.times[-1]))
        delays = self.times / period  # control periods
        lower = np.floor(delays).astype(int)
        result = np.zeros(lower[-1] + 2)
        np.add.at(result, lower, self.amplitudes * (1.0 - delays + lower))
        np.add.at(result, lower + 1, self.amplitudes * (delays - lower))
        return result


def convolve_samples(fractions: Array, values: Array) -> Array:
    """Return the convolution of values (K, n) with the fractions (m,) of a sampled shaper; earlier values are zero."""
    result = np.zeros_like(values)
    for delay in np.flatnonzero(fractions[: len(values)]).tolist():  # few are not zero: two for each impulse
        result[delay:] += fractions[delay] * values[: len(values) - delay]
    return result


def design_shaper(name: str, frequency: float, ratio: float = 0.0, tolerance: float = DEFAULT_TOLERANCE) -> Shaper:
    """Design a shaper for one mode.

    With damping, the amplitudes decrease with the decay of the mode from impulse to impulse, so that ZV, MZV, ZVD and
    two-hump EI still cancel the vibration. An EI shaper has the tolerated residual at the frequency of the mode and
    nearly zero residual at a lower and a higher frequency.

    Args:
        name: name in `SHAPERS`.
        frequency: natural frequency of the mode, Hz.
        ratio: damping ratio of the mode, 0 <= ratio < 1.
        tolerance: residual vibration tolerated by EI and two-hump EI, as a fraction.

    Raises:
        ValueError: for arguments out of range, and for a damping ratio with negative EI impulses.
    """
    spacing, amplitudes = SHAPERS[one_of("shaper", name, SHAPERS)]
    rate = 2.0 * np.pi * physical("frequency", frequency, "Hz")
    if not non_negative("ratio", ratio) < 1.0:
        raise value_error("ratio", ratio, "a number >= 0 and < 1")
    if not positive("tolerance", tolerance) < 1.0:
        raise value_error("tolerance", tolerance, "a number > 0 and < 1")
    count = len(amplitudes(tolerance))
    times = spacing * np.arange(count) * 2.0 * np.pi / (rate * np.sqrt(1.0 - ratio**2))
    decay, corrected = np.exp(-ratio * rate * times), tolerance
    # the tolerance is relative to impulses with sum 1, whose residual decays as well
    for _ in range(EI_ITERATIONS if name.endswith("ei") else 1):
        if not corrected < 1.0:
            raise value_error("ratio", ratio, f"a mode with less damping, or no {name}: its impulses would be negative")
        weighted = np.array(amplitudes(corrected)) * decay
        corrected = tolerance * float(weighted.sum() / decay[-1])
    return Shaper(times, weighted / weighted.sum())


def shaper_residual(shaper: Shaper, frequency: float | Array, ratio: float | Array = 0.0) -> Any:
    """Return the residual vibration after a shaper, shaped like `frequency`, in percent of that after a single impulse.

    Singer and Seering (1990): exp(-r w t_k) |sum of A_i exp(r w t_i + j w_d t_i)| with natural frequency w, damping
    ratio r and damped frequency w_d.

    Args:
        shaper: shaper with impulses A_i at times t_i, i = 1 to k.
        frequency: natural frequency of the mode, Hz, a number or an array.
        ratio: damping ratio of the mode, a number or shaped like `frequency`.
    """
    rate = 2.0 * np.pi * np.asarray(frequency, dtype=np.float64)
    pole = rate * (ratio + 1j * np.sqrt(1.0 - ratio**2))
    growth = np.exp(np.multiply.outer(shaper.times, pole) - shaper.times[-1] * pole.real)
    return 100.0 * np.abs(np.tensordot(shaper.amplitudes, growth, 1))


TOLERATED_RESIDUAL = 5.0  # %; largest residual of a mode within the tolerated frequency errors
TOLERANCE_SLACK = 1.02  # factor on TOLERATED_RESIDUAL, because damped EI shapers slightly exceed it at the mode
TIP_VIBRATION_LIMIT = 10.0  # %; largest residual tip vibration of a recommended shaper
EVALUATED_MODES = 3  # number of the lowest modes in an evaluation
MAX_FREQUENCY_ERROR = 0.9  # dimensionless; largest relative error of a frequency in an evaluation
FREQUENCY_ERROR_STEP = 0.0005  # dimensionless; resolution of the relative error


class OperatingPoint(NamedTuple):
    """Posture and payload, with the modes of the arm there.

    Attributes:
        posture: (n,) motor angles, rad.
        payload: mass of the payload, kg.
        held: (k, 3) modes with held motors, see `excited_modes`.
        free: (k, 3) modes with free motors.
    """

    posture: Array
    payload: float
    held: Array
    free: Array

    @classmethod
    def find(cls, model: Model, postures: Array, payloads: Sequence[float]) -> list[Self]:
        """Return the operating point, with its lowest modes, of each posture (p, n) rad and payload (kg)."""
        result = []
        for payload in payloads:
            loaded = varied_model(model, payload_mass=non_negative("payload_mass", payload, "kg"))
            for posture in postures:
                modes = (excited_modes(loaded, posture, held)[:EVALUATED_MODES] for held in (True, False))
                result.append(cls(posture, float(payload), *modes))
        return result


class ShaperEvaluation(NamedTuple):
    """Residual vibration, over all operating points, of a shaper designed for one or two modes of one operating point.

    Attributes:
        name: name of the shaper in `SHAPERS`.
        modes: number of modes in the design, 1 or 2.
        delay: time from the first impulse to the last, s.
        tolerated_errors: (low, high) relative errors of the frequencies, with a residual of each mode of the design of
            at most TOLERATED_RESIDUAL.
        residuals: (points, k) residual of each mode, %.
        tip: (points,) residual tip vibration after a step of the motors, with all modes in phase, %.
    """

    name: str
    modes: int
    delay: float
    tolerated_errors: tuple[float, float]
    residuals: Array
    tip: Array

    @staticmethod
    def compare(points: Sequence[OperatingPoint]) -> "_ShaperComparison":
        """Evaluate all shapers over operating points, each with a mode with held motors; recommend a shaper."""
        median = sorted(points, key=lambda point: float(point.held[0, 0]))[len(points) // 2]
        counts = [count for count in (1, 2) if count <= len(median.held)]
        found = [_evaluate_shaper(name, median.held[:count], points) for count in counts for name in SHAPERS]
        feasible = [evaluation for evaluation in found if evaluation.tip.max() <= TIP_VIBRATION_LIMIT]
        return _ShaperComparison(median, found, min(feasible, key=lambda evaluation: evaluation.delay, default=None))


class _ShaperComparison(NamedTuple):
    """Comparison of all shapers.

    Attributes:
        median: operating point with the median of the lowest frequencies with held motors.
        evaluations: evaluations of all shapers for one mode of the median point, then of all shapers for two modes.
        recommended: evaluation with the shortest delay and at most TIP_VIBRATION_LIMIT at every point, or None.
    """

    median: OperatingPoint
    evaluations: list[ShaperEvaluation]
    recommended: ShaperEvaluation | None


def _evaluate_shaper(name: str, modes: Array, points: Sequence[OperatingPoint]) -> ShaperEvaluation:
    """Return the evaluation of a shaper designed for modes (k, 3)."""
    shaper = reduce(Shaper.convolve, [design_shaper(name, frequency, ratio) for frequency, ratio, _ in modes.tolist()])
    count = min(len(point.held) for point in points)
    residuals, tips = [], []
    for point in points:
        each = np.array([float(shaper_residual(shaper, *mode[:2])) for mode in point.held.tolist()])
        residuals.append(each[:count])
        tips.append(float(each @ point.held[:, 2] / point.held[:, 2].sum()))
    delay, errors = float(shaper.times[-1]), _tolerated_frequency_errors(shaper, modes)
    return ShaperEvaluation(name, len(modes), delay, errors, np.array(residuals), np.array(tips))


def _tolerated_frequency_errors(shaper: Shaper, modes: Array) -> tuple[float, float]:
    """Return the relative errors (low, high) of the frequencies of modes (k, 3); see `ShaperEvaluation`."""
    errors = np.arange(0.0, MAX_FREQUENCY_ERROR, FREQUENCY_ERROR_STEP)
    result = []
    for sign in (-1.0, 1.0):
        residuals = [
            shaper_residual(shaper, frequency * (1.0 + sign * errors), ratio) for frequency, ratio, _ in modes.tolist()
        ]
        over = np.append((np.array(residuals) > TOLERANCE_SLACK * TOLERATED_RESIDUAL).any(axis=0), True)
        result.append(sign * FREQUENCY_ERROR_STEP * max(int(np.argmax(over)) - 1, 0))
    return result[0], result[1]

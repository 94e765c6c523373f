"""Input shapers: modes excited by the motors, impulse sequences, and residual vibration over postures and payloads.

A shaper delays: its last impulse comes 0.5 (ZV), 0.75 (MZV), 1 (ZVD, EI) or 1.5 (two-hump EI) periods of the mode
after the first. With its motors held, the lowest mode of `FlexRRR-v0` is at about 0.3 Hz: that is 1.5 to 4.6 s.
"""

from collections.abc import Callable, Sequence
from functools import reduce
from typing import Any, NamedTuple

import numpy as np

from flexman_gym.common.arrays import Array, Vector
from flexman_gym.common.checks import flag, non_negative, one_of, physical, positive, value_error
from flexman_gym.model.model import Model, check_model
from flexman_gym.model.vibration import Eigenpairs, equilibrium_matrices, oscillatory_modes
from flexman_gym.simulation.parameters import varied_model

RIGID_MODE_RATIO = 0.5  # of the lowest mode with held motors: what is slower still is the arm turning about its motors
RATIO_ROUNDING = 1e-9  # of a damping ratio
MIN_TIP_AMPLITUDE = 1e-3  # of the most that a mode moves the tip: one that moves it less is left out


def excited_modes(model: Model, posture: Vector, held: bool = True) -> Array:
    """Gives the modes (k, 3) that motors excite and the tip feels, of an arm at rest: the lowest first.

    A mode is a pair of complex eigenvalues s of the linear model, see `model.vibration`. It has a natural frequency
    |s| / (2 pi) in Hz, a damping ratio -Re s / |s|, and an amplitude of the tip, the most that one motor causes: in m
    after a held motor has been stepped by 1 rad, in m after a free one has had an impulse of 1 N m s. Constraints raise
    frequencies (Rayleigh), so that free motors leave no mode below the lowest one with held motors, but for the arm
    that turns, or swings in gravity, as a whole. That is left out.

    Args:
        model: of the arm.
        posture: (n,) rad, of the motors.
        held: whether the motors are held, by whatever torques that takes; free ones carry the holding torques.

    Raises:
        ValueError: for a posture of wrong shape, and for an arm too soft to rest.
    """
    resting = equilibrium_matrices(check_model(model), posture)
    motors, others = resting.motors, resting.others
    inertia, springs = (matrix[np.ix_(others, others)] for matrix in (resting.mass, resting.stiffness))
    result = np.zeros((0, 3))
    if len(others):
        # a step carries along what hangs on a motor; springs draw it to where it rests
        carried = -np.linalg.solve(inertia, resting.mass[np.ix_(others, motors)])
        starts = carried + np.linalg.solve(springs, resting.stiffness[np.ix_(others, motors)])
        eigen = oscillatory_modes(resting, others)
        lost = resting.damping[np.ix_(others, others)]
        caused = [shape @ (value * inertia + lost) @ starts for value, shape in zip(*eigen, strict=True)]
        result = _felt(eigen, np.array(caused), resting.tip[:, others])
    if flag("held", held) or not len(result):
        return result
    every = np.arange(model.n_dof)
    eigen = oscillatory_modes(resting, every)
    above = np.abs(eigen.values) > 2.0 * np.pi * RIGID_MODE_RATIO * result[0, 0]
    return _felt(Eigenpairs(eigen.values[above], eigen.shapes[above]), eigen.shapes[np.ix_(above, motors)], resting.tip)


def _felt(eigen: Eigenpairs, caused: Array, tip: Array) -> Array:
    """Modes (k, 3) that the tip feels, of those that motors excite by (k, n)."""
    moved = 2.0 * np.linalg.norm(eigen.shapes @ tip.T, axis=1) * np.abs(caused).max(axis=1, initial=0.0)
    kept = np.flatnonzero(moved > MIN_TIP_AMPLITUDE * moved.max(initial=0.0))
    sizes = np.abs(eigen.values)
    kept = kept[np.argsort(sizes[kept])]
    ratios = -eigen.values[kept].real / sizes[kept]
    ratios[np.abs(ratios) < RATIO_ROUNDING] = 0.0
    return np.transpose([sizes[kept] / (2.0 * np.pi), ratios, moved[kept]])


DEFAULT_TOLERANCE = 0.05  # residual that EI shapers allow
EI_ITERATIONS = 8  # for the parameter of an EI shaper; its error falls to less than a tenth in each
SQRT_2 = np.sqrt(2.0)


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
    "mzv": (0.375, lambda v: (1.0 - 1.0 / SQRT_2, SQRT_2 - 1.0, 1.0 - 1.0 / SQRT_2)),
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


def design_shaper(name: str, frequency: float, ratio: float = 0.0, tolerance: float = DEFAULT_TOLERANCE) -> Shaper:
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
        raise value_error("ratio", ratio, "a number >= 0 and < 1")
    if not positive("tolerance", tolerance) < 1.0:
        raise value_error("tolerance", tolerance, "a number > 0 and < 1")
    count = len(amplitudes(tolerance))
    times = spacing * np.arange(count) * 2.0 * np.pi / (rate * np.sqrt(1.0 - ratio**2))
    decay, own = np.exp(-ratio * rate * times), tolerance
    for _ in range(
        EI_ITERATIONS if name.endswith("ei") else 1
    ):  # what is left decays too, and is measured against impulses that sum to 1
        if not own < 1.0:
            raise value_error("ratio", ratio, f"a mode with less damping, or no {name}: its impulses would be negative")
        weighted = np.array(amplitudes(own)) * decay
        own = tolerance * float(weighted.sum() / decay[-1])
    return Shaper(times, weighted / weighted.sum())


def convolve_shapers(first: Shaper, second: Shaper) -> Shaper:
    """Gives the convolution of two shapers, which cancels the modes of both and lasts as long as both together."""
    times = np.add.outer(first.times, second.times).ravel()
    order = np.argsort(times, kind="stable")
    return Shaper(times[order], np.outer(first.amplitudes, second.amplitudes).ravel()[order])


def shaper_residual(shaper: Shaper, frequency: float | Array, ratio: float = 0.0) -> Any:
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


def sample_shaper(shaper: Shaper, period: float) -> Array:
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


TOLERATED_RESIDUAL = 5.0  # % of a mode, up to which a shaper bears an error of frequency
TOLERANCE_SLACK = 1.02  # of that: EI shapers leave just so much by design, and with damping a little more beside it
TIP_VIBRATION_LIMIT = 10.0  # % of the tip's vibration, that a recommended shaper leaves at worst
EVALUATED_MODES = 3  # lowest modes
MAX_FREQUENCY_ERROR, FREQUENCY_ERROR_STEP = 0.9, 0.0005  # part of a frequency, of the errors that are tried


class OperatingPoint(NamedTuple):
    """A posture (n,) rad and a payload (kg), with the modes (k, 3) of held and of free motors, see `excited_modes`."""

    posture: Array
    payload: float
    held: Array
    free: Array


class ShaperEvaluation(NamedTuple):
    """A shaper for the lowest mode or the lowest two of a case, and what it leaves of all cases.

    Attributes:
        name: of the shaper.
        modes: how many of the lowest it is designed for.
        delay: s, from its first impulse to its last.
        borne: errors (low, high) of all frequencies, as parts of them, up to which it leaves at most LEFT of each mode.
        left: (cases, k) % of each mode.
        tip: (cases,) % of the tip's vibration after a step of the motors, modes added up as if they met in phase.
    """

    name: str
    modes: int
    delay: float
    borne: tuple[float, float]
    left: Array
    tip: Array


def find_operating_points(model: Model, postures: Array, payloads: Sequence[float]) -> list[OperatingPoint]:
    """Finds the lowest modes for each of the postures (p, n) rad with each of the payloads (kg)."""
    result = []
    for payload in payloads:
        loaded = varied_model(model, payload_mass=payload)
        for posture in postures:
            modes = (excited_modes(loaded, posture, held)[:EVALUATED_MODES] for held in (True, False))
            result.append(OperatingPoint(posture, float(payload), *modes))
    return result


def median_operating_point(cases: Sequence[OperatingPoint]) -> OperatingPoint:
    """Gives the case whose lowest frequency with held motors is in the middle of all."""
    return sorted(cases, key=lambda case: float(case.held[0, 0]))[len(cases) // 2]


def evaluate_shapers(cases: Sequence[OperatingPoint]) -> list[ShaperEvaluation]:
    """Finds what each shaper, for one mode and for two, leaves of all cases, where it is designed for the middle one.

    Args:
        cases: all with at least one mode of held motors.
    """
    middle = median_operating_point(cases).held
    counts = [count for count in (1, 2) if count <= len(middle)]
    return [_evaluate_shaper(name, middle[:count], cases) for count in counts for name in SHAPERS]


def recommend_shaper(answers: Sequence[ShaperEvaluation]) -> ShaperEvaluation | None:
    """Gives the answer of the least delay that leaves at most BOUND of the tip's vibration in every case, or None."""
    good = [answer for answer in answers if answer.tip.max() <= TIP_VIBRATION_LIMIT]
    return min(good, key=lambda answer: answer.delay, default=None)


def _evaluate_shaper(name: str, modes: Array, cases: Sequence[OperatingPoint]) -> ShaperEvaluation:
    shaper = reduce(convolve_shapers, [design_shaper(name, frequency, ratio) for frequency, ratio, _ in modes.tolist()])
    most = min(len(case.held) for case in cases)
    left, tips = [], []
    for case in cases:
        each = np.array(
            [float(shaper_residual(shaper, frequency, ratio)) for frequency, ratio, _ in case.held.tolist()]
        )
        left.append(each[:most])
        tips.append(float(each @ case.held[:, 2] / case.held[:, 2].sum()))
    delay = float(shaper.times[-1])
    return ShaperEvaluation(
        name, len(modes), delay, _tolerated_frequency_errors(shaper, modes), np.array(left), np.array(tips)
    )


def _tolerated_frequency_errors(shaper: Shaper, modes: Array) -> tuple[float, float]:
    """Gives how much lower and higher all of the modes (k, 3) may be together, as parts, see
    `ShaperEvaluation.borne`.
    """
    steps = np.arange(0.0, MAX_FREQUENCY_ERROR, FREQUENCY_ERROR_STEP)
    result = []
    for sign in (-1.0, 1.0):
        left = [
            shaper_residual(shaper, frequency * (1.0 + sign * steps), ratio) for frequency, ratio, _ in modes.tolist()
        ]
        over = np.append((np.array(left) > TOLERANCE_SLACK * TOLERATED_RESIDUAL).any(axis=0), True)
        result.append(sign * FREQUENCY_ERROR_STEP * max(int(np.argmax(over)) - 1, 0))
    return result[0], result[1]

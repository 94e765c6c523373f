"""Shaping of a sampled motion for measured modes: the shaper with the shortest delay, or time scaling, and limits."""

from collections.abc import Collection, Iterator, Mapping
from functools import reduce
from itertools import product
from statistics import NormalDist
from typing import NamedTuple

import numpy as np

from flexman_gym.common.arrays import Array, pad_rows
from flexman_gym.common.checks import mapping, one_of, physical, positive
from flexman_gym.common.errors import value_error
from flexman_gym.toolbox.controllers.input_shaping.motion import Motion
from flexman_gym.toolbox.controllers.input_shaping.shapers import (
    SHAPERS,
    Shaper,
    convolve_samples,
    design_shaper,
    shaper_residual,
)
from flexman_gym.toolbox.identification.ring_down import MAX_DAMPING
from flexman_gym.toolbox.identification.ringing import DAMPING_DEVIATION, FREQUENCY_DEVIATION, Ringing

AUTO, SCALING = "auto", "scaling"
LIMITS = ("velocity", "acceleration", "jerk")
COVERAGE = 0.95  # probability that frequencies and damping ratios are within their intervals
POINTS = (15, 5)  # frequencies and damping ratios in the box of a mode
EI_MARGIN = 0.9  # residual at the mode of an EI shaper / allowed residual
MOST_SCALINGS = 60  # time scalings in a search
LIMIT_ITERATIONS, LIMIT_MARGIN = 20, 1.001  # of the time scaling that keeps limits; factor on the scaling
MAX_SAMPLES = 10**6  # samples of a shaped motion
BLOCK = 1024  # samples whose vibrations are added in one product of matrices
MOVING = 1e-3  # fraction of the largest range of a position; less is no motion


class ShapedMotion(NamedTuple):
    """Motion with less residual vibration.

    Attributes:
        shaper: its shapers, by mode, or "scaling".
        motion: the shaped motion.
        unshaped: the given motion, slower where the limits require it.
        residuals: (k, 3) predicted residual vibration of each mode, a fraction of that of the unshaped motion at its
            end: at the measured frequency and damping ratio, and its smallest and largest value within their intervals.
    """

    shaper: str
    motion: Motion
    unshaped: Motion
    residuals: Array

    @classmethod
    def find(
        cls,
        motion: Motion,
        ringing: Ringing,
        residual: float = 0.05,
        shaper: str = AUTO,
        limits: Mapping[str, float] | None = None,
    ) -> "ShapedMotion":
        """Return the shortest shaped motion whose residual vibration is at most `residual` for every mode.

        A shaper is a convolution of shapers for single modes, sampled with the period of the motion. It acts on the
        polynomials between samples with velocities in the same way as on the samples. For the choice the frequencies
        and damping ratios have the standard deviations FREQUENCY_DEVIATION and DAMPING_DEVIATION at least.

        Args:
            motion: the motion, at rest at both ends.
            ringing: one or two modes with damping ratios.
            residual: allowed residual vibration of each mode, a fraction of that of the unshaped motion.
            shaper: "auto", "scaling" (a slower motion), or a name in `SHAPERS`, for all modes and any residual.
            limits: largest "velocity", "acceleration" and "jerk" of the positions, rad or m per s, s^2 and s^3; the
                motion is slowed down as far as necessary.

        Raises:
            ValueError: for a mode above half the sampling rate of a motion without velocities, for a damping ratio
                above MAX_DAMPING, for a result of more than MAX_SAMPLES samples, and if nothing meets the residual.
        """
        if not 0.0 < positive("residual", residual) < 1.0:
            raise value_error("residual", residual, "a number > 0 and < 1")
        one_of("shaper", shaper, (AUTO, *SHAPERS, SCALING))
        bounds = {
            name: physical(f"limits.{name}", each) for name, each in mapping("limits", limits or {}, LIMITS).items()
        }
        modes = _checked_modes(ringing, motion)
        _check_size(motion, modes, SHAPERS if shaper == AUTO else {shaper} & SHAPERS.keys())
        sampled = bool((ringing.measured[: len(modes)] < 0.5 / motion.period).all())
        if shaper == SCALING and not sampled:
            raise _rate_error(motion.period, max(ringing.frequencies))
        boxes = _boxes(ringing, FREQUENCY_DEVIATION, DAMPING_DEVIATION)
        best, least = None, (np.inf, "")
        for name, fractions in sorted(
            _candidates(modes, shaper, residual, motion.period), key=lambda each: len(each[1])
        ):
            most = float(max(_shaper_residuals(fractions, motion.period, box).max() for box in boxes))
            least = min(least, (most, name))
            if best and len(fractions) + len(motion.values) - 1 >= len(best.motion.values):
                break
            if shaper != AUTO or most <= residual:
                base, shaped = _within_limits(motion, fractions, bounds)
                if best is None or len(shaped.values) < len(best.motion.values):
                    left = [_shaper_residuals(fractions, motion.period, box) for box in _boxes(ringing)]
                    best = cls(name, shaped, base, _ranges(left))
        if shaper in (AUTO, SCALING) and sampled:
            best = _slower(motion, ringing, residual, bounds, best)
        if best is None and not sampled:
            raise _rate_error(motion.period, max(ringing.frequencies))
        if best is None:
            found = (
                f"at least {np.ceil(1e3 * least[0]) / 1e3:g}, which {least[1]} leaves" if least[1] else "another shaper"
            )
            raise value_error("residual", residual, f"{found}, or measure frequency and damping more closely")
        return best


def _checked_modes(ringing: Ringing, motion: Motion) -> Array:
    """Return natural frequencies (Hz) and damping ratios (k, 2) after checking that they can be shaped."""
    if ringing.damping is None or not 1 <= len(ringing.frequencies) <= 2:
        raise value_error("ringing", ringing, "one or two modes with damping ratios")
    for frequency, ratio in zip(ringing.frequencies, ringing.damping, strict=True):
        if ratio > MAX_DAMPING:
            raise value_error(
                "damping", f"{ratio:.3g} at {frequency:.3g} Hz", f"at most {MAX_DAMPING:g}: this is no vibration"
            )
        if frequency >= 0.5 / motion.period and 1 not in motion.orders:
            raise _rate_error(motion.period, frequency)
    ratios = np.array(ringing.damping)
    return np.column_stack([np.array(ringing.frequencies) / np.sqrt(1.0 - ratios**2), ratios])


def _check_size(motion: Motion, modes: Array, names: Collection[str]) -> None:
    """Raise a ValueError if the longest of some shapers makes more than MAX_SAMPLES samples of a motion."""
    shapers = [[design_shaper(name, frequency) for name in names] for frequency, _ in modes.tolist()]
    delay = sum(max((float(shaper.times[-1]) for shaper in each), default=0.0) for each in shapers)
    if motion.duration + delay > (MAX_SAMPLES - 1) * motion.period:
        longest = f"{motion.duration:.3g} s become up to {motion.duration + delay:.3g} s, {MAX_SAMPLES} samples"
        allowed = f"at most {(MAX_SAMPLES - 1) / (motion.duration + delay):.4g}: {longest}"
        raise value_error(motion.source.name, f"{1.0 / motion.period:.4g} samples per s", allowed)


def _rate_error(period: float, frequency: float) -> ValueError:
    """Return the error of a motion with less than two samples per cycle of a mode (Hz)."""
    allowed = f"a motion with more than {2 * frequency:.4g} samples per s (--rate)"
    return value_error("motion", f"{1 / period:.4g} samples per s for a mode at {frequency:.4g} Hz", allowed)


def _boxes(ringing: Ringing, frequency: float = 0.0, damping: float = 0.0) -> list[Array]:
    """Return for each mode natural frequencies and damping ratios (m, 2): the measured ones, then those of intervals.

    The intervals of all modes contain the true values with a probability of COVERAGE; `frequency` and `damping` are the
    smallest relative standard deviations.
    """
    count = len(ringing.frequencies)
    width = NormalDist().inv_cdf(0.5 + 0.5 * COVERAGE ** (0.5 / count))
    lines = [np.append(0.0, np.linspace(-width, width, each)) for each in POINTS]
    deviations = np.maximum(
        ringing.deviations.reshape(2, -1).T, ringing.measured.reshape(2, -1).T * [frequency, damping]
    )
    result = []
    for value, deviation in zip(ringing.measured.reshape(2, -1).T, deviations, strict=True):
        damped, ratios = value[:, None] + deviation[:, None] * np.array(list(product(*lines))).T
        ratios = np.clip(ratios, 0.0, 0.9)
        result.append(np.column_stack([np.maximum(damped, 1e-3 * value[0]) / np.sqrt(1.0 - ratios**2), ratios]))
    return result


def _candidates(modes: Array, name: str, residual: float, period: float) -> Iterator[tuple[str, Array]]:
    """Yield names and sampled fractions (m,) of shapers: of every mode, and for "auto" of single modes as well."""
    designs: list[dict[str, Array]] = []
    for frequency, ratio in modes.tolist():
        designs.append({})
        for each in SHAPERS if name == AUTO else {name} & SHAPERS.keys():
            try:
                designed = design_shaper(each, frequency, ratio, EI_MARGIN * residual)
            except ValueError:  # too much damping for an EI shaper
                if name != AUTO:
                    raise
                continue
            designs[-1][each] = _on_grid(designed, frequency, ratio, period)
    for chosen in product(*([*each, ""] if name == AUTO else list(each) for each in designs)):
        parts = [design[each] for each, design in zip(chosen, designs, strict=True) if each]
        if parts:
            hertz = [f"{each} of {mode[0]:.3g} Hz" for each, mode in zip(chosen, modes.tolist(), strict=True) if each]
            yield " + ".join(hertz), reduce(_combined, parts)


def _combined(first: Array, second: Array) -> Array:
    """Return the sampled fractions of two shapers one after the other."""
    return convolve_samples(first, pad_rows(second, len(first) + len(second) - 1)[:, None])[:, 0]


def _on_grid(shaper: Shaper, frequency: float, ratio: float, period: float) -> Array:
    """Return the sampled fractions (m,) of a shaper, corrected to its residual, and its slope, at its own mode.

    Splitting an impulse between two samples changes the residual; the smallest change of the fractions restores it.
    """
    fractions = np.trim_zeros(shaper.sample(period), "b")
    used = np.flatnonzero(fractions)
    rate = 2.0 * np.pi * frequency * (ratio + 1j * np.sqrt(1.0 - ratio**2))

    def conditions(times: Array) -> Array:
        growth = np.exp(rate * (times - shaper.times[-1]))
        rows = [np.ones(len(times)), growth.real, growth.imag]
        if len(used) >= 5:
            rows += [(growth * times).real / shaper.times[-1], (growth * times).imag / shaper.times[-1]]
        return np.array(rows)

    matrix = conditions(np.multiply(period, used, dtype=np.float64))
    missing = conditions(shaper.times) @ shaper.amplitudes - matrix @ fractions[used]
    corrected = fractions.copy()
    corrected[used] += np.linalg.lstsq(matrix, missing, rcond=None)[0]
    return corrected if corrected.min() >= 0.0 and abs(corrected.sum() - 1.0) < 1e-9 else fractions


def _shaper_residuals(fractions: Array, period: float, box: Array) -> Array:
    """Return the residuals (m,), fractions, of a sampled shaper for modes (m, 2)."""
    used = np.flatnonzero(fractions)
    return np.asarray(
        0.01
        * shaper_residual(Shaper(np.multiply(period, used, dtype=np.float64), fractions[used]), box[:, 0], box[:, 1])
    )


def _ranges(residuals: list[Array]) -> Array:
    """Return the first, smallest and largest residual (k, 3) of each mode."""
    return np.array([[each[0], each.min(), each.max()] for each in residuals])


def _shaped(motion: Motion, fractions: Array) -> Motion:
    """Return the convolution of a motion with the fractions (m,) of a sampled shaper."""
    values, held = motion.values, np.array(motion.orders) == 0
    before, after = values[0] * held, np.repeat((values[-1] * held)[None], len(fractions) - 1, axis=0)
    changes = np.vstack([values, after]) - before
    return motion._replace(values=before + convolve_samples(fractions, changes))


def _scaled(motion: Motion, count: int) -> Motion:
    """Return a motion of the same path in `count` samples, by cubic interpolation."""
    from scipy.interpolate import make_interp_spline

    slower = (count - 1) / (len(motion.values) - 1)
    spline = make_interp_spline(np.arange(len(motion.values)) * slower, motion.values)
    return motion._replace(values=spline(np.arange(count)) / slower ** np.array(motion.orders))


def _excess(motion: Motion, limits: Mapping[str, float]) -> float:
    """Return the factor by which a motion must be slower to keep the limits, 1 if it keeps them."""
    factors = [1.0]
    for order, name in enumerate(LIMITS, 1):
        if name in limits:
            rates = np.diff(motion.positions, order, axis=0) / motion.period**order
            factors.append(float((np.abs(rates).max(initial=0.0) / limits[name]) ** (1.0 / order)))
    return max(factors)


def _within_limits(motion: Motion, fractions: Array, limits: Mapping[str, float]) -> tuple[Motion, Motion]:
    """Return a motion, slowed down so that the shaped motion keeps the limits, and the shaped motion."""
    base, shaped, count = motion, _shaped(motion, fractions), float(len(motion.values))
    for _ in range(LIMIT_ITERATIONS):
        if (factor := _excess(shaped, limits)) <= 1.0:
            return base, shaped
        if (count := np.ceil(count * factor * LIMIT_MARGIN)) > MAX_SAMPLES:
            break
        base = _scaled(motion, int(count))
        shaped = _shaped(base, fractions)
    raise value_error("limits", limits, f"limits that a motion of at most {MAX_SAMPLES} samples can keep")


def _slower(
    motion: Motion, ringing: Ringing, residual: float, limits: Mapping[str, float], best: ShapedMotion | None
) -> ShapedMotion | None:
    """Return the shortest slower motion that keeps limits and residual if it is shorter than the best shaped one."""
    base = _within_limits(motion, np.ones(1), limits)[0]
    count, most = len(base.values), len(best.motion.values) - 1 if best else 2 * len(base.values)
    wide, narrow = _boxes(ringing, FREQUENCY_DEVIATION, DAMPING_DEVIATION), _boxes(ringing)
    most = min(most, MAX_SAMPLES)
    if most <= count:
        return best
    samples = np.unique(np.linspace(count + 1, most, MOST_SCALINGS).astype(int))
    factors = (samples - 1.0) / (count - 1.0)
    fits = np.ones(len(samples), dtype=bool)
    for box in wide:  # a slower motion has the vibration of a mode of higher frequency
        vibrations = _vibrations(base, box[:1] * np.column_stack([factors, np.ones(len(factors))]))
        fits &= (vibrations / factors[:, None] <= residual * _vibrations(base, box[:1])).all(axis=1)
    for each in samples[fits].tolist():
        slower = _scaled(motion, each)
        if all((_motion_residuals(base, slower, box) <= residual).all() for box in wide):
            left = [_motion_residuals(base, slower, box) for box in narrow]
            return ShapedMotion(SCALING, slower, base, _ranges(left))
    return best


def _motion_residuals(before: Motion, after: Motion, box: Array) -> Array:
    """Return the vibration (m,) at the end of a motion as a fraction of that of another one, for modes (m, 2).

    It is the largest fraction over all positions that move.
    """
    vibrations = _vibrations(before, box), _vibrations(after, box)
    moving = np.ptp(before.positions, axis=0) > MOVING * np.ptp(before.positions, axis=0).max()
    return np.asarray((vibrations[1] / np.maximum(vibrations[0], 1e-300))[:, moving].max(axis=1))


def _vibrations(motion: Motion, box: Array) -> Array:
    """Return the amplitudes (m, n) of modes (m, 2) at the end of a motion by each position, per acceleration."""
    rate = 2.0 * np.pi * box[:, 0] * (box[:, 1] + 1j * np.sqrt(1.0 - box[:, 1] ** 2))
    changes = np.diff(np.pad(motion.positions, ((1, 1), (0, 0)), mode="edge"), 2, axis=0)
    blocks = np.pad(changes, ((-len(changes) % BLOCK, 0), (0, 0))).reshape(-1, BLOCK, changes.shape[1])
    within = np.exp(np.outer(rate, motion.period * np.arange(1.0 - BLOCK, 1.0)))
    between = np.exp(np.outer(rate, motion.period * BLOCK * np.arange(1.0 - len(blocks), 1.0)))
    return np.asarray(np.abs(np.einsum("mb,mbn->mn", between, np.tensordot(within, blocks, (1, 1)))))

"""Records of free vibration with known modes and the faults of real sensors."""

from typing import NamedTuple

import numpy as np
from scipy.signal import lfilter

FREQUENCIES, RATIOS = (0.3, 200.0), (0.001, 0.15)  # Hz and 1; log-uniform
SPACING = (1.3, 5.0)  # ratio of the frequencies of two modes, log-uniform
SAMPLES = (8.0, 60.0)  # samples per cycle of the fastest mode, log-uniform
DECAY = (1.5, 5.0)  # length of the record x decay rate of the slowest mode
CYCLES = (6.0, 200.0)  # smallest and largest number of cycles of the slowest mode
NOISE, LOUD = (0.002, 0.03), (0.05, 0.15)  # standard deviation of the noise / amplitude of the first mode
SWAY = 0.04  # largest variation of the amplitude of a tone
KINDS = (
    "one mode", "two modes", "loud noise", "coloured noise", "clipped", "rounded", "repeated", "drift", "jitter",
    "tone beside a mode", "tone alone", "noise alone",
)  # fmt: skip


class FreeVibration(NamedTuple):
    """Times (T,), s, readings (T,), and true damped frequencies, Hz, and damping ratios (k, 2)."""

    times: np.ndarray
    values: np.ndarray
    modes: np.ndarray


def decay(times, frequency, ratio, phase=0.3):
    """Return a vibration (T,) of amplitude 1 with a damped frequency (Hz) and a damping ratio."""
    rate = 2.0 * np.pi * frequency * ratio / np.sqrt(1.0 - ratio**2)
    return np.exp(-rate * times) * np.cos(2.0 * np.pi * frequency * times + phase)


def log_uniform(rng, limits):
    return float(np.exp(rng.uniform(*np.log(limits))))


def made_record(kind, seed):
    """Draw modes, sampling rate and length of a record, and the fault of its kind."""
    rng = np.random.default_rng([KINDS.index(kind), seed])
    modes = np.array([[log_uniform(rng, FREQUENCIES), log_uniform(rng, RATIOS)]])
    if kind == "two modes" or (kind in ("clipped", "drift", "jitter") and rng.random() < 0.3):
        factor = log_uniform(rng, SPACING)
        second = modes[0, 0] * (factor if modes[0, 0] * factor < FREQUENCIES[1] else 1.0 / factor)
        modes = np.vstack([modes, (second, log_uniform(rng, RATIOS))])
    slow, fast = modes[:, 0].min(), modes[:, 0].max()
    rates = 2.0 * np.pi * modes[:, 0] * modes[:, 1] / np.sqrt(1.0 - modes[:, 1] ** 2)
    duration = np.clip(rng.uniform(*DECAY) / rates.min(), CYCLES[0] / slow, CYCLES[1] / slow)
    period = 1.0 / (log_uniform(rng, SAMPLES) * fast)
    times = period * np.arange(max(round(duration / period), 50))
    moments = times + period * rng.uniform(-0.3, 0.3, len(times)) if kind == "jitter" else times
    sizes, phases = (1.0, rng.uniform(0.3, 1.0)), 2.0 * np.pi * rng.random(2)
    clean = sum(s * decay(moments, *mode, phase) for s, mode, phase in zip(sizes, modes, phases, strict=False))
    if kind.endswith("alone"):
        clean, modes = 0.0 * clean, modes[:0]
    level = log_uniform(rng, LOUD if kind == "loud noise" else NOISE)
    values = clean + level * rng.standard_normal(len(times)) + rng.uniform(-2.0, 2.0)
    values = with_fault(kind, rng, moments, values, slow)
    stamps = times if kind == "jitter" and rng.random() < 0.5 else moments  # a logger that does not see its jitter
    return FreeVibration(stamps - stamps[0], values, modes)


def with_fault(kind, rng, times, values, slow):
    """Return readings (T,) with the fault of a kind; `slow` is the lowest frequency, Hz."""
    count, middle = len(times), np.median(values)
    size, part = np.abs(values - middle).max(), times / times[-1]
    if kind == "coloured noise":
        noise = lfilter([1.0], [1.0, -rng.uniform(0.5, 0.95)], rng.standard_normal(count))
        values = values + log_uniform(rng, NOISE) * noise / noise.std()
    elif kind == "clipped":
        values = np.clip(values, middle - size * rng.uniform(0.4, 0.8), middle + size * rng.uniform(0.4, 0.8))
        if rng.random() < 0.3:  # an amplifier saturates, and the noise of the converter follows
            values = values + 0.003 * size * rng.standard_normal(count)
    elif kind == "rounded":
        step = size / rng.uniform(4.0, 60.0)
        values = step * np.round(values / step)
    elif kind == "repeated":
        every = rng.integers(1, 3)  # readings of the log for each packet of the sensor
        packets = np.arange(count) // every
        lost = rng.random(packets[-1] + 1) < rng.uniform(0.03, 0.2)
        values = values[every * np.maximum(packets - lost[packets], 0)]
    elif kind == "drift":
        shapes = (part, part**2, np.exp(-part * rng.uniform(1.0, 8.0)), np.cos(np.pi * part * rng.uniform(0.3, 1.2)))
        values = values + rng.uniform(0.5, 4.0) * shapes[rng.integers(len(shapes))]
    elif kind.startswith("tone"):
        frequency = slow * log_uniform(rng, (0.4, 3.0))
        loud = rng.uniform(0.1, 1.0) if "beside" in kind else 1.0
        amplitude = loud * (1.0 + rng.uniform(0.0, SWAY) * np.sin(2.0 * np.pi * rng.uniform(0.3, 3.0) * part))
        for order in range(1, rng.integers(2, 5)):
            phase = 2.0 * np.pi * (order * frequency * times + rng.random())
            values = values + amplitude / order**2 * np.cos(phase)
    return values

"""Residual vibration before and after `flexman shape` on random simulated arms, and predictions for a real arm."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

import flexman_gym as fm
from flexman_gym.toolbox.controllers.input_shaping.motion import Motion
from flexman_gym.toolbox.controllers.input_shaping.shaped_motion import ShapedMotion

PERIOD = 0.004  # s; of the motions
RECORD = 10.0  # s; length of a record of the ringing
NOISE = 0.01  # fraction of the largest vibration; standard deviation of the gauge
FREQUENCIES, RATIOS, SERVOS = (2.0, 30.0), (0.002, 0.05), (8.0, 20.0)  # Hz, 1 and Hz; ranges of random arms
SERVO_RATIO = 0.7  # damping ratio of the servos
STILL = 1.4  # s; shortest record of the real arm with the hub at rest


@dataclass(frozen=True)
class ShapingRow:
    """Result for a simulated arm: modes, shaper, residual vibration predicted and simulated, as fractions.

    Attributes:
        arm: seed of the arm.
        modes: number of modes, 1 or 2.
        found: number of modes found in the record; a second one can be below the noise.
        lowest: lowest natural frequency, Hz.
        shaper: chosen shaper.
        delay: duration of the shaped motion less that of the given one, s.
        low, high: predicted interval of the larger residual of the modes.
        residual: larger residual in the simulation of the modes that were found in the record.
        left: largest vibration of the tip after the shaped motion / that after the given motion.
    """

    arm: int
    modes: int
    found: int
    lowest: float
    shaper: str
    delay: float
    low: float
    high: float
    residual: float
    left: float


@dataclass(frozen=True)
class ServoArm:
    """Linear arm whose joint follows a command by a servo and excites modes.

    Attributes:
        poles: (k,) poles of the modes, 1/s.
        gains: (k,) amplitude of each mode in the gauge.
        servo: pole of the servo, 1/s.
    """

    poles: np.ndarray
    gains: np.ndarray
    servo: complex

    @classmethod
    def random(cls, rng: np.random.Generator, modes: int) -> "ServoArm":
        """Draw an arm with log-uniform frequencies and damping ratios."""
        frequencies = np.sort(_log_uniform(rng, FREQUENCIES, modes))
        if modes == 2:  # two modes are separate
            frequencies[1] = max(frequencies[1], min(1.3 * frequencies[0], FREQUENCIES[1]))
            frequencies[0] = min(frequencies[0], frequencies[1] / 1.3)
        gains = np.array([1.0, rng.uniform(0.3, 1.0)])[:modes] * (2.0 * np.pi * frequencies)
        servo = _poles(_log_uniform(rng, SERVOS, 1), np.array([SERVO_RATIO]))[0]
        return cls(_poles(frequencies, _log_uniform(rng, RATIOS, modes)), gains, servo)

    def vibration(self, positions: np.ndarray, count: int) -> np.ndarray:
        """Return the complex modal amplitudes (count, k) from the end of a motion (T,) on, exact for a linear command.

        The servo is x'' = -2 r w x' + w^2 (command - x); mode i is y' = p y + g x''. The poles of both superpose.
        """
        rows = len(positions) + count
        slopes = np.diff(np.pad(positions, (1, count + 1), mode="edge")) / PERIOD
        kinks = np.diff(slopes)[:rows]  # changes of the rate of the command at each sample
        w2, s = abs(self.servo) ** 2, self.servo
        result = []
        for pole, gain in zip(self.poles, self.gains, strict=True):
            # y(s) = g w^2 / ((z - s)(z - conj s)(z - p)) kink, for a kink of 1 rad/s in the command
            roots = np.array([s, np.conj(s), pole])
            parts = [gain * w2 / np.prod([root - each for each in roots if each != root]) for root in roots]
            total = np.zeros(rows, dtype=complex)
            for root, part in zip(roots, parts, strict=True):
                total += part * _decaying_sum(kinks, np.exp(root * PERIOD))
            result.append(total[len(positions) - 1 : -1])
        return np.array(result).T


def _log_uniform(rng: np.random.Generator, limits: tuple[float, float], count: int) -> np.ndarray:
    """Return log-uniform numbers (count,)."""
    return np.exp(rng.uniform(float(np.log(limits[0])), float(np.log(limits[1])), count))


def _poles(frequencies: np.ndarray, ratios: np.ndarray) -> np.ndarray:
    """Return poles (k,) of natural frequencies (Hz) and damping ratios."""
    return 2.0 * np.pi * frequencies * (-ratios + 1j * np.sqrt(1.0 - ratios**2))


def _decaying_sum(values: np.ndarray, factor: complex) -> np.ndarray:
    """Return y (T,) with y[k] = factor y[k - 1] + values[k]."""
    from scipy.signal import lfilter

    return np.asarray(lfilter([1.0], [1.0, -factor], values))


def trapezoid(duration: float, rise: float) -> Motion:
    """Return a motion of 1 rad with a trapezoidal rate, in samples of PERIOD."""
    times = PERIOD * np.arange(round(duration / PERIOD) + 1)
    rates = np.clip(np.minimum(times, times[-1] - times) / rise, 0.0, 1.0)
    positions = np.append(0.0, np.cumsum(0.5 * (rates[1:] + rates[:-1])))
    return Motion(0.0, PERIOD, (positions / positions[-1])[:, None], (0,), Path("motion.csv"), {})


def simulate(seed: int, residual: float = 0.05) -> ShapingRow:
    """Return the result for a random arm: one mode for even seeds, two for odd ones.

    The ringing after the unshaped motion is recorded with noise; the shaper is chosen from the modes of this record.
    """
    rng = np.random.default_rng(seed)
    arm = ServoArm.random(rng, 1 + seed % 2)
    motion = trapezoid(rng.uniform(0.6, 1.5), rng.uniform(0.08, 0.25))
    count = round(RECORD / PERIOD)
    before = arm.vibration(motion.positions[:, 0], count)
    record = before.real.sum(axis=1)
    gauge = record + NOISE * np.abs(record).max() * rng.standard_normal(count)
    ringing = fm.Ringing.estimate(PERIOD * np.arange(count), gauge)
    found = ShapedMotion.find(motion, ringing, residual)
    seen = [int(np.abs(arm.poles.imag - 2.0 * np.pi * each).argmin()) for each in ringing.frequencies]
    after = arm.vibration(found.motion.positions[:, 0], count)
    settled = count // 10  # the servo has settled and its part of the response is gone
    later = np.exp(arm.poles * PERIOD * settled)
    truth = np.abs(after[settled] / later) / np.abs(before[settled] / later)
    worst = found.residuals.max(axis=0)
    tips = [np.abs(each.real.sum(axis=1)[settled:]).max() for each in (before, after)]
    return ShapingRow(
        seed, len(arm.poles), len(seen), float(abs(arm.poles[0]) / (2.0 * np.pi)), found.shaper,
        found.motion.duration - motion.duration, float(worst[1]), float(worst[2]), float(truth[seen].max()),
        float(tips[1] / tips[0]),
    )  # fmt: skip


def real_frequencies(folder: Path) -> dict[str, float]:
    """Return the frequency (Hz) of the real arm in each run of a folder whose hub is at rest for at least STILL s."""
    from studies.machine.measure import STAGE_1, moving

    result = {}
    for name, run in moving(folder).items():
        times, hub = np.asarray(run.times), np.asarray(run.inputs["motor_angle_1"])
        ends = np.concatenate([[0], np.flatnonzero(np.diff(hub)) + 1, [len(hub)]])
        longest = int(np.diff(ends).argmax())
        rest = slice(ends[longest], ends[longest + 1])
        if len(times[rest]) * run.period >= STILL:
            ringing = fm.Ringing.estimate(times[rest], np.asarray(run.outputs[STAGE_1])[rest])
            result[name] = float(ringing.frequencies[0])
    return result

"""Prescribed rotation of the base of an arm: attitude, angular velocity, and the polynomials that the kernels read."""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from flexman_gym.common.arrays import Array, Vector
from flexman_gym.kernels.foundation import turn_foundation
from flexman_gym.kernels.layout import FOUNDATION, FOUNDATION_DEGREE, FOUNDATION_PART
from flexman_gym.scene.scene import Scene
from flexman_gym.scene.signals import PiecewiseSignals, SampledSignal, Signal

UPRIGHT = (1.0, 0.0, 0.0, 0.0)  # attitude of a base whose frame is the world frame
# Largest turn (rad) of base and signals in an interval: the terms that the polynomials leave out are below 1e-13.
LARGEST_TURN = 0.5


def rotation_matrix(attitude: Sequence[float] | Array) -> Array:
    """Return the rotation matrices (..., 3, 3), base frame to world frame, of unit quaternions (..., 4)."""
    w, x, y, z = np.moveaxis(np.asarray(attitude, dtype=float), -1, 0)
    rows = [
        [1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - w * z), 2.0 * (x * z + w * y)],
        [2.0 * (x * y + w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - w * x)],
        [2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)],
    ]
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)


def foundation_motion(row: Array, time: float) -> Array:
    """Return gravity, angular velocity and angular acceleration (9,) of a foundation row at a time after its start (s).

    The kernel is `kernels.foundation.evaluate_foundation`.
    """
    series = row[2 : 2 + 6 * FOUNDATION_PART].reshape(6, FOUNDATION_PART)
    powers, orders = time ** np.arange(FOUNDATION_PART), np.arange(1, FOUNDATION_PART)
    return np.concatenate([series @ powers, (series[3:, 1:] * orders) @ powers[:-1]])


class FoundationRotation:
    """Rotation of a base whose angular acceleration in the base frame is prescribed.

    Args:
        accelerations: angular acceleration, rad/s^2, Signals or SampledSignals along x, y and z of the base frame.
        attitude: (4,) unit quaternion at time 0, base frame to world frame, scalar first.
        rate: (3,) angular velocity at time 0, base frame, rad/s.
        gravity: (3,) acceleration of gravity, world frame, m/s^2.
        duration: end of the motion, s.
        grid: time between outputs, s; intervals of the polynomials are multiples or whole parts of it where possible.

    Attributes:
        times: boundaries (p + 1,) of the p intervals, s, from 0.
        rows: (p, FOUNDATION) foundation rows of `kernels.layout`.
    """

    def __init__(
        self, accelerations: Sequence[Signal | SampledSignal], attitude: Vector, rate: Vector,
        gravity: Vector, duration: float, grid: float,
    ) -> None:  # fmt: skip
        self._signals, self._gravity = list(accelerations), np.array(gravity, dtype=float)
        self._series = np.zeros((4, FOUNDATION_PART))
        attitudes, rates = np.array([attitude], dtype=float), np.array([rate], dtype=float)
        times, rows, starts, jumps, now = [0.0], [], [], self._jumps(duration), 0.0
        while now < duration:
            starts.append((attitudes[0].copy(), rates[0].copy()))
            end = self._interval_end(now, rates[0], jumps, grid)
            row = np.zeros((1, FOUNDATION))
            row[0, 0] = now
            self._turn(row, attitudes, rates, now, end)
            rows.append(row[0])
            times.append(end)
            now = end
        self.times, self.rows, self._starts = np.array(times), np.array(rows), starts

    def _jumps(self, duration: float) -> Array:
        """Return the times up to the duration at which a signal is not smooth, s."""
        times = [0.0, duration]
        for signal in self._signals:
            if isinstance(signal, SampledSignal):
                times.extend(signal.times)
            else:
                times.extend((signal.start, duration if signal.stop is None else signal.stop))
        each = np.unique(times)
        return each[(each >= 0.0) & (each <= duration)]

    def _interval_end(self, now: float, rate: Array, jumps: Array, grid: float) -> float:
        """Return the end of the interval that starts now (s) with an angular velocity (3,), rad/s."""
        jump = float(jumps[np.searchsorted(jumps, now, side="right")])
        largest = math.hypot(*map(_bound, self._signals))
        speed = float(np.linalg.norm(rate)) + math.sqrt(largest)
        for signal in self._signals:
            if isinstance(signal, Signal):
                speed = max(speed, 2.0 * math.pi * signal.frequency_hz)
        longest = LARGEST_TURN / speed if speed > 0.0 else math.inf
        if now + longest >= jump:
            return jump
        number = math.floor(longest / grid)
        step = grid * number if number else grid / math.ceil(grid / longest)
        end = step * (math.floor(now / step * (1.0 + 1e-12)) + 1)
        return min(end, jump) if end - now > 1e-9 * step else min(end + step, jump)

    def _turn(self, row: Array, attitudes: Array, rates: Array, now: float, end: float) -> None:
        """Set a foundation row (1, FOUNDATION), and advance attitudes (1, 4) and rates (1, 3) to the end (s)."""
        series = np.array([_taylor(signal, now, 0.5 * (now + end)) for signal in self._signals])
        turn_foundation(attitudes, rates, series[None], self._gravity, end - now, row, self._series)

    def at(self, times: NDArray[Any]) -> tuple[Array, Array]:
        """Return attitudes (T, 4), unit quaternions, and angular velocities (T, 3), base frame, rad/s, at times (s)."""
        attitudes, rates, row = [], [], np.zeros((1, FOUNDATION))
        for time in times:
            i = min(max(int(np.searchsorted(self.times, time, side="right")) - 1, 0), len(self.rows) - 1)
            attitude, rate = (each[None].copy() for each in self._starts[i])
            series = np.array([_taylor(s, self.times[i], self.times[i : i + 2].mean()) for s in self._signals])
            turn_foundation(attitude, rate, series[None], self._gravity, time - self.times[i], row, self._series)
            attitudes.append(attitude[0])
            rates.append(rate[0])
        return np.array(attitudes), np.array(rates)

    def motion(self, times: NDArray[Any]) -> Array:
        """Return gravity (m/s^2), angular velocity (rad/s) and its rate (rad/s^2) at times (s), (T, 9), base frame."""
        places = np.clip(np.searchsorted(self.times, times, side="right") - 1, 0, len(self.rows) - 1)
        after = (times - self.times[places]).tolist()
        return np.array([foundation_motion(self.rows[i], time) for i, time in zip(places, after, strict=True)])

    def columns(self, time: float) -> Array:
        """Return the foundation row at a time (s) as columns (7, FOUNDATION / 7) of a drive table."""
        i = min(max(int(np.searchsorted(self.times, time, side="right")) - 1, 0), len(self.rows) - 1)
        return self.rows[i].reshape(7, -1)


def _bound(signal: Signal | SampledSignal) -> float:
    """Return a bound of the magnitude of a signal."""
    if isinstance(signal, SampledSignal):
        return max(map(abs, signal.values))
    return abs(signal.offset) + abs(signal.amplitude)


def _taylor(signal: Signal | SampledSignal, start: float, middle: float) -> Array:
    """Return the Taylor coefficients (FOUNDATION_DEGREE,) at a start (s) of a signal that is smooth around a middle."""
    result = np.zeros(FOUNDATION_DEGREE)
    if isinstance(signal, SampledSignal):
        offsets, slopes = signal.lines(np.array([middle]))
        result[:2] = offsets[0] + slopes[0] * start, slopes[0]
    elif signal.start <= middle and (signal.stop is None or middle < signal.stop):
        turn = 2.0 * math.pi * signal.frequency_hz
        angle, factor = turn * start + signal.phase, signal.amplitude
        for k in range(FOUNDATION_DEGREE):
            result[k] = factor * math.sin(angle + 0.5 * math.pi * k)
            factor *= turn / (k + 1.0)
        result[0] += signal.offset
    return result


def base_rotation(scene: Scene) -> FoundationRotation:
    """Return the rotation of the base of a scene.

    Examples:
        >>> from dataclasses import replace
        >>> turning = replace(fm.catalog.paper_scene("rr"), base_angular_velocity=(0.0, 0.0, 1.0))
        >>> attitudes, rates = base_rotation(turning).at(turning.output_times)
        >>> attitudes[-1].round(3).tolist()  # after 2 s
        [0.54, 0.0, 0.0, 0.841]
    """
    accelerations = scene.base_angular_acceleration or [Signal()] * 3
    attitude, rate = scene.base_attitude or UPRIGHT, scene.base_angular_velocity or (0.0, 0.0, 0.0)
    return FoundationRotation(accelerations, attitude, rate, scene.arm.gravity, scene.duration, scene.output_step)


def scene_pieces(scene: Scene) -> PiecewiseSignals:
    """Return the inputs of a scene, with the rotation of its base."""
    return PiecewiseSignals(scene.signals, scene.duration, base_rotation(scene)) if scene.rotates else scene.pieces

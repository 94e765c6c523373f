"""Time-optimal path parametrisation within bounds of torques and rates (TOPP-RA), smoothed by a moving average.

In each stage of a path the second derivative s'' of the path parameter s is constant, so that s'^2 is linear in s.
Torques are rest + a(s) s'' + b(s) s'^2. A backward pass computes the largest s'^2 from which the end can be reached, a
forward pass accelerates as much as it allows (Pham and Pham, IEEE Transactions on Robotics 34, 2018, 645).
"""

from typing import NamedTuple

import numpy as np

from flexman_gym.common.arrays import Array, BoolArray, IntArray, pad_rows
from flexman_gym.model.friction import friction_torques
from flexman_gym.model.model import Model

STAGES = 100  # number of stages of a path
SHARES, SHARE_CHANGE = (1.0, 0.8), (0.35, 0.65)  # fractions of the torque available to a motion; at path parameters
SMALL_INERTIA = 1e-9  # fraction of the largest inertia of a stage that replaces smaller ones: these bound s'^2 alone
FRICTION_PASSES = 2  # number of profiles after the first, with the friction at the speeds of the one before
LARGE = 1e30  # dimensionless; stands for the inverse of a factor that is not positive and bounds nothing
WINDOW = 0.9  # length of the moving average / period of the first mode with free motors
SHORTEST_WINDOW = 0.025  # length of the moving average / duration of the quintic, at least
# Shortest time-optimal slew / period of the first mode with free motors, and / shortest quintic. Shorter slews excite
# vibration that the feed-forward neglects: FlexOne-v0, with up to 3.9 periods, would settle later by 5 % on average.
LEAST_PERIODS, LEAST_QUINTICS = 4.0, 3.0
WINDOW_SAMPLES, SAMPLES = 8, 512  # numbers of samples of a moving average and of a motion
RAISE, MAX_RAISES = 1.12, 60  # factor of torque limits that a replanned motion cannot keep; largest number of uses
ROUNDING = 1e-9  # dimensionless; relative error of a speed or a sample number


def average_windows(modes: Array, quintics: Array) -> Array:
    """Return the lengths (r,) of the moving average, s.

    Torques excite the modes with free motors. An average over about a period of the first one leaves little vibration
    of it, and motors keep to their largest rates while springs twist.

    Args:
        modes: (r,) periods of the first mode with free motors, s.
        quintics: (r,) durations of the quintic slews, s.
    """
    return np.maximum(WINDOW * modes, SHORTEST_WINDOW * quintics)


def is_time_optimal(durations: Array, modes: Array, quintics: Array, shortest: Array | float) -> BoolArray:
    """Return flags (r,) of slews with time-optimal timing; all others, and those not set by torques, are quintics.

    Args:
        durations: (r,) durations of time-optimal slews, s.
        modes: (r,) periods of the first mode with free motors, s.
        quintics: (r,) durations of the quintic slews, s.
        shortest: (r,) shortest durations of quintic slews, s, see `SlewBounds.shortest`.
    """
    least = np.maximum(LEAST_QUINTICS * shortest, LEAST_PERIODS * modes)
    result: BoolArray = (durations < quintics) & (durations >= least)
    return result


class PathBounds(NamedTuple):
    """Torques along the straight paths of r arms with n joints, and bounds of the motion.

    Attributes:
        model: model of the arms, for its friction law.
        tables: (r, p, 3, n) torques at p equally spaced path parameters from 0 to 1, N m: at rest, and the factors of
            s'' and of s'^2.
        limits: (r, n) largest torques, N m.
        displacement: (r, n) changes of the motor angles along the path, rad.
        rates: (n,) or a number; largest motor rates, rad/s.
        friction: (r, 2, n) viscous (N m s/rad) and Coulomb friction (N m).
    """

    model: Model
    tables: Array
    limits: Array
    displacement: Array
    rates: Array | float
    friction: Array

    def rows(self, chosen: IntArray | BoolArray) -> "PathBounds":
        """Return the bounds of some of the arms."""
        return self._replace(
            tables=self.tables[chosen],
            limits=self.limits[chosen],
            displacement=self.displacement[chosen],
            friction=self.friction[chosen],
        )


class SpeedProfile(NamedTuple):
    """Fastest motions of r arms to the ends of their paths: s' is linear in time between N + 1 equally spaced points.

    Attributes:
        speeds: (r, N + 1) speeds s', 1/s.
        times: (r, N + 1) s.
        feasible: (r,) flags of motions within the bounds; other rows have no meaning.
    """

    speeds: Array
    times: Array
    feasible: BoolArray

    def rows(self, chosen: BoolArray) -> "SpeedProfile":
        """Return the motions of some of the arms."""
        return SpeedProfile(self.speeds[chosen], self.times[chosen], self.feasible[chosen])


class _Stages(NamedTuple):
    """Bounds lowest - slopes s'^2 <= s'' <= highest - slopes s'^2 and s'^2 <= most in N stages, stage by stage.

    Attributes:
        lowest, highest, slopes: (N, r, n).
        most: (N, r).
        feasible: (r,) flags of arms that can rest everywhere on the path.
    """

    lowest: Array
    highest: Array
    slopes: Array
    most: Array
    feasible: BoolArray


def fastest_motion(bounds: PathBounds, start: Array, speed: Array) -> SpeedProfile:
    """Return the fastest motions from path parameters (r,) and speeds (r,), 1/s, to rest at path parameter 1.

    A motion takes at most a fraction of the torque that equilibrium leaves. This fraction falls along the path, see
    SHARES: feedback needs more torque where the arm brakes.
    """
    width = (1.0 - start) / STAGES
    middles = start[:, None] + width[:, None] * (np.arange(STAGES) + 0.5)
    friction = np.zeros((len(start), STAGES, bounds.tables.shape[-1]))
    rubs = bounds.friction.any()
    for _ in range(1 + rubs * FRICTION_PASSES):
        stages = _stages(bounds, middles, width, friction)
        squares, feasible = _fastest_squares(stages, width, speed**2)
        speeds = np.sqrt(squares)
        means = 0.5 * (speeds[:, 1:] + speeds[:, :-1])
        if rubs:
            rates = means[..., None] * bounds.displacement[:, None]
            friction = friction_torques(bounds.model, rates, bounds.friction[:, None])
    with np.errstate(divide="ignore"):
        steps = width[:, None] / means
    times = np.concatenate([np.zeros((len(start), 1)), np.cumsum(steps, axis=1)], axis=1)
    return SpeedProfile(speeds, times, feasible & np.isfinite(times[:, -1]))


def _stages(bounds: PathBounds, middles: Array, width: Array, friction: Array) -> _Stages:
    """Return the bounds at the middles (r, N) of stages of a width (r,) with friction torques (r, N, n)."""
    points = bounds.tables.shape[1] - 1
    low = np.minimum((middles * points).astype(np.int64), points - 1)
    part, rows = (middles * points - low)[..., None, None], np.arange(len(middles))[:, None]
    layers = bounds.tables[rows, low] * (1.0 - part) + bounds.tables[rows, low + 1] * part
    rest, inertia, squared = (layers[..., layer, :] for layer in range(3))
    share = np.interp(middles, SHARE_CHANGE, SHARES)[..., None]
    upper, lower = (share * (sign * bounds.limits[:, None] - rest) - friction for sign in (1.0, -1.0))
    inertia = inertia + width[:, None, None] * squared  # s'^2 in the middle is s'^2 at the start + width s''
    least = SMALL_INERTIA * np.abs(inertia).max(axis=-1, keepdims=True)
    inertia = np.where(np.abs(inertia) < least, least, inertia)
    forward = inertia > 0.0
    highest, lowest = np.where(forward, upper, lower) / inertia, np.where(forward, lower, upper) / inertia
    slopes = squared / inertia
    # each lower bound of s'' with each upper bound; s'^2 stays positive at the end: s'' >= -s'^2 / (2 width)
    whole = np.concatenate([lowest, np.zeros_like(lowest[..., :1])], axis=-1)
    steeper = np.concatenate([slopes, np.full_like(slopes[..., :1], 0.5) / width[:, None, None]], axis=-1)
    falling = slopes[..., :, None] - steeper[..., None, :]
    bound = np.where(falling > 0.0, highest[..., :, None] - whole[..., None, :], np.inf)
    most = (bound / np.where(falling > 0.0, falling, 1.0)).min(axis=(-2, -1))
    with np.errstate(divide="ignore"):
        fastest = 1.0 / (np.abs(bounds.displacement) / bounds.rates).max(axis=1)
    most = np.minimum(most, fastest[:, None] ** 2)
    feasible = ((upper > 0.0) & (lower < 0.0)).all(axis=(1, 2))
    lowest, highest, slopes = (np.ascontiguousarray(np.swapaxes(each, 0, 1)) for each in (lowest, highest, slopes))
    return _Stages(lowest, highest, slopes, np.ascontiguousarray(most.T), feasible)


def _fastest_squares(stages: _Stages, width: Array, square: Array) -> tuple[Array, BoolArray]:
    """Return s'^2 (r, N + 1) of the fastest motions from s'^2 (r,), 1/s^2, and flags (r,) of feasible motions."""
    double = 2.0 * width[:, None]
    factors = 1.0 - double * stages.slopes
    inverses = np.where(factors > 0.0, 1.0 / np.where(factors > 0.0, factors, 1.0), LARGE)
    offsets = -double * stages.lowest
    reachable = np.zeros((STAGES + 1, len(width)))
    for i in range(STAGES - 1, -1, -1):
        reachable[i] = np.minimum(stages.most[i], ((reachable[i + 1, :, None] + offsets[i]) * inverses[i]).min(axis=1))
    result = np.zeros_like(reachable)
    result[0] = square
    gains, falls = double * stages.highest, double * stages.slopes
    for i in range(STAGES):
        change = (gains[i] - falls[i] * result[i, :, None]).min(axis=1)
        result[i + 1] = np.maximum(np.minimum(result[i] + change, reachable[i + 1]), 0.0)
    return result.T, stages.feasible & (square <= (1.0 + ROUNDING) * reachable[0])


class TimeOptimalMotions:
    """Fastest motions of b arms along their paths, smoothed by a moving average over the time of a window.

    The path parameter is the mean of that of the fastest motion over the window before, so that the acceleration is
    continuous. The motion is sampled; between samples the speed of the fastest motion is linear. A replanned motion
    continues the fastest motion from the next sample on, so that path parameter, speed and acceleration are continuous.

    Attributes:
        windows: (b,) lengths of the moving average, s; 0 for an arm without a time-optimal motion.
        durations: (b,) durations of the smoothed motions, s.
    """

    state_fields = ("windows", "durations", "_motions")

    def __init__(self) -> None:
        self.windows, self.durations = np.zeros(0), np.zeros(0)
        self._motions = np.zeros((0, 3, SAMPLES + 1))  # path parameter, its derivative and its integral

    def allocate(self, count: int) -> None:
        """Allocate memory for `count` arms."""
        for name in self.state_fields:
            setattr(self, name, pad_rows(getattr(self, name), count))

    def start(self, arms: IntArray, windows: Array, bounds: PathBounds) -> None:
        """Plan motions from rest for arms (r,) and windows (r,), s; an arm without a feasible motion gets none."""
        self._motions[arms], self.windows[arms] = 0.0, windows
        profile = fastest_motion(bounds, np.zeros(len(arms)), np.zeros(len(arms)))
        first = np.zeros(len(arms), dtype=np.int64)
        planned = profile.feasible & self._fits(arms, first, profile)
        self.windows[arms[~planned]] = 0.0
        self._sample(arms[planned], first[planned], profile.rows(planned))

    def replan(self, arms: IntArray, elapsed: Array, bounds: PathBounds) -> None:
        """Plan the remaining motions of arms (r,) anew from times (r,) since their start, s.

        Torque limits that a motion cannot keep are raised by steps of 12 % for this motion. A motion of less than a
        window is not replanned.
        """
        first = np.ceil(np.maximum(elapsed, 0.0) / self._spacing(arms) - ROUNDING).astype(np.int64)
        left = elapsed < self.durations[arms] - 2.0 * self.windows[arms]
        for _ in range(MAX_RAISES):
            arms, first, bounds = arms[left], first[left], bounds.rows(left)
            if not len(arms):
                return
            profile = fastest_motion(bounds, self._motions[arms, 0, first], self._motions[arms, 1, first])
            planned = profile.feasible & self._fits(arms, first, profile)
            long = planned & (profile.times[:, -1] >= self.windows[arms])
            self._sample(arms[long], first[long], profile.rows(long))
            left, bounds = ~planned, bounds._replace(limits=RAISE * bounds.limits)

    def _spacing(self, arms: IntArray) -> Array:
        """Return the times (r,) between samples of the motions of arms (r,), s."""
        result: Array = self.windows[arms] / WINDOW_SAMPLES
        return result

    def _fits(self, arms: IntArray, first: IntArray, profile: SpeedProfile) -> BoolArray:
        """Return flags (r,) of arms (r,) whose motions end before the last sample."""
        with np.errstate(divide="ignore", invalid="ignore"):
            result: BoolArray = profile.times[:, -1] / self._spacing(arms) + first < SAMPLES - WINDOW_SAMPLES
        return result

    def _sample(self, arms: IntArray, first: IntArray, profile: SpeedProfile) -> None:
        """Replace the motions of arms (r,) from the samples with numbers (r,) on by a profile.

        Sampling cuts corners of the speed. The new speeds are scaled so that the path ends at 1.
        """
        for arm, start, times, speeds in zip(arms, first, profile.times, profile.speeds, strict=True):
            spacing = self.windows[arm] / WINDOW_SAMPLES
            place, speed, area = self._motions[arm]
            later = np.interp(spacing * np.arange(1, SAMPLES + 1 - start), times, speeds, right=0.0)
            later *= ((1.0 - place[start]) / spacing - 0.5 * speed[start]) / np.cumsum(later)[-1]
            speed[start + 1 :] = later
            before, after = speed[start:-1], speed[start + 1 :]
            place[start + 1 :] = place[start] + np.cumsum(0.5 * spacing * (before + after))
            areas = spacing * place[start:-1] + spacing**2 * (before / 3.0 + after / 6.0)
            area[start + 1 :] = area[start] + np.cumsum(areas)
            last = start + np.flatnonzero(later)[-1] + 2  # the sample at which the fastest motion rests
            self.durations[arm] = spacing * last + self.windows[arm]

    def at(self, elapsed: Array, arms: IntArray) -> tuple[Array, Array, Array]:
        """Return path parameters, speeds (1/s) and accelerations (1/s^2) at times since the starts.

        Args:
            elapsed: (...) times, s.
            arms: indices of arms with a motion, of a shape that broadcasts to that of the times.
        """
        windows = self.windows[arms]
        now, before = self._fastest(elapsed, arms), self._fastest(elapsed - windows, arms)
        means = (now - before) / windows
        over = elapsed >= self.durations[arms]
        return (np.where(over, 1.0, means[2]), np.where(over, 0.0, means[0]), np.where(over, 0.0, means[1]))

    def _fastest(self, elapsed: Array, arms: IntArray) -> Array:
        """Return path parameter, speed (1/s) and integral (s) of the fastest motions, (3, ...), at times (...) s."""
        spacing = self._spacing(arms)
        inside = np.clip(elapsed / spacing, 0.0, SAMPLES)
        low = np.minimum(inside.astype(np.int64), SAMPLES - 1)
        time = (inside - low) * spacing
        place, speed, area = (self._motions[arms, layer, low] for layer in range(3))
        acceleration = (self._motions[arms, 1, low + 1] - speed) / spacing
        return np.array([
            place + time * (speed + 0.5 * time * acceleration),
            speed + time * acceleration,
            area + time * (place + time * (speed / 2.0 + time * acceleration / 6.0)),
        ])  # fmt: skip

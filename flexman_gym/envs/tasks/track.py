"""Track: follow a closed path in space with the tip."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from flexman_gym.common.arrays import Array, Vector
from flexman_gym.common.checks import non_negative, one_of, positive, sequence, set_fields, value_error, vector
from flexman_gym.envs.limits import Limits
from flexman_gym.envs.sensors.sensor import Entry, Sensor
from flexman_gym.envs.tasks.rewards import distance_reward
from flexman_gym.envs.tasks.task import MOVING_METRICS, Goal
from flexman_gym.envs.view import Number, View
from flexman_gym.kernels.control_period import fourier_series

HARMONICS, POSTURE_HARMONICS = 3, 12  # Fourier series of the path, and of the motor angles
COLLOCATION_POINTS = 28  # points of the path with inverse kinematics
SAG_STRIDE = 4  # distance of the points at which the sag is computed
RAMP_FRACTION = 0.25  # time constant of the start of the target, fraction of the period
COLLOCATION_PHASES = 2.0 * np.pi * np.arange(COLLOCATION_POINTS)[None] / COLLOCATION_POINTS
TRIES, CENTRES = 20, 8  # draws of a path; centres per draw
STEP, ACCURACY = 1e-7, 1e-7  # rad, of finite differences; accepted tip error, fraction of the reach
MIN_SINGULAR_VALUE = 0.1  # reaches per radian; a path avoids directions of smaller tip motion
MAX_ANGLE = 2.5  # rad; largest motor angle on a path


def path_phase(time: Array, period: Array) -> Array:
    """Return the phase on the path (rad) at times (s).

    The rate is zero at first and constant after a fraction of the period (s).
    """
    ramp = RAMP_FRACTION * period
    return 2.0 * np.pi / period * (time - ramp * np.tanh(time / ramp))


def evaluate_series(series: Array, phases: Array) -> Array:
    """Return the values (r, p, size) of Fourier series (r, size, 2 h + 1) at phases (r, p), rad.

    A series holds the mean, then the factors of cosine and sine of each harmonic.
    """
    result = np.zeros((*phases.shape, series.shape[1]))
    fourier_series(series, phases, result)
    return result


def _circle(random: np.random.Generator, size: float) -> Array:
    """Return the series (3, 2 h + 1) of a circle with a radius (m) in the plane of the first two axes."""
    result = np.zeros((3, 2 * HARMONICS + 1))
    result[0, 1] = result[1, 2] = size
    return result


def _lemniscate(random: np.random.Generator, size: float) -> Array:
    """Return the series of a lemniscate of Gerono, a figure of eight of length 2 size (m)."""
    result = np.zeros((3, 2 * HARMONICS + 1))
    result[0, 1], result[1, 4] = size, 0.5 * size
    return result


def _smooth(random: np.random.Generator, size: float) -> Array:
    """Return a random series with harmonics weighted by 1 / k^2, scaled to a largest distance (m) from its mean."""
    result = np.zeros((3, 2 * HARMONICS + 1))
    weights = np.repeat(np.arange(1, HARMONICS + 1), 2) ** 2
    result[:, 1:] = random.standard_normal((3, 2 * HARMONICS)) / weights
    points = evaluate_series(result[None], COLLOCATION_PHASES)[0]
    return result * size / np.sqrt(np.vecdot(points, points).max())


PATH_SHAPES: dict[str, Callable[[np.random.Generator, float], Array]] = {
    "circle": _circle,
    "lemniscate": _lemniscate,
    "smooth": _smooth,
}


def _draw_path(shape: str, size: float, reach: float, random: np.random.Generator, view: View) -> tuple[Array, Array]:
    """Draw a path that the arm can follow, and the motor angles along it.

    Centres are drawn until the tip can move in at least two directions there and all postures are found. Under gravity
    the path includes the sag of the arm.

    Args:
        shape: a name in PATH_SHAPES.
        size: largest distance from the centre, m.
        reach: largest motor angle at the centre of the path, rad.
        random: generator of the episode.
        view: view of the arm.

    Returns:
        Series (3, 2 h + 1) of the tip in the base frame, m, and (n, 2 h + 1) of the motor angles, rad.

    Raises:
        ValueError: if the tip of this arm cannot follow a path of that size in two directions.
    """
    for _ in range(TRIES):
        centres = random.uniform(-reach, reach, (CENTRES, view.n_joints))
        tips, jacobians = _jacobians(view, centres)
        directions, gains, _ = np.linalg.svd(jacobians, full_matrices=False)
        counts = np.count_nonzero(gains >= MIN_SINGULAR_VALUE * view.reach, axis=1)
        for i in np.flatnonzero(counts >= 2):
            curve = _frame(random, directions[i], counts[i]).T @ PATH_SHAPES[shape](random, size)
            curve[:, 0] += tips[i]
            postures, error = view.inverse_kinematics(evaluate_series(curve[None], COLLOCATION_PHASES)[0], centres[i])
            if error <= ACCURACY * view.reach and np.abs(postures).max() <= MAX_ANGLE:
                if view.has_gravity:
                    points = postures[::SAG_STRIDE]
                    curve += _series(view.rest_tips(points) - view.rigid_tips(points), HARMONICS)
                return curve, _series(postures, POSTURE_HARMONICS)
    raise value_error("Track.size", size, "m, a path that the tip of this arm can follow in at least two directions")


def _frame(random: np.random.Generator, directions: Array, count: int) -> Array:
    """Return the axes (3, 3), as rows, of a random frame in the first `count` directions (2 or 3) of (3, n).

    A missing third axis is zero.
    """
    if count == 3:
        result: Array = np.linalg.qr(random.standard_normal((3, 3)))[0]
        return result
    angle = random.uniform(0.0, 2.0 * np.pi)
    rotation = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
    return np.vstack([rotation @ directions[:, :2].T, np.zeros(3)])


def _jacobians(view: View, postures: Array) -> tuple[Array, Array]:
    """Return the tips (r, 3) of the rigid arm at postures (r, n), and their Jacobians (r, 3, n) by differences."""
    steps = np.vstack([np.zeros(view.n_joints), STEP * np.eye(view.n_joints)])
    tips = view.rigid_tips((postures[:, None] + steps).reshape(-1, view.n_joints))
    tips = tips.reshape(len(postures), len(steps), 3)
    return tips[:, 0], (tips[:, 1:] - tips[:, :1]).transpose(0, 2, 1) / STEP


def _series(values: Array, harmonics: int) -> Array:
    """Return the Fourier series (n, 2 harmonics + 1) of values (r, n) at equal intervals of a period."""
    parts = np.fft.rfft(values, axis=0)[: harmonics + 1].T / len(values)
    result = np.zeros((values.shape[1], 2 * harmonics + 1))
    result[:, 0] = parts[:, 0].real
    result[:, 1::2], result[:, 2::2] = 2.0 * parts[:, 1:].real, -2.0 * parts[:, 1:].imag
    return result


ANY = "any"


@dataclass(frozen=True)
class Track:
    """Track: follow a closed path in space with the tip.

    Description
        A target moves along a closed path, a circle, a lemniscate (a figure of eight) or a random smooth curve, fast
        enough to excite the first mode of the arm. The tip should stay on the target. The target starts from rest and
        reaches its full speed after about half a period.

    Actions
        As in every environment: motor torques as fractions of the torque limits.

    Observations
        Those of the sensors of the environment. With a preview the task adds an entry:

        slice    entries     unit  bound
        preview  3 per time  m     (1 + deflection limit) of the reach   future positions of the target, base frame

    Reward
        At most 1 per control period, the sum of these terms:
            distance       1 - ln(1 + (e^2 + (0.1 s v)^2) / n^2) / ln(1 + (f / n)^2) with tip error e, speed v of
                           the tip relative to the target, n = R / 425 and f = R / 1.7 for a reach R (20 mm and 5 m for
                           8.5 m)
            failure        -failure_penalty when the step ended the episode by a limit or a divergence

    Start
        At rest at the first point of the path. The centre of the path is the position of the tip at motor angles drawn
        uniformly from [-middle, middle]. The path lies in a random plane, or in space, spanned by the directions in
        which the tip can move there.

    End
        Truncated after the horizon of the environment; terminated by a failure.

    Arguments
        The attributes below.

    Version history
        v0: first version.

    Attributes:
        path: "circle", "lemniscate", "smooth", or "any" of them, drawn for each episode.
        size: largest distance of the path from its centre, as a fraction of the reach.
        period: range (low, high) from which the time of one revolution is drawn uniformly, in periods of the first mode
            of the arm with locked motors; in seconds for a rigid arm.
        preview: look-ahead times (s) of the observed target; () for none.
        middle: largest motor angle at the centre of the path, rad.
        failure_penalty: reward lost by a failure, >= 0.
    """

    path: str = ANY
    size: float = 0.06
    period: Vector = (2.5, 5.0)
    preview: Vector = ()
    middle: float = 0.8
    failure_penalty: float = 10.0
    moves: ClassVar[bool] = True
    metrics: ClassVar[tuple[str, ...]] = MOVING_METRICS

    def __post_init__(self) -> None:
        times = sequence("Track.preview", self.preview, "times (s)")
        set_fields(
            self,
            path=one_of("Track.path", self.path, (*PATH_SHAPES, ANY)),
            size=positive("Track.size", self.size, "of the reach"),
            period=tuple(vector("Track.period", self.period, 2)),
            preview=tuple(positive(f"Track.preview[{i}]", time, "s") for i, time in enumerate(times)),
            middle=positive("Track.middle", self.middle, "rad"),
            failure_penalty=non_negative("Track.failure_penalty", self.failure_penalty),
        )
        if not 0.0 < self.period[0] <= self.period[1]:
            raise value_error("Track.period", self.period, "a range (low, high) with 0 < low <= high")

    @property
    def sensors(self) -> tuple[Sensor, ...]:
        """Sensor with a preview of the path, or None."""
        return (_Preview(self.preview),) if self.preview else ()

    def draw(self, random: np.random.Generator, view: View) -> dict[str, Array]:
        """Draw the path of one episode: tip (m), motor angles (rad), time of one revolution (s), and start (rad)."""
        shape = list(PATH_SHAPES)[random.integers(len(PATH_SHAPES))] if self.path == ANY else self.path
        mode = 1.0 / view.first_frequency if np.isfinite(view.first_frequency) else 1.0
        period = random.uniform(self.period[0], self.period[1]) * mode
        path, postures = _draw_path(shape, self.size * view.reach, self.middle, random, view)
        start = evaluate_series(postures[None], np.zeros((1, 1)))[0, 0]
        return {"start": start, "path": path, "postures": postures, "period": np.array(period)}

    def goal(self, plan: Mapping[str, Array], time: Array, view: View) -> Goal:
        """Return the position of the target on its path, and the posture for it."""
        phases = path_phase(time, plan["period"])[:, None]
        return Goal(evaluate_series(plan["path"], phases)[:, 0], evaluate_series(plan["postures"], phases)[:, 0])

    def reward_terms(self, view: View) -> dict[str, Number]:
        """Return the terms of the reward, see the class."""
        return {
            "distance": distance_reward(view, view.tip_velocity - view.target_velocity),
            "failure": 0.0 - self.failure_penalty * view.failed,
        }

    def info(self, view: View) -> dict[str, Number]:
        """Return the mean velocity (3,) of the target in the last control period, m/s."""
        return {"target_velocity": view.target_velocity}


class _Preview:
    """Sensor of the future positions of the target of `Track`, at look-ahead times (s)."""

    measures: ClassVar[tuple[str, ...]] = ()

    def __init__(self, times: Vector) -> None:
        self._times = np.array(times)

    def entries(self, view: View, limits: Limits) -> Sequence[Entry]:
        """Return the entry: three numbers for each look-ahead time."""
        return [Entry("preview", 3 * len(self._times), "m", (1.0 + limits.deflection) * view.reach)]

    def read(self, view: View, out: Array) -> None:
        """Write the future positions into out (b, 3 times), m."""
        phases = path_phase(view.time[:, None] + self._times, view.plan["period"][:, None])
        out[:] = evaluate_series(view.plan["path"], phases).reshape(len(out), -1)

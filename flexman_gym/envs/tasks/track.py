"""Track: follow a closed path in space with the tip."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from flexman_gym.common.arrays import Array, Vector
from flexman_gym.common.checks import non_negative, one_of, positive, sequence, set_fields, vector
from flexman_gym.common.errors import value_error
from flexman_gym.envs.limits import Limits
from flexman_gym.envs.sensors.sensor import Entry, Sensor
from flexman_gym.envs.tasks.rewards import distance_reward
from flexman_gym.envs.tasks.task import TRACKING_METRICS, Goal
from flexman_gym.envs.view import Number, View
from flexman_gym.kernels.control_period import fourier_series

HARMONICS, POSTURE_HARMONICS = 3, 12  # numbers of harmonics of the Fourier series of the path and the motor angles
COLLOCATION_POINTS = 28  # points of the path at which the motor angles are computed
SAG_STRIDE = 4  # the sag under gravity is computed at every SAG_STRIDE-th of these points
RAMP_FRACTION = 0.25  # fraction of the period; time constant of the acceleration of the target
COLLOCATION_PHASES = 2.0 * np.pi * np.arange(COLLOCATION_POINTS)[None] / COLLOCATION_POINTS
TRIES, CENTRES = 20, 8  # largest number of sets of centres drawn for a path; centres in a set
STEP = 1e-7  # rad; step of the finite differences
ACCURACY = 1e-7  # fraction of the reach; accepted error of the inverse kinematics
MIN_SINGULAR_VALUE = 0.1  # fraction of the reach per radian; a path has no directions with less tip motion
MAX_ANGLE = 2.5  # rad; largest motor angle on a path


def _path_phase(time: Array, period: Array) -> Array:
    """Return the phase on the path, rad, at times, s, for periods of revolution, s.

    The rate of the phase increases from zero to 2 pi / period with the time constant RAMP_FRACTION period.
    """
    ramp = RAMP_FRACTION * period
    return 2.0 * np.pi / period * (time - ramp * np.tanh(time / ramp))


def _evaluate_series(series: Array, phases: Array) -> Array:
    """Return the values (r, p, size) of Fourier series (r, size, 2 h + 1) at phases (r, p), rad.

    The coefficients of a series with h harmonics are the mean, then the coefficients of cosine and sine of each
    harmonic.
    """
    result = np.zeros((*phases.shape, series.shape[1]))
    fourier_series(series, phases, result)
    return result


def _circle(random: np.random.Generator, size: float) -> Array:
    """Return the Fourier series (3, 2 h + 1) of a circle of radius `size`, m, in the plane of the first two axes."""
    result = np.zeros((3, 2 * HARMONICS + 1))
    result[0, 1] = result[1, 2] = size
    return result


def _lemniscate(random: np.random.Generator, size: float) -> Array:
    """Return the Fourier series (3, 2 h + 1), with h harmonics, of a lemniscate of Gerono 2 `size` (m) wide."""
    result = np.zeros((3, 2 * HARMONICS + 1))
    result[0, 1], result[1, 4] = size, 0.5 * size
    return result


def _smooth(random: np.random.Generator, size: float) -> Array:
    """Return a random Fourier series (3, 2 h + 1) with the largest distance `size`, m, from its mean.

    The amplitude of harmonic k is weighted by 1 / k^2.
    """
    result = np.zeros((3, 2 * HARMONICS + 1))
    weights = np.repeat(np.arange(1, HARMONICS + 1), 2) ** 2
    result[:, 1:] = random.standard_normal((3, 2 * HARMONICS)) / weights
    points = _evaluate_series(result[None], COLLOCATION_PHASES)[0]
    return result * size / np.sqrt(np.vecdot(points, points).max())


PATH_SHAPES: dict[str, Callable[[np.random.Generator, float], Array]] = {
    "circle": _circle,
    "lemniscate": _lemniscate,
    "smooth": _smooth,
}


def _draw_path(
    shape: str, size: float, max_angle: float, random: np.random.Generator, view: View
) -> tuple[Array, Array]:
    """Draw a path that the arm can follow, and the motor angles along it.

    Postures of the centre are drawn until the tip can move there in at least two directions and the inverse kinematics
    converges on the whole path. Under gravity the path includes the sag of the arm.

    Args:
        shape: a name in PATH_SHAPES.
        size: largest distance from the centre, m.
        max_angle: largest motor angle at the centre of the path, rad.
        random: random generator of the arm.
        view: view of the arm.

    Returns:
        Fourier series (3, 2 h + 1) of the tip in the base frame, m, and (n, 2 h + 1) of the motor angles, rad.

    Raises:
        ValueError: if the tip of this arm cannot follow a path of this size in two directions.
    """
    for _ in range(TRIES):
        centres = view.postures.draw_starts(random, max_angle, (CENTRES,))
        tips, jacobians = _jacobians(view, centres)
        directions, gains, _ = np.linalg.svd(jacobians, full_matrices=False)
        ranks = np.count_nonzero(gains >= MIN_SINGULAR_VALUE * view.reach, axis=1)
        for i in np.flatnonzero(ranks >= 2):
            curve = _frame(random, directions[i], ranks[i]).T @ PATH_SHAPES[shape](random, size)
            curve[:, 0] += tips[i]
            postures, error = view.inverse_kinematics(_evaluate_series(curve[None], COLLOCATION_PHASES)[0], centres[i])
            if error <= ACCURACY * view.reach and _allowed(postures, view):
                if view.has_gravity:
                    points = postures[::SAG_STRIDE]
                    curve += _series(view.rest_tips(points) - view.rigid_tips(points), HARMONICS)
                return curve, _series(postures, POSTURE_HARMONICS)
    raise value_error("Track.size", size, "m, a path that the tip of this arm can follow in at least two directions")


def _allowed(postures: Array, view: View) -> bool:
    """Return True if motor angles (t, n), rad, are near the middle of the ranges of the joints, and within them."""
    return bool(np.abs(postures - view.postures.home).max() <= MAX_ANGLE) and view.postures.contains(postures)


def _frame(random: np.random.Generator, directions: Array, count: int) -> Array:
    """Return the axes (3, 3), as rows, of a random frame spanned by the first 2 or 3 columns of directions (3, n).

    For 2 columns the third axis is zero.
    """
    if count == 3:
        result: Array = np.linalg.qr(random.standard_normal((3, 3)))[0]
        return result
    angle = random.uniform(0.0, 2.0 * np.pi)
    rotation = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
    return np.vstack([rotation @ directions[:, :2].T, np.zeros(3)])


def _jacobians(view: View, postures: Array) -> tuple[Array, Array]:
    """Return tip positions (r, 3), m, of the rigid arm at postures (r, n), rad, and Jacobians (r, 3, n), m/rad."""
    steps = np.vstack([np.zeros(view.n_joints), STEP * np.eye(view.n_joints)])
    tips = view.rigid_tips((postures[:, None] + steps).reshape(-1, view.n_joints))
    tips = tips.reshape(len(postures), len(steps), 3)
    return tips[:, 0], (tips[:, 1:] - tips[:, :1]).transpose(0, 2, 1) / STEP


def _series(values: Array, harmonics: int) -> Array:
    """Return the Fourier series (n, 2 harmonics + 1) of values (r, n) at r equal intervals of a period."""
    parts = np.fft.rfft(values, axis=0)[: harmonics + 1].T / len(values)
    result = np.zeros((values.shape[1], 2 * harmonics + 1))
    result[:, 0] = parts[:, 0].real
    result[:, 1::2], result[:, 2::2] = 2.0 * parts[:, 1:].real, -2.0 * parts[:, 1:].imag
    return result


ANY = "any"  # value of `Track.path` for a shape drawn in each episode


@dataclass(frozen=True)
class Track:
    """Track: follow a closed path in space with the tip.

    Description
        A target moves along a closed path, a circle, a lemniscate (a figure of eight) or a random smooth curve, fast
        enough to excite the first mode of the arm. The tip should stay on the target. The target starts from rest and
        reaches its full speed after about half a revolution.

    Actions
        As in every environment: motor torques as fractions of the torque limits.

    Observations
        Readings of the sensors of the environment. With a preview the task adds an entry:

        slice    entries     unit  bound
        preview  3 per time  m     (1 + deflection limit) * reach   future positions of the target, base frame

    Reward
        At most 1 per control period, the sum of these terms:
            distance       1 - ln(1 + (e^2 + (T v / 32)^2) / n^2) / ln(1 + (f / n)^2) with tip error e, speed v of
                           the tip relative to the target, slew time T of the environment (3.2 s), n = R / 425 and
                           f = R / 1.7 for a reach R (20 mm and 5 m for R = 8.5 m)
            failure        -failure_penalty if the arm exceeded a limit or its simulation diverged, else 0

    Start
        At rest at the first point of the path. The centre of the path is the position of the tip at motor angles drawn
        uniformly from [-middle, middle], rad. The orientation of the path is random, within the plane or the space in
        which the tip can move at its centre.

    End
        Truncated after the horizon of the environment; terminated by a failure.

    Arguments
        The attributes below.

    Version history
        v0: first version.

    Attributes:
        path: "circle", "lemniscate", "smooth", or "any" for one of these shapes drawn in each episode.
        size: largest distance of the path from its centre, as a fraction of the reach.
        period: range (low, high) from which the time of one revolution is drawn uniformly, in periods of the first mode
            of the arm with locked motors; in seconds for a rigid arm.
        preview: look-ahead times of the observed positions of the target, s; () for no observation of the path.
        middle: largest magnitude of a motor angle of the posture at the centre of the path, rad.
        failure_penalty: penalty subtracted from the reward after a failure, >= 0.
    """

    path: str = ANY
    size: float = 0.06
    period: Vector = (2.5, 5.0)
    preview: Vector = ()
    middle: float = 0.8
    failure_penalty: float = 10.0
    moves: ClassVar[bool] = True
    metrics: ClassVar[tuple[str, ...]] = TRACKING_METRICS

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
        """Sensor of future positions of the target; () without `preview`."""
        return (_Preview(self.preview),) if self.preview else ()

    def draw(self, random: np.random.Generator, view: View) -> dict[str, Array]:
        """Draw the parameters of an episode.

        Returns:
            "start", motor angles (n,), rad; "path", Fourier series (3, 2 h + 1) of the tip, m; "postures", Fourier
            series (n, 2 h + 1) of the motor angles, rad; and "period" of a revolution, s.
        """
        shape = list(PATH_SHAPES)[random.integers(len(PATH_SHAPES))] if self.path == ANY else self.path
        unit = 1.0 / view.first_frequency if np.isfinite(view.first_frequency) else 1.0
        period = random.uniform(self.period[0], self.period[1]) * unit
        path, postures = _draw_path(shape, self.size * view.reach, self.middle, random, view)
        start = _evaluate_series(postures[None], np.zeros((1, 1)))[0, 0]
        return {"start": start, "path": path, "postures": postures, "period": np.array(period)}

    def goal(self, parameters: Mapping[str, Array], time: Array, view: View) -> Goal:
        """Return the positions of the target on its paths, and the motor angles for them."""
        phases = _path_phase(time, parameters["period"])[:, None]
        return Goal(
            _evaluate_series(parameters["path"], phases)[:, 0], _evaluate_series(parameters["postures"], phases)[:, 0]
        )

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
    """Sensor of future positions of the target of `Track`, at look-ahead times, s."""

    measures: ClassVar[tuple[str, ...]] = ()

    def __init__(self, times: Vector) -> None:
        self._times = np.array(times)

    def entries(self, view: View, limits: Limits) -> Sequence[Entry]:
        """Return the entry: three numbers for each look-ahead time."""
        return [Entry("preview", 3 * len(self._times), "m", (1.0 + limits.deflection) * view.reach)]

    def read(self, view: View, out: Array) -> None:
        """Write the future positions into out (b, 3 t), m, for t look-ahead times."""
        phases = _path_phase(view.time[:, None] + self._times, view.episode_parameters["period"][:, None])
        out[:] = _evaluate_series(view.episode_parameters["path"], phases).reshape(len(out), -1)

"""Track: the task of following a closed path in space with the tip, and its Fourier series."""

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

HARMONICS, POSTURE_HARMONICS = 3, 12  # of the curve, and of the motors
COLLOCATION_POINTS = 28  # places at which motors are solved for
SAG_STRIDE = 4  # of these places, every so many, tell how the arm sags
RAMP_FRACTION = 0.25  # of a period, in which the target gains speed
COLLOCATION_PHASES = 2.0 * np.pi * np.arange(COLLOCATION_POINTS)[None] / COLLOCATION_POINTS
TRIES, CENTRES, STEP, ACCURACY = 20, 8, 1e-7, 1e-7  # rad, of differences; of the reach, of a posture
MIN_SINGULAR_VALUE = 0.1  # of the reach: a tip moves less per radian in directions that a path avoids
MAX_ANGLE = 2.5  # rad, of a motor on a path


def path_phase(time: Array, period: Array) -> Array:
    """Gives the phase (rad) on paths at times (s): from rest, and steady after a part of the period (s)."""
    ramp = RAMP_FRACTION * period
    return 2.0 * np.pi / period * (time - ramp * np.tanh(time / ramp))


def evaluate_series(series: Array, phases: Array) -> Array:
    """Gives the values (r, p, size) of Fourier series (r, size, 2 h + 1) at phases (r, p).

    A series is a mean, then a factor of the cosine and one of the sine of each harmonic.
    """
    result = np.zeros((*phases.shape, series.shape[1]))
    fourier_series(series, phases, result)
    return result


def _circle(random: np.random.Generator, size: float) -> Array:
    """Gives the series (3, 2 h + 1) of a circle of a radius (m) in the plane of the first two axes."""
    result = np.zeros((3, 2 * HARMONICS + 1))
    result[0, 1] = result[1, 2] = size
    return result


def _lemniscate(random: np.random.Generator, size: float) -> Array:
    """Gives the series of a lemniscate of Gerono, a figure of eight as long as 2 sizes (m)."""
    result = np.zeros((3, 2 * HARMONICS + 1))
    result[0, 1], result[1, 4] = size, 0.5 * size
    return result


def _smooth(random: np.random.Generator, size: float) -> Array:
    """Gives a random series whose harmonic k weighs 1 / k^2; it goes as far as a size (m) from its mean."""
    result = np.zeros((3, 2 * HARMONICS + 1))
    weights = np.repeat(np.arange(1, HARMONICS + 1), 2) ** 2
    result[:, 1:] = random.standard_normal((3, 2 * HARMONICS)) / weights
    places = evaluate_series(result[None], COLLOCATION_PHASES)[0]
    return result * size / np.sqrt(np.vecdot(places, places).max())


PATH_SHAPES: dict[str, Callable[[np.random.Generator, float], Array]] = {
    "circle": _circle,
    "lemniscate": _lemniscate,
    "smooth": _smooth,
}


def _draw_path(shape: str, size: float, reach: float, random: np.random.Generator, view: View) -> tuple[Array, Array]:
    """Draws a path that an arm can follow, and the motor angles with which it does.

    Middles are drawn until the tip can move in at least two directions there and all postures are found. Where an arm
    has weight, the path sags as the arm does.

    Args:
        shape: a name of SHAPES.
        size: of the path, m.
        reach: rad, up to which to either side the motors are turned in the middle of the path.
        random: the generator of the episode.
        view: of the arm.

    Returns:
        Series (3, 2 h + 1) m of the tip in the base frame, and (n, 2 h + 1) rad of the motors.

    Raises:
        ValueError: for an arm whose tip cannot move so far in two directions.
    """
    for _ in range(TRIES):
        middles = random.uniform(-reach, reach, (CENTRES, view.n_joints))
        tips, slopes = _slopes(view, middles)
        ways, moves, _ = np.linalg.svd(slopes, full_matrices=False)
        counts = np.count_nonzero(moves >= MIN_SINGULAR_VALUE * view.reach, axis=1)
        for i in np.flatnonzero(counts >= 2):
            curve = _frame(random, ways[i], counts[i]).T @ PATH_SHAPES[shape](random, size)
            curve[:, 0] += tips[i]
            postures, left = view.reaching(evaluate_series(curve[None], COLLOCATION_PHASES)[0], middles[i])
            if left <= ACCURACY * view.reach and np.abs(postures).max() <= MAX_ANGLE:
                if view.heavy:
                    places = postures[::SAG_STRIDE]
                    curve += _series(view.rest_tips(places) - view.rigid_tips(places), HARMONICS)
                return curve, _series(postures, POSTURE_HARMONICS)
    raise value_error("Track.size", size, "m, a path that the tip of this arm can follow in at least two directions")


def _frame(random: np.random.Generator, ways: Array, count: int) -> Array:
    """Axes (3, 3), as rows, of a random frame in the first `count` of ways (3, n), 2 or 3; zero where there is none."""
    if count == 3:
        result: Array = np.linalg.qr(random.standard_normal((3, 3)))[0]
        return result
    angle = random.uniform(0.0, 2.0 * np.pi)
    turn = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
    return np.vstack([turn @ ways[:, :2].T, np.zeros(3)])


def _slopes(view: View, postures: Array) -> tuple[Array, Array]:
    """Tips (r, 3) of the rigid arm at postures (r, n), and their motion per radian of each motor, (r, 3, n)."""
    turns = np.vstack([np.zeros(view.n_joints), STEP * np.eye(view.n_joints)])
    tips = view.rigid_tips((postures[:, None] + turns).reshape(-1, view.n_joints))
    tips = tips.reshape(len(postures), len(turns), 3)
    return tips[:, 0], (tips[:, 1:] - tips[:, :1]).transpose(0, 2, 1) / STEP


def _series(values: Array, harmonics: int) -> Array:
    """The Fourier series (n, 2 harmonics + 1) of values (r, n) at equal intervals of a period."""
    parts = np.fft.rfft(values, axis=0)[: harmonics + 1].T / len(values)
    result = np.zeros((values.shape[1], 2 * harmonics + 1))
    result[:, 0] = parts[:, 0].real
    result[:, 1::2], result[:, 2::2] = 2.0 * parts[:, 1:].real, -2.0 * parts[:, 1:].imag
    return result


ANY = "any"


@dataclass(frozen=True)
class Track:
    """Track: lead the tip along a path in space.

    Description
        A target runs round a closed path, a circle, a lemniscate (a figure of eight) or a random smooth curve, so fast
        that the first mode of the arm matters. The tip is to stay on it. The target starts from rest and has its full
        speed after about half a period.

    Actions
        As of every environment: motor torques as parts of the torque limits.

    Observations
        As the sensors say. With a preview the task adds an entry:

        slice    entries     unit  bound
        preview  3 per time  m     (1 + deflection limit) of the reach   where the target will be, base frame

    Reward
        At most 1 a control period, the sum of these terms:
            distance       1 - ln(1 + (e^2 + (0.1 s v)^2) / n^2) / ln(1 + (f / n)^2); e is the tip error, v the speed of
                           the tip relative to the target, n = R / 425 (20 mm) and f = R / 1.7 (5 m) for a reach R, in
                           brackets for 8.5 m
            failure        -failure_penalty when the step ended the episode by a limit or a divergence

    Start
        At rest where the path begins. The middle of the path is where the tip is at motor angles drawn uniformly from
        +-middle; the path lies in a random plane, or in space, of the directions into which the tip can move there.

    End
        Truncated after the horizon of the environment; terminated by a failure.

    Arguments
        Those below.

    Version history
        v0: first version.

    Attributes:
        path: "circle", "lemniscate", "smooth", or "any" of them, drawn for each episode.
        size: how far the path goes from its middle, a part of the reach.
        period: range (low, high) from which the time for one round is drawn uniformly, in periods of the first mode of
            the arm with its motors held; in seconds for an arm that does not bend.
        preview: times (s) ahead at which the target is seen; () for none.
        middle: rad.
        failure_penalty: reward lost by a failure, >= 0.

    Raises:
        ValueError: one line with field, value and what is allowed.
    """

    path: str = ANY
    size: float = 0.06
    period: Vector = (2.5, 5.0)
    preview: Vector = ()
    middle: float = 0.8
    failure_penalty: float = 10.0
    moves: ClassVar[bool] = True
    figures: ClassVar[tuple[str, ...]] = MOVING_METRICS

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
        """What of the path is seen beside the sensors of the environment."""
        return (_Preview(self.preview),) if self.preview else ()

    def draw(self, random: np.random.Generator, view: View) -> dict[str, Array]:
        """The path of one episode: series of the tip (m) and of the motors (rad), the time for a round, the start."""
        shape = list(PATH_SHAPES)[random.integers(len(PATH_SHAPES))] if self.path == ANY else self.path
        mode = 1.0 / view.first_frequency if np.isfinite(view.first_frequency) else 1.0
        period = random.uniform(self.period[0], self.period[1]) * mode
        path, postures = _draw_path(shape, self.size * view.reach, self.middle, random, view)
        start = evaluate_series(postures[None], np.zeros((1, 1)))[0, 0]
        return {"start": start, "path": path, "postures": postures, "period": np.array(period)}

    def goal(self, plan: Mapping[str, Array], time: Array, view: View) -> Goal:
        """Where the target is on its path, and the posture that belongs to it."""
        phases = path_phase(time, plan["period"])[:, None]
        return Goal(evaluate_series(plan["path"], phases)[:, 0], evaluate_series(plan["postures"], phases)[:, 0])

    def reward_terms(self, view: View) -> dict[str, Number]:
        """Terms of the reward, see the class."""
        return {
            "distance": distance_reward(view, view.tip_velocity - view.target_velocity),
            "failure": 0.0 - self.failure_penalty * view.failed,
        }

    def info(self, view: View) -> dict[str, Number]:
        """Velocity of the target (3,) m/s, over the last control period."""
        return {"target_velocity": view.target_velocity}


class _Preview:
    """Where the target of `Track` will be at some times (s) ahead."""

    measures: ClassVar[tuple[str, ...]] = ()

    def __init__(self, times: Vector) -> None:
        self._ahead = np.array(times)

    def entries(self, view: View, limits: Limits) -> Sequence[Entry]:
        """Says what it reads: three numbers for each time."""
        return [Entry("preview", 3 * len(self._ahead), "m", (1.0 + limits.deflection) * view.reach)]

    def read(self, view: View, out: Array) -> None:
        """Writes into out (b, 3 times)."""
        phases = path_phase(view.time[:, None] + self._ahead, view.plan["period"][:, None])
        out[:] = evaluate_series(view.plan["path"], phases).reshape(len(out), -1)

"""Paths: closed curves in space as Fourier series, and the postures with which an arm follows them."""

from collections.abc import Callable

import numpy as np

from flexman_gym.arrays import Array
from flexman_gym.checks import refusal
from flexman_gym.kernels import paths as kernels
from flexman_gym.simulation.view import View

HARMONICS, POSTURE_HARMONICS = 3, 12  # of the curve, and of the motors
KNOTS = 28  # places at which motors are solved for
SAGGING = 4  # of these places, every so many, tell how the arm sags
RAMP = 0.25  # of a period, in which the target gains speed
ROUND = 2.0 * np.pi * np.arange(KNOTS)[None] / KNOTS
TRIES, MIDDLES, STEP, ACCURACY = 20, 8, 1e-7, 1e-7  # rad, of differences; of the reach, of a posture
WORTH = 0.1  # of the reach: a tip moves less per radian in directions that a path avoids
FURTHEST = 2.5  # rad, of a motor on a path


def phase(time: Array, period: Array) -> Array:
    """Gives the phase (rad) on paths at times (s): from rest, and steady after a part of the period (s)."""
    ramp = RAMP * period
    return 2.0 * np.pi / period * (time - ramp * np.tanh(time / ramp))


def on_series(series: Array, phases: Array) -> Array:
    """Gives the values (r, p, size) of Fourier series (r, size, 2 h + 1) at phases (r, p).

    A series is a mean, then a factor of the cosine and one of the sine of each harmonic.
    """
    result = np.zeros((*phases.shape, series.shape[1]))
    kernels.on_series(series, phases, result)
    return result


def circle(random: np.random.Generator, size: float) -> Array:
    """Gives the series (3, 2 h + 1) of a circle of a radius (m) in the plane of the first two axes."""
    result = np.zeros((3, 2 * HARMONICS + 1))
    result[0, 1] = result[1, 2] = size
    return result


def lemniscate(random: np.random.Generator, size: float) -> Array:
    """Gives the series of a lemniscate of Gerono, a figure of eight as long as 2 sizes (m)."""
    result = np.zeros((3, 2 * HARMONICS + 1))
    result[0, 1], result[1, 4] = size, 0.5 * size
    return result


def smooth(random: np.random.Generator, size: float) -> Array:
    """Gives a random series whose harmonic k weighs 1 / k^2; it goes as far as a size (m) from its mean."""
    result = np.zeros((3, 2 * HARMONICS + 1))
    weights = np.repeat(np.arange(1, HARMONICS + 1), 2) ** 2
    result[:, 1:] = random.standard_normal((3, 2 * HARMONICS)) / weights
    places = on_series(result[None], ROUND)[0]
    return result * size / np.sqrt(np.vecdot(places, places).max())


SHAPES: dict[str, Callable[[np.random.Generator, float], Array]] = {
    "circle": circle,
    "lemniscate": lemniscate,
    "smooth": smooth,
}


def place_path(shape: str, size: float, reach: float, random: np.random.Generator, view: View) -> tuple[Array, Array]:
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
        middles = random.uniform(-reach, reach, (MIDDLES, view.n_joints))
        tips, slopes = _slopes(view, middles)
        ways, moves, _ = np.linalg.svd(slopes, full_matrices=False)
        counts = np.count_nonzero(moves >= WORTH * view.reach, axis=1)
        for i in np.flatnonzero(counts >= 2):
            curve = _frame(random, ways[i], counts[i]).T @ SHAPES[shape](random, size)
            curve[:, 0] += tips[i]
            postures, left = view.reaching(on_series(curve[None], ROUND)[0], middles[i])
            if left <= ACCURACY * view.reach and np.abs(postures).max() <= FURTHEST:
                if view.heavy:
                    places = postures[::SAGGING]
                    curve += _series(view.rest_tips(places) - view.rigid_tips(places), HARMONICS)
                return curve, _series(postures, POSTURE_HARMONICS)
    raise refusal("Track.size", size, "m, a path that the tip of this arm can follow in at least two directions")


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

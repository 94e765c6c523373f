"""Paths: closed curves in space as Fourier series, and the postures with which an arm follows them."""

from collections.abc import Callable

import numpy as np

from flexman_gym.arrays import Array
from flexman_gym.checks import refusal
from flexman_gym.kernels import paths as kernels
from flexman_gym.simulation.view import View

HARMONICS, POSTURE_HARMONICS, KNOTS = (
    3,
    12,
    28,
)  # of the curve, of the motors, and places at which motors are solved for
SAGGING = 4  # of these places, every so many, tell how the arm sags
RAMP = 0.25  # of a period, in which the target gains speed
ROUND = 2.0 * np.pi * np.arange(KNOTS)[None] / KNOTS
TRIES, STEP, ACCURACY = 100, 1e-7, 1e-7  # rad, of differences; of the reach, of a posture
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
    found = np.zeros((*phases.shape, series.shape[1]))
    kernels.on_series(series, phases, found)
    return found


def circle(random: np.random.Generator, size: float) -> Array:
    """Gives the series (3, 2 h + 1) of a circle of a radius (m) in the plane of the first two axes."""
    found = np.zeros((3, 2 * HARMONICS + 1))
    found[0, 1] = found[1, 2] = size
    return found


def lemniscate(random: np.random.Generator, size: float) -> Array:
    """Gives the series of a lemniscate of Gerono, a figure of eight as long as 2 sizes (m)."""
    found = np.zeros((3, 2 * HARMONICS + 1))
    found[0, 1], found[1, 4] = size, 0.5 * size
    return found


def smooth(random: np.random.Generator, size: float) -> Array:
    """Gives a random series whose harmonic k weighs 1 / k^2; it goes as far as a size (m) from its mean."""
    found = np.zeros((3, 2 * HARMONICS + 1))
    weights = np.repeat(np.arange(1, HARMONICS + 1), 2) ** 2
    found[:, 1:] = random.standard_normal((3, 2 * HARMONICS)) / weights
    places = on_series(found[None], ROUND)[0]
    return found * size / np.sqrt(np.vecdot(places, places).max())


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
        middle = random.uniform(-reach, reach, view.n_joints)
        tip, slopes = _slopes(view, middle)
        curve = _frame(random, view, slopes).T @ SHAPES[shape](random, size)
        if not curve.any():
            continue
        curve[:, 0] += tip
        postures, left = view.reaching(on_series(curve[None], ROUND)[0], middle)
        if left <= ACCURACY * view.reach and np.abs(postures).max() <= FURTHEST:
            if view.heavy:
                places = postures[::SAGGING]
                sag = _series(view.rest_tips(places) - view.rigid_tips(places), HARMONICS)
                curve += sag
            return curve, _series(postures, POSTURE_HARMONICS)
    raise refusal("Track.size", size, "m, a path that the tip of this arm can follow in at least two directions")


def _frame(random: np.random.Generator, view: View, slopes: Array) -> Array:
    """Axes (3, 3), as rows, of a random frame in the directions into which the tip can move; zero where it cannot."""
    ways, moves, _ = np.linalg.svd(slopes, full_matrices=False)
    count = int((moves >= WORTH * view.reach).sum())
    found = np.zeros((3, 3))
    if count == 3:
        found = np.linalg.qr(random.standard_normal((3, 3)))[0]
    elif count == 2:
        angle = random.uniform(0.0, 2.0 * np.pi)
        turn = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
        found[:2] = turn @ ways[:, :2].T
    return found


def _slopes(view: View, posture: Array) -> tuple[Array, Array]:
    """Tip (3,) of the rigid arm at a posture (n,), and its motion per radian of each motor, (3, n)."""
    tips = view.rigid_tips(posture + np.vstack([np.zeros(view.n_joints), STEP * np.eye(view.n_joints)]))
    return tips[0], (tips[1:] - tips[0]).T / STEP


def _series(values: Array, harmonics: int) -> Array:
    """The Fourier series (n, 2 harmonics + 1) of values (r, n) at equal intervals of a period."""
    parts = np.fft.rfft(values, axis=0)[: harmonics + 1].T / len(values)
    found = np.zeros((values.shape[1], 2 * harmonics + 1))
    found[:, 0] = parts[:, 0].real
    found[:, 1::2], found[:, 2::2] = 2.0 * parts[:, 1:].real, -2.0 * parts[:, 1:].imag
    return found

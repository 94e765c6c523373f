"""Frames: pictures of an arm at one state after another, painted in Matplotlib.

Matplotlib is imported when something is drawn.
"""

from collections.abc import Sequence
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from flexman_gym.arrays import Array
from flexman_gym.checks import refusal, vector, whole_number
from flexman_gym.draw.style import DARK, LIGHT, LINK_COLOURS, MIDDLE, RED, new_figure
from flexman_gym.model.element import NODE_COORDINATES, beam_shapes, find_element
from flexman_gym.model.model import Model

AZIMUTH, ELEVATION = np.radians(-62.0), np.radians(24.0)  # of the camera, seen from the base; +X points to the right
DISTANCE = 5.0  # from the camera to the base, in reaches of the arm
# Bounds of the picture, in reaches of the arm and seen from the base: it holds the ground and an arm that points up.
SIDE, BOTTOM, TOP = 1.04, -0.58, 1.03
POINTS = 16  # of the line of a link
LARGEST_PICTURE = 10_000  # pixels a side


def arm_lines(model: Model, state: Sequence[float] | Array, points: int = POINTS) -> Array:
    """Gives the deformed centreline of every link, from joint to tip, as points (n, points, 3) in the base frame, m.

    Between the nodes of an element the line has the shapes of the element, cubic for bending. With foreshortening its
    ends are exact.

    Args:
        model: the arm.
        state: (2 d,).
        points: number of points of each line, at least 2.

    Raises:
        ValueError: for a wrong shape, values that are not finite or fewer than 2 points.
    """
    x = np.array(vector("state", state, 2 * model.n_dof))
    constants = model.constants
    mounts = constants.mount.reshape(-1, 3, 3)
    lines = np.zeros((model.n_joints, whole_number("points", points, 2, 1000), 3))
    frame, origin, bend = np.eye(3), np.zeros(3), np.zeros(3)
    for i, shapes in enumerate(_centreline_shapes(model, points)):
        elastic = x[model.elastic_columns(i)]
        frame = frame @ _turn(bend) @ mounts[i] @ _turn(x[i] * constants.axis[i])
        local = shapes @ elastic
        local[:, 0] += np.linspace(0.0, constants.length[i], points)
        if model.choice.stiffening:
            local[:, 0] -= _shortened(model, i, elastic, local)
        lines[i] = origin + local @ frame.T
        origin = lines[i, -1]
        bend = elastic @ constants.tip_rotation[constants.elastic_start[i] : constants.elastic_start[i + 1]]
    return lines


def _shortened(model: Model, link: int, elastic: Array, line: Array) -> Array:
    """Gives the foreshortening (points,) along a line (points, 3), exact at the tip, else by its slopes."""
    constants = model.constants
    columns, stations = (slice(*field[link : link + 2]) for field in (constants.elastic_start, constants.station_start))
    entries = np.arange(*constants.bend_start[[columns.start, columns.stop]])
    # the first station is the tip
    values = constants.bend_value[constants.bend_row[link] + entries * (stations.stop - stations.start)]
    rows = np.repeat(elastic, np.diff(constants.bend_start[columns.start : columns.stop + 1]))
    tip = 0.5 * (values * rows) @ elastic[constants.bend_source[entries] - columns.start]
    drawn = np.cumsum(np.concatenate([[0.0], (np.diff(line[:, 1:], axis=0) ** 2).sum(axis=1)]))
    return tip * drawn / drawn[-1] if drawn[-1] > 0.0 else np.zeros(len(line))


@lru_cache(maxsize=16)
def _centreline_shapes(model: Model, points: int) -> tuple[Array, ...]:
    """Gives the displacement (points, 3, k_i) of even points of each link's centreline per unit coordinate."""
    result = []
    for i, (basis, length) in enumerate(zip(model.bases, model.constants.length, strict=True)):
        elements = model.elements(i) if basis.shape[1] else []
        shapes = np.zeros((points, 3, len(basis) + NODE_COORDINATES))
        for shape, place in zip(shapes, np.linspace(0.0, length, points), strict=True):
            if elements:
                element, xi = find_element(elements, place)
                shape[:, element.nodes] = beam_shapes(xi, element.length, 0.0, 0.0)
        result.append(shapes[:, :, NODE_COORDINATES:] @ basis)  # node 0 is clamped
    return tuple(result)


def _turn(rotation_vector: Array) -> Array:
    from scipy.spatial.transform import Rotation

    return Rotation.from_rotvec(rotation_vector).as_matrix()


class FramePainter:
    """Paints an arm at one state after another, always from the same camera and at the same scale.

    A frame shows the deformed links in colours, joints as dots, the tip, the rigid arm at the motor angles as a thin
    line, the shadow of the arm on the ground and the target, if any. The ground is a disc as wide as the reach. The
    picture holds all of it and the arm above it; it may lose the tip of an arm that points down.

    Args:
        model: the arm.
        size: width and height in pixels.

    Raises:
        ImportError: without Matplotlib.
        ValueError: for a size that is not two whole numbers.
    """

    def __init__(self, model: Model, size: tuple[int, int] = (480, 360)) -> None:
        if not isinstance(size, tuple | list) or len(size) != 2:
            raise refusal("size", size, "two numbers of pixels, width and height")
        self.size = tuple(whole_number(f"size[{i}]", side, 16, LARGEST_PICTURE) for i, side in enumerate(size))
        self.model = model
        self.reach = float(model.constants.length.sum())
        self._camera = _camera()
        width, height = self.size
        dpi = 100.0 * min(width / 480, height / 360)  # lines and dots grow with the picture
        # Matplotlib cuts a fraction of a pixel off: the tenth keeps rounding from cutting a whole one.
        self._figure = new_figure(((width + 0.1) / dpi, (height + 0.1) / dpi), dpi)
        self._axes = self._figure.add_axes((0.0, 0.0, 1.0, 1.0))
        half = np.array([width, height]) / 2 * self.reach * max(2 * SIDE / width, (TOP - BOTTOM) / height)
        middle = (TOP + BOTTOM) / 2 * self.reach
        self._axes.set(xlim=(-half[0], half[0]), ylim=(middle - half[1], middle + half[1]))
        self._axes.axis("off")
        self._ground()
        self._artists()

    def paint(self, state: Sequence[float] | Array, target: Sequence[float] | Array | None = None) -> NDArray[np.uint8]:
        """Paints the arm at a state.

        Args:
            state: (2 d,).
            target: (3,) in the base frame, m; None without one.

        Returns:
            The picture (height, width, 3).

        Raises:
            ValueError: for a wrong shape or values that are not finite.
        """
        lines = arm_lines(self.model, state)
        motors = np.asarray(state, dtype=float)[self.model.motor_columns]
        ghost = arm_lines(self.model, self.model.initial_state(motors.tolist()), points=2)
        self._draw(self._ghost, ghost.reshape(-1, 3))
        self._draw(self._shadow, lines.reshape(-1, 3) * (1.0, 1.0, 0.0))
        self._draw(self._joints, lines[:, 0])
        self._draw(self._tip, lines[-1, -1:])
        nearness = lines.mean(axis=1) @ self._camera[2]
        for line, (edge, core), rank in zip(lines, self._links, nearness.argsort().argsort(), strict=True):
            for artist in (edge, core):
                self._draw(artist, line)
                artist.set_zorder(10 + rank)
        for artist in (self._target, self._plumb):
            artist.set_visible(target is not None)
        if target is not None:
            place = np.array(vector("target", target, 3, "m"))
            self._draw(self._target, place[None])
            self._draw(self._plumb, place * [[1.0, 1.0, 1.0], [1.0, 1.0, 0.0]])
        self._figure.canvas.draw()
        return np.array(np.asarray(self._figure.canvas.buffer_rgba())[..., :3])

    def _draw(self, artist: Any, places: Array) -> None:
        artist.set_data(*self._project(places).T)

    def _project(self, places: Array) -> Array:
        """Gives picture coordinates (p, 2), in metres at the base, of places (p, 3) in the base frame."""
        seen = places @ self._camera.T
        distance = DISTANCE * self.reach
        return seen[:, :2] * (distance / (distance - seen[:, 2:]))

    def _ground(self) -> None:
        """Draws a disc as wide as the reach, with circles at round distances and the axes X and Y."""
        turn = np.linspace(0.0, 2 * np.pi, 97)
        circle = np.stack([np.cos(turn), np.sin(turn), np.zeros_like(turn)], axis=1)
        spacing = _round_number(self.reach / 5)
        rim = self._project(self.reach * circle)
        self._axes.fill(*rim.T, facecolor="#f4f5f7", edgecolor=LIGHT, linewidth=1.0, zorder=0)
        for radius in np.arange(spacing, self.reach, spacing):
            self._axes.plot(*self._project(radius * circle).T, color=LIGHT, linewidth=0.7, zorder=1)
        for end, name in ((np.array([1.0, 0.0, 0.0]), "x"), (np.array([0.0, 1.0, 0.0]), "y")):
            self._axes.plot(*self._project(self.reach * end * [[-1.0], [1.0]]).T, color=LIGHT, linewidth=0.7, zorder=1)
            self._axes.text(*self._project(0.95 * self.reach * end[None])[0], name, color=MIDDLE, fontsize=8, zorder=2)
        note = f"circles every {spacing:g} m; thin line: rigid arm at the motor angles"
        self._axes.text(0.02, 0.02, note, color=MIDDLE, fontsize=7, transform=self._axes.transAxes)

    def _artists(self) -> None:
        """Makes everything that moves, without places yet."""

        def line(**style: Any) -> Any:
            return self._axes.plot([], [], **{"solid_capstyle": "round", "solid_joinstyle": "round"} | style)[0]

        self._shadow = line(color="#c9ccd2", linewidth=2.6, zorder=3)
        self._plumb = line(color=RED, linewidth=0.8, linestyle=":", zorder=4)
        self._ghost = line(color="#6b7280", linewidth=1.2, zorder=5)
        colours = [LINK_COLOURS[i % len(LINK_COLOURS)] for i in range(self.model.n_joints)]
        self._links = [(line(color=DARK, linewidth=5.0), line(color=colour, linewidth=3.6)) for colour in colours]
        dots = {"linestyle": "", "markeredgecolor": "white", "markeredgewidth": 1.0, "color": DARK, "zorder": 1000}
        self._axes.plot(*self._project(np.zeros((1, 3))).T, marker="s", **dots | {"markersize": 10.0, "zorder": 9})
        self._joints = line(marker="o", markersize=6.5, **dots)
        self._tip = line(marker="D", markersize=5.5, **dots)
        self._target = line(marker="X", markersize=9.0, **dots | {"color": RED})


def arm_frame(
    model: Model,
    state: Sequence[float] | Array,
    target: Sequence[float] | Array | None = None,
    size: tuple[int, int] = (480, 360),
) -> NDArray[np.uint8]:
    """Paints one picture (height, width, 3) of an arm; for many pictures keep a FramePainter.

    Args:
        model, size: as of a FramePainter.
        state, target: as of `FramePainter.paint`.

    Raises:
        ImportError: without Matplotlib.
        ValueError: as of FramePainter and its `paint`.
    """
    return FramePainter(model, size).paint(state, target)


def _camera() -> Array:
    """Gives the directions right, up and towards the camera in the base frame, the rows of (3, 3)."""
    across, along = np.cos(ELEVATION), np.sin(ELEVATION)
    towards = np.array([across * np.cos(AZIMUTH), across * np.sin(AZIMUTH), along])
    right = np.array([-np.sin(AZIMUTH), np.cos(AZIMUTH), 0.0])
    return np.array([right, np.cross(towards, right), towards])


def _round_number(value: float) -> float:
    """Gives the least of 1, 2, 5, 10, ... times a power of ten that is not below a value > 0."""
    power = 10.0 ** np.floor(np.log10(value))
    return float(next(power * step for step in (1, 2, 5, 10) if power * step >= value))

"""Frames of an arm, rendered by kernels: camera, painter, grid of frames."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from flexman_gym.common.arrays import Array, Vector
from flexman_gym.common.checks import flag, non_negative, number_array, positive, value_error, vector, whole_number
from flexman_gym.draw.mesh import Mesh, cylinder, ring, section_outlines, sphere, tube_faces, tube_surfaces
from flexman_gym.draw.overlay import Caption, draw_caption, strain_colours
from flexman_gym.draw.style import rgb, round_up
from flexman_gym.kernels import raster
from flexman_gym.model.deformation import curves
from flexman_gym.model.model import Model, check_model

AZIMUTH, ELEVATION = -58.0, 24.0  # degrees, as seen from the base; +X points to the right and +Y away
SIDE_ANGLE, LOW_ELEVATION, HIGH_ELEVATION = (
    28.0,
    14.0,
    48.0,
)  # degrees: beside the axes of a plane arm that stands, and above one that lies
PARALLEL_TOLERANCE = 1e-6  # how far unit vectors of one direction may be apart
HALF_FIELD_OF_VIEW = 15.0  # degrees from the middle to the upper edge
DISTANCE_SLACK, MIN_CLEARANCE = (
    1e-3,
    0.05,
)  # part of the distance beyond what is needed; of the depth of the points in front of them


class _Camera(NamedTuple):
    """A pinhole camera.

    Attributes:
        eye: (3,) m, base frame.
        axes: (3, 3) directions right, up and forward as rows.
        lens: (3,) focal length and centre, in pixels: columns grow to the right, rows downwards.
    """

    eye: Array
    axes: Array
    lens: Array

    def project(self, points: Array) -> Array:
        """Gives columns and rows (..., 2) of the picture where points (..., 3) are seen, in pixels."""
        seen = (points - self.eye) @ self.axes.T
        return self.lens[1:] + self.lens[0] * seen[..., :2] * (1.0, -1.0) / seen[..., 2:]


def camera_direction(model: Model, angles: object = None) -> tuple[float, float, float]:
    """Gives azimuth and elevation in degrees, and how much nearer than needed the camera stands.

    Args:
        model: the arm. One whose joints all turn about one direction is seen from along that, somewhat aside.
        angles: what a person asks for, two or three numbers; None for none.

    Raises:
        ValueError: for anything else.
    """
    if angles is not None:
        given = vector("camera", angles)
        if len(given) not in (2, 3):
            raise value_error("camera", angles, "azimuth and elevation (degrees), and a zoom, 1 by default")
        if not -89.0 <= given[1] <= 89.0:
            raise value_error("camera[1]", given[1], "an elevation from -89 to 89 (degrees)")
        return given[0], given[1], positive("camera[2]", given[2]) if len(given) == 3 else 1.0
    axis = _common_axis(model)
    if axis is None:
        return AZIMUTH, ELEVATION, 1.0
    if abs(axis[2]) > 0.5:
        return AZIMUTH, HIGH_ELEVATION, 1.0
    along = np.degrees(np.arctan2(-abs(axis[1]), -abs(axis[0])))  # the side that has +X to its right
    return along + SIDE_ANGLE, LOW_ELEVATION, 1.0


def _fit_camera(points: Array, towards: tuple[float, float, float], size: tuple[int, int], clear: Array) -> _Camera:
    """Gives the nearest camera of a direction that has all points between the edges.

    Args:
        points: (p, 3) m, base frame.
        towards: azimuth and elevation, degrees, and a zoom.
        size: width and height of the picture, pixels.
        clear: (4,) parts of the picture that stay free at the left, the right, the top and the bottom.
    """
    azimuth, elevation = np.radians(towards[:2])
    back = np.array([np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation)])
    right = np.array([-np.sin(azimuth), np.cos(azimuth), 0.0])
    axes = np.array([right, np.cross(back, right), -back])
    half = np.tan(np.radians(HALF_FIELD_OF_VIEW)) * np.array([size[0] / size[1], 1.0])
    low, high = (
        half * (2.0 * clear[[0, 3]] - 1.0),
        half * (1.0 - 2.0 * clear[[1, 2]]),
    )  # slopes of the rays at the edges
    seen = points @ axes.T
    across, depth = seen[:, :2], seen[:, 2:]
    # low (depth - eye) <= across - eye <= high (depth - eye) for all points: the eye lies between two lines
    least, most = (across - high * depth).max(axis=0), (across - low * depth).min(axis=0)
    nearest = min(((most - least) / (high - low)).min(), depth.min() - MIN_CLEARANCE * np.ptp(depth) - 1e-9)
    place = nearest - DISTANCE_SLACK * (depth.mean() - nearest)
    eye = np.append((least + high * place + most + low * place) / 2, place)
    eye[2] += (depth.mean() - place) * (1.0 - 1.0 / towards[2])
    focal = size[1] / 2 / np.tan(np.radians(HALF_FIELD_OF_VIEW))
    return _Camera(eye @ axes, axes, np.array([focal, size[0] / 2, size[1] / 2]))


def _common_axis(model: Model) -> Array | None:
    """Gives the direction (3,) about which all joints turn, in the base frame; None where there is no such one."""
    frame, axes = np.eye(3), []
    for mount, axis in zip(model.constants.mount.reshape(-1, 3, 3), model.constants.axis, strict=True):
        frame = frame @ mount
        axes.append(frame @ axis)
    return axes[0] if all(abs(abs(axes[0] @ axis) - 1.0) < PARALLEL_TOLERANCE for axis in axes) else None


def _reachable_points(model: Model) -> Array:
    """Gives points (p, 3) m around all that an arm can reach: of a ball, or of a disc if it moves in one plane."""
    reach, axis = float(model.constants.length.sum()), _common_axis(model)
    turn = np.linspace(0.0, 2 * np.pi, 16, endpoint=False)
    around = np.array([[np.cos(a) * np.cos(b), np.sin(a) * np.cos(b), np.sin(b)] for a in turn for b in turn])
    if axis is not None:
        around = around - (around @ axis)[:, None] * axis
        around /= np.maximum(np.linalg.norm(around, axis=1), PARALLEL_TOLERANCE)[:, None]
    return reach * around


POINTS = 24  # of the curve of a link
SUPERSAMPLING = 2  # of a pixel, each way
MAX_SIDE = 4096  # pixels a side
MARGINS, OVERLAY_MARGINS = np.full(4, 0.06), np.array([0.06, 0.06, 0.15, 0.15])  # parts at left, right, top, bottom
FLOOR_GAP = 0.05  # of the reach, from the lowest thing to the floor
REFERENCE_DEFLECTION = (
    0.01  # deflection of a link as a part of its length, whose strain ends the scale of colours without limits
)
GHOST, MOTOR, TIP, TARGET, POST = "#5b6b82", "#334155", "#1e293b", "#e11d48", "#64748b"
PAYLOAD, TRAIL, PLUMB_LINE = "#8a6d3b", "#6d28d9", "#e58ba0"
GHOST_SHARE, SHADOW_SHARE, TRAIL_START = 0.42, 0.34, 0.05
PAYLOAD_DENSITY = 7800.0  # kg/m^3, of the ball that a payload is drawn as


class Shot(NamedTuple):
    """A camera and the empty scene that it sees.

    Attributes:
        camera: in pixels.
        floor: height, m.
        back: (s H, s W, 3) samples.
        plain: (H, W, 3) pixels.
    """

    camera: _Camera
    floor: float
    back: NDArray[np.uint8]
    plain: NDArray[np.uint8]


class FramePainter:
    """Paints an arm at one state after another.

    A frame shows the links, which bend and twist, in colours of the strain at their surface: red is stretched, blue
    compressed. It shows motors, payload, target, the rigid arm at the motor angles as a grey ghost, the way of the tip,
    and the shadow on a floor with a grid. The same arguments give the same picture, bit for bit.

    Args:
        model: the arm.
        size: width and height in pixels.
        camera: azimuth and elevation in degrees, and a zoom if wanted; None chooses them by the joints.
        gain: by which the deflection is multiplied in the picture, which says so.
        overlays: whether numbers are written over the picture.
        shadow: whether there is one; a moving picture without it is a third smaller.

    Raises:
        ValueError: one line with field, value and what is allowed.

    Attributes:
        model: the Model.
        size: pixels, width and height.
        reach: the sum of the lengths of the links, m.
        radii: (n,) m, of the motors as they are drawn.
        scale: strain at the ends of the colours; 0 for an arm that does not bend.
    """

    def __init__(
        self,
        model: Model,
        size: tuple[int, int] = (480, 360),
        camera: Vector | None = None,
        gain: float = 1.0,
        overlays: bool = True,
        shadow: bool = True,
    ) -> None:
        if not isinstance(size, tuple | list) or len(size) != 2:
            raise value_error("size", size, "two numbers of pixels, width and height")
        width, height = (whole_number(f"size[{i}]", side, 16, MAX_SIDE) for i, side in enumerate(size))
        self.model, self.size = check_model(model), (width, height)
        self.gain, self.overlays = non_negative("gain", gain), flag("overlays", overlays)
        self._shadow = flag("shadow", shadow)
        self._direction = camera_direction(model, camera)
        self.reach = float(model.constants.length.sum())
        self._sections = section_outlines(model, POINTS)
        self.radii = np.clip([1.3 * each.radius for each in self._sections], 0.012 * self.reach, 0.05 * self.reach)
        self._tubes = tube_faces(model.n_joints, POINTS)
        self._grid = round_up(self.reach / 10)
        self.scale = _strain_scale(model) if model.n_elastic else 0.0
        samples, memory = (height * SUPERSAMPLING, width * SUPERSAMPLING), (height, width)
        self._canvas = raster.Canvas(
            *(np.zeros(each, dtype=kind) for each, kind in (
                ((*samples, 3), "u1"), (samples, "f4"), (samples, "u1"), ((*samples, 3), "u1"), (memory, "f4"),
                (memory, "f4"), ((*memory, 3), "u1"), ((*memory, 3), "u1"), (4, "i8"))))  # fmt: skip
        self._shown: Shot | None = None

    def shot(self, points: Array | None = None) -> Shot:
        """Gives a camera that has points and the base in the picture, and the empty scene that it sees.

        Args:
            points: (p, 3) m, base frame; None takes all that the arm can reach.
        """
        camera, floor = self.camera(_reachable_points(self.model) if points is None else points)
        canvas, (width, height) = self._canvas, self.size
        back, plain = np.zeros_like(canvas.back), np.zeros_like(canvas.plain)
        raster.draw_floor(back, camera.eye, camera.axes, camera.lens * SUPERSAMPLING, floor, self.reach, self._grid)
        whole = canvas._replace(
            colour=back,
            back=back,
            picture=plain,
            box=np.array([0, SUPERSAMPLING * width - 1, 0, SUPERSAMPLING * height - 1]),
        )
        raster.resolve(whole._replace(mask=np.zeros_like(canvas.mask)), np.zeros(3), 0.0)
        return Shot(camera, floor, back, plain)

    def camera(self, points: Array) -> tuple[_Camera, float]:
        """Gives the camera of a `shot`, and the height of the floor, m; points as there."""
        places = np.concatenate([np.asarray(points, dtype=float).reshape(-1, 3), np.zeros((1, 3))])
        floor = float(places[:, 2].min()) - FLOOR_GAP * self.reach
        places = np.concatenate([places, [[0.0, 0.0, floor]]])
        return _fit_camera(places, self._direction, self.size, OVERLAY_MARGINS if self.overlays else MARGINS), floor

    def paint(
        self,
        state: Vector,
        target: Vector | None = None,
        caption: Caption | None = None,
        trail: Array | None = None,
        shot: Shot | None = None,
    ) -> NDArray[np.uint8]:
        """Paints the arm at a state.

        Args:
            state: (2 d,).
            target: (3,) in the base frame, m; None without one.
            caption: what is written over it.
            trail: (t, 3) m where the tip was, the oldest first.
            shot: from where it is seen; None takes that of the last frame, and all that the arm can reach at first.

        Returns:
            The picture (height, width, 3).

        Raises:
            ValueError: for a wrong shape or values that are not finite.
        """
        x = np.array(vector("state", state, 2 * self.model.n_dof))
        place = None if target is None else np.array(vector("target", target, 3, "m"))
        self._show(shot or self._shown or self.shot())
        assert self._shown is not None
        bent, rigid = (curves(self.model, x, POINTS, gain) for gain in (self.gain, 0.0))
        points, normals, strain = tube_surfaces(bent, self._sections)
        links = strain_colours(strain / self.scale) if self.scale else np.tile(rgb("#b8bec8"), (len(points), 1))
        parts = self._parts(bent.positions, bent.frames, place)
        mesh = _join_meshes([Mesh(points, normals, self._tubes), *(part for part, _ in parts)])
        colours = np.concatenate([links, *(np.tile(rgb(colour), (len(part.points), 1)) for part, colour in parts)])
        self._draw(mesh, colours)
        if trail is not None and len(trail) > 1:
            way = number_array("trail", trail, (len(trail), 3), "places (t, 3), m")
            self._line(way, 1.2, TRAIL_START, TRAIL)
        if place is not None:
            self._line(np.array([[*place[:2], self._shown.floor], place]), 0.5, 1.0, PLUMB_LINE)
        if self.gain != 1.0:
            true = curves(self.model, x, 2).positions[-1, -1]
            self._line(np.array([true, true + 1e-6]), 3.0, 1.0, TRAIL)
        canvas, ghost = self._canvas, self._seen(tube_surfaces(rigid, self._sections)[0], SUPERSAMPLING)
        raster.mark_coverage(ghost, self._tubes, canvas.mask, canvas.depth, canvas.box)
        raster.resolve(canvas, rgb(GHOST), GHOST_SHARE)
        picture = canvas.picture.copy()
        if self.overlays:
            draw_caption(picture, caption or Caption(), self.gain, self.scale, self._grid)
        return picture

    def _show(self, shot: Shot) -> None:
        """Brings back the empty scene of this shot where something was drawn, or everywhere for another shot."""
        canvas = self._canvas
        if shot is not self._shown:
            height, width = canvas.mask.shape
            canvas.box[:] = 0, width - 1, 0, height - 1
            self._shown, self._canvas = shot, canvas._replace(back=shot.back, plain=shot.plain)
        left, right, top, bottom = canvas.box
        if right >= left:
            drawn = slice(top, bottom + 1), slice(left, right + 1)
            canvas.colour[drawn], canvas.depth[drawn], canvas.mask[drawn] = shot.back[drawn], 0.0, 0
            pixels = (
                slice(top // SUPERSAMPLING, bottom // SUPERSAMPLING + 1),
                slice(left // SUPERSAMPLING, right // SUPERSAMPLING + 1),
            )
            canvas.picture[pixels] = shot.plain[pixels]
        canvas.box[:] = 1 << 30, -1, 1 << 30, -1

    def _seen(self, points: Array, samples: int) -> Array:
        """Gives columns, rows and nearness (p, 3) of points, for so many samples of a pixel."""
        assert self._shown is not None
        camera, result = self._shown.camera, np.empty_like(points)
        raster.project(np.ascontiguousarray(points), camera.eye, camera.axes, camera.lens * samples, result)
        return result

    def _draw(self, mesh: Mesh, colours: Array) -> None:
        """Draws a mesh and its shadow on the floor; colours (p, 3)."""
        assert self._shown is not None
        canvas, sun, box = self._canvas, np.array(raster.KEY_DIRECTION), np.array([1 << 30, -1, 1 << 30, -1])
        if self._shadow:
            fallen = mesh.points - (mesh.points[:, 2:] - self._shown.floor) / sun[2] * sun
            raster.mark_coverage(
                self._seen(fallen, 1), mesh.faces, canvas.shadow, np.zeros((1, 1), dtype=np.float32), box
            )
        if box[1] >= 0:
            raster.draw_shadow(canvas, box, max(2, self.size[1] // 180), SHADOW_SHARE)
        screen = self._seen(mesh.points, SUPERSAMPLING)
        raster.draw_triangles(canvas, screen, mesh.points, mesh.normals, colours, mesh.faces, self._shown.camera.eye)

    def _line(self, points: Array, radius: float, faintest: float, colour: str) -> None:
        """Draws a line with a radius in pixels of a picture of 480 rows."""
        thick = radius * SUPERSAMPLING * max(self.size[1] / 480, 0.5)
        raster.draw_line(self._canvas, self._seen(points, SUPERSAMPLING), thick, faintest, rgb(colour))

    def _parts(self, positions: Array, frames: Array, target: Array | None) -> list[tuple[Mesh, str]]:
        """Gives motors, post, tip with payload and target, each with its colour."""
        assert self._shown is not None
        model, radii, up, floor = self.model, self.radii, np.array([0.0, 0.0, 1.0]), self._shown.floor
        result = [
            (
                cylinder().placed(positions[i, 0], frames[i, 0] @ model.constants.axis[i], radii[i], 1.15 * radii[i]),
                MOTOR,
            )
            for i in range(model.n_joints)
        ]
        foot, half = np.array([0.0, 0.0, floor / 2]), -floor / 2
        result.append((cylinder(0.01).placed(foot, up, 0.8 * radii[0], half), POST))
        result.append((cylinder().placed(np.array([0.0, 0.0, floor]), up, 2.0 * radii[0], 0.25 * radii[0]), POST))
        load, end = model.arm.payload, positions[-1, -1]
        result.append((sphere().placed(end, up, radii[-1], radii[-1]), TIP))
        if load is not None:
            ball = max((load.mass / PAYLOAD_DENSITY * 0.75 / np.pi) ** (1 / 3), radii[-1])
            held = frames[-1, -1] @ (np.array(model.arm.links[-1].orientation).T @ (load.offset or np.zeros(3)))
            result.append((sphere().placed(end + held, up, ball, ball), PAYLOAD))
        if target is not None:
            result.append((sphere().placed(target, up, 0.55 * radii[-1], 0.55 * radii[-1]), TARGET))
            facing = -self._shown.camera.axes[2]
            result.append((ring().placed(target, facing, 2.0 * radii[-1], 2.0 * radii[-1]), TARGET))
        return result


def arm_frame(
    model: Model, state: Vector, target: Vector | None = None, size: tuple[int, int] = (480, 360)
) -> NDArray[np.uint8]:
    """Paints one picture (height, width, 3) of an arm, as near as it fits; for many pictures keep a FramePainter.

    Args:
        model: as of a FramePainter.
        size: as of a FramePainter.
        state: as of `FramePainter.paint`.
        target: as of `FramePainter.paint`.

    Raises:
        ValueError: as of FramePainter and its `paint`.
    """
    painter = FramePainter(model, size)
    points = curves(model, state, POINTS).positions.reshape(-1, 3)
    if target is not None:
        points = np.vstack([points, vector("target", target, 3, "m")])
    return painter.paint(state, target, shot=painter.shot(points))


def grid(frames: Sequence[NDArray[np.uint8]], across: int | None = None) -> NDArray[np.uint8]:
    """Gives frames of one size side by side, in rows, as one picture.

    Args:
        frames: (height, width, 3) each, such as a vector environment renders.
        across: frames in a row; None takes about as many as there are rows.

    Raises:
        ValueError: for no frames, and for frames of different sizes.
    """
    if not len(frames) or len({each.shape for each in frames}) > 1:
        raise value_error("frames", [each.shape for each in frames], "at least one, all of one size")
    across = across or int(np.ceil(np.sqrt(len(frames))))
    down = -(-len(frames) // across)
    height, width, _ = frames[0].shape
    result = np.full((down * height, across * width, 3), 255, dtype=np.uint8)
    for i, frame in enumerate(frames):
        row, column = divmod(i, across)
        result[row * height : (row + 1) * height, column * width : (column + 1) * width] = frame
    return result


def _strain_scale(model: Model) -> float:
    """Gives a round strain about as large as motors cause: that of half a torque limit in the link it turns.

    Where no joint says a limit, it is that of a tip force that bends a link by a small part of its length.
    """
    result = []
    for link, joint in zip(model.arm.links, model.arm.joints, strict=True):
        section = link.sections[0]
        moment = min(section.second_moment_y, section.second_moment_z)
        known = section.outline
        radius = np.sqrt(3.0 * moment / section.area) if known is None else min(known.y, known.z) / 2
        bent = 3 * REFERENCE_DEFLECTION / link.length
        if joint.torque_limit:
            bent = 0.5 * joint.torque_limit / (section.youngs_modulus * moment)
        result.append(float(radius * bent))
    return round_up(max(result))


def _join_meshes(meshes: Sequence[Mesh]) -> Mesh:
    """Return several meshes as one."""
    starts = np.cumsum([0, *(len(mesh.points) for mesh in meshes)])
    faces = [mesh.faces + start for mesh, start in zip(meshes, starts, strict=False)]
    points, normals = (np.concatenate([mesh[k] for mesh in meshes]) for k in range(2))
    return Mesh(points, normals, np.concatenate(faces).astype(np.int32))

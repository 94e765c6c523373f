"""Frames of an arm, rendered by compiled kernels: camera, painter, and grid of frames."""

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from flexman_gym.common.arrays import Array, Vector
from flexman_gym.common.checks import flag, non_negative, number_array, positive, vector, whole_number
from flexman_gym.common.errors import value_error
from flexman_gym.common.plot_style import VIOLET, rgb, round_up
from flexman_gym.kernels import raster
from flexman_gym.model.deformation import curves, gauge_radii
from flexman_gym.model.model import Model, check_model
from flexman_gym.toolbox.view.mesh import (
    CYLINDER,
    RING,
    SHARP_CYLINDER,
    SPHERE,
    Mesh,
    boundaries,
    section_outlines,
    tube_surfaces,
)
from flexman_gym.toolbox.view.overlay import Caption, strain_colours

AZIMUTH, ELEVATION = -58.0, 24.0  # degrees; direction from the base to the camera; +X points right, +Y away from it
SIDE_ANGLE, LOW_ELEVATION = 28.0, 14.0  # degrees; azimuth from the joint axes, and elevation; arm in a vertical plane
HIGH_ELEVATION = 48.0  # degrees; elevation for an arm in a horizontal plane
PARALLEL_TOLERANCE = 1e-6  # dimensionless; difference of the cosine from 1 up to which axes count as parallel
HALF_FIELD_OF_VIEW = 15.0  # degrees; from the centre to the upper edge
DISTANCE_SLACK = 1e-3  # dimensionless; extra distance of the camera as a fraction of the mean depth of the points
MIN_CLEARANCE = 0.05  # dimensionless; least distance of the nearest point from the camera / range of depths


class _Camera(NamedTuple):
    """Pinhole camera.

    Attributes:
        eye: position (3,) in the base frame, m.
        axes: directions right, up and forward as rows (3, 3).
        lens: focal length, column and row of the centre (3,), pixels.
    """

    eye: Array
    axes: Array
    lens: Array

    def project(self, points: Array) -> Array:
        """Return columns and rows (..., 2), pixels, of points (..., 3), m; rows count downwards."""
        local = (points - self.eye) @ self.axes.T
        return self.lens[1:] + self.lens[0] * local[..., :2] * (1.0, -1.0) / local[..., 2:]


def _camera_direction(model: Model, angles: object = None) -> tuple[float, float, float]:
    """Return azimuth and elevation of the camera, degrees, and its zoom.

    Args:
        model: model of the arm; the default direction for an arm with parallel joint axes is close to these axes.
        angles: azimuth, elevation and, optionally, zoom chosen by the user; None for the default.
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
    along = np.degrees(np.arctan2(-abs(axis[1]), -abs(axis[0])))  # on the side where +X points to the right
    return along + SIDE_ANGLE, LOW_ELEVATION, 1.0


def _fit_camera(
    points: Array, radii: Array, direction: tuple[float, float, float], size: tuple[int, int], margins: Array
) -> _Camera:
    """Return the nearest camera in a direction whose picture contains discs around all points.

    Args:
        points: points (p, 3) in the base frame, m.
        radii: radii (p,) of discs around the points that face the camera, m.
        direction: azimuth and elevation, degrees, and zoom (dimensionless).
        size: width and height of the picture, pixels.
        margins: margins (4,) at the left, right, top and bottom as fractions of the picture.
    """
    azimuth, elevation = np.radians(direction[:2])
    back = np.array([np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation)])
    right = np.array([-np.sin(azimuth), np.cos(azimuth), 0.0])
    axes = np.array([right, np.cross(back, right), -back])
    half = np.tan(np.radians(HALF_FIELD_OF_VIEW)) * np.array([size[0] / size[1], 1.0])
    # Slopes of the rays at the edges.
    low, high = half * (2.0 * margins[[0, 3]] - 1.0), half * (1.0 - 2.0 * margins[[1, 2]])
    local = points @ axes.T
    across, depth = local[:, :2], local[:, 2:]
    # low (depth - eye) <= across -+ radius - eye <= high (depth - eye) for all points: the eye lies between two lines
    wide = radii[:, None]
    least, most = (across + wide - high * depth).max(axis=0), (across - wide - low * depth).min(axis=0)
    nearest = min(((most - least) / (high - low)).min(), depth.min() - MIN_CLEARANCE * np.ptp(depth) - 1e-9)
    place = nearest - DISTANCE_SLACK * (depth.mean() - nearest)
    eye = np.append((least + high * place + most + low * place) / 2, place)
    eye[2] += (depth.mean() - place) * (1.0 - 1.0 / direction[2])
    focal = size[1] / 2 / np.tan(np.radians(HALF_FIELD_OF_VIEW))
    return _Camera(eye @ axes, axes, np.array([focal, size[0] / 2, size[1] / 2]))


def _common_axis(model: Model) -> Array | None:
    """Return the common direction (3,) of all joint axes in the base frame; None if they are not parallel."""
    frame, axes = np.eye(3), []
    for mount, axis in zip(model.constants.mount.reshape(-1, 3, 3), model.constants.axis, strict=True):
        frame = frame @ mount
        axes.append(frame @ axis)
    return axes[0] if all(abs(abs(axes[0] @ axis) - 1.0) < PARALLEL_TOLERANCE for axis in axes) else None


def _reachable_points(model: Model) -> Array:
    """Return points (p, 3), m, on a sphere that encloses the workspace, or on a circle for parallel joint axes."""
    reach, axis = float(model.constants.length.sum()), _common_axis(model)
    turn = np.linspace(0.0, 2 * np.pi, 16, endpoint=False)
    around = np.array([[np.cos(a) * np.cos(b), np.sin(a) * np.cos(b), np.sin(b)] for a in turn for b in turn])
    if axis is not None:
        around = around - (around @ axis)[:, None] * axis
        around /= np.maximum(np.linalg.norm(around, axis=1), PARALLEL_TOLERANCE)[:, None]
    return reach * around


POINTS = 24  # number of drawn points on the centreline of a link
SUPERSAMPLING = 2  # samples of a pixel in each direction
MAX_SIDE = 4096  # pixels; largest width and height
MARGINS = np.full(4, 0.06)  # fractions of the picture without overlays: left, right, top, bottom
BASE_RADIUS, BASE_HALF_HEIGHT = 2.0, 0.25  # radius and half height of the base plate / radius of the first motor
MOTOR_HALF_LENGTH, RING_RADIUS = 1.15, 2.0  # half length / radius of a motor; radius of the ring / of the last motor
FLOOR_GAP = 0.05  # dimensionless; distance of the floor from the lowest point as a fraction of the reach
REFERENCE_DEFLECTION = 0.01  # deflection / length of a link with the largest strain of the colours, if no torque limit
GHOST, MOTOR, TIP, TARGET, POST = "#5b6b82", "#334155", "#1e293b", "#e11d48", "#64748b"
PAYLOAD, TRAIL, PLUMB_LINE, BOUNDARY = "#8a6d3b", VIOLET, "#e58ba0", "#d97706"
GHOST_SHARE, SHADOW_SHARE, TRAIL_START = 0.42, 0.34, 0.05  # opacities, 0 to 1: rigid arm, shadow, oldest path point
PAYLOAD_DENSITY = 7800.0  # kg/m^3; steel; sets the size of the sphere of a payload


class _Shot(NamedTuple):
    """View of a scene for its frames: a fixed camera, and the background as seen from it.

    Attributes:
        camera: the camera.
        floor: z coordinate of the floor in the base frame, m.
        back: background (s H, s W, 3), with s x s samples per pixel.
        plain: background (H, W, 3), pixels.
    """

    camera: _Camera
    floor: float
    back: NDArray[np.uint8]
    plain: NDArray[np.uint8]


class FramePainter:
    """Painter of frames of an arm at given states.

    A frame shows the deformed links in colours of the strain at their surface, red for tension and blue for
    compression, with motors, payload and target, the rigid arm at the motor angles in transparent grey, the path of the
    tip, and a shadow on a floor with a grid. Equal arguments give equal pictures, to the bit.

    Args:
        model: model of the arm.
        size: width and height, pixels.
        camera: azimuth and elevation, degrees, and optionally a zoom; None for a direction chosen from the joint axes.
        gain: magnification of the deflection of the links, or of the deflection of the links and the twist of the
            joints, shown in the overlay; the twist of the joints has its true scale by default, because it moves all
            outboard links, and a large magnification would throw them out of the frame.
        overlays: True to draw numbers over the picture.
        shadow: True to draw the shadow; a GIF without shadow is a third smaller.

    Attributes:
        model: model of the arm.
        size: width and height, pixels.
        gains: magnifications of the deflection of the links and of the twist of the joints.
        direction: azimuth and elevation of the camera, degrees, and its zoom (dimensionless).
        reach: sum of the lengths of the links, m.
        radii: drawn radii of the motors (n,), m.
        scale: strain at the ends of the colour scale; 0 for a rigid arm. An array (n,) has a strain for each link, such
            as `limiting_strains`.
        grid: spacing of the grid on the floor, m.
        workspace: regions whose boundaries are drawn within the reach, see `Limits.workspace`.
    """

    def __init__(
        self,
        model: Model,
        size: tuple[int, int] = (480, 360),
        camera: Vector | None = None,
        gain: float | Vector = 1.0,
        overlays: bool = True,
        shadow: bool = True,
    ) -> None:
        if not isinstance(size, tuple | list) or len(size) != 2:
            raise value_error("size", size, "two numbers of pixels, width and height")
        width, height = (whole_number(f"size[{i}]", side, 16, MAX_SIDE) for i, side in enumerate(size))
        self.model, self.size = check_model(model), (width, height)
        self.gains, self.overlays = _gains(gain), flag("overlays", overlays)
        self._shadow = flag("shadow", shadow)
        self.direction = _camera_direction(model, camera)
        self.reach = float(model.constants.length.sum())
        self._sections = section_outlines(model, POINTS)
        self.radii = np.clip([1.3 * each.radius for each in self._sections], 0.012 * self.reach, 0.05 * self.reach)
        self.grid = round_up(self.reach / 10)
        self.scale: Any = _strain_scale(model) if model.n_elastic else 0.0
        self.workspace: Sequence[Mapping[str, Any]] = ()
        samples, memory = (height * SUPERSAMPLING, width * SUPERSAMPLING), (height, width)
        self._canvas = raster.Canvas(
            *(np.zeros(each, dtype=kind) for each, kind in (
                ((*samples, 3), "u1"), (samples, "f4"), (samples, "u1"), ((*samples, 3), "u1"), (memory, "f4"),
                (memory, "f4"), ((*memory, 3), "u1"), ((*memory, 3), "u1"), (4, "i8"))))  # fmt: skip
        self._shown: _Shot | None = None

    def shot(self, points: Array | None = None, bases: Array | None = None, margins: Array | None = None) -> _Shot:
        """Return a camera whose picture contains points and the base, with the background.

        Args:
            points: points (p, 3) in the frame of the picture, m; None for the whole workspace.
            bases: positions of the base (k, 3) in the frame of the picture, m; None for its origin.
            margins: margins (4,) at the left, right, top and bottom as fractions of the picture; None for those of the
                overlay.
        """
        camera, floor = self.camera(_reachable_points(self.model) if points is None else points, bases, margins)
        canvas, (width, height) = self._canvas, self.size
        back, plain = np.zeros_like(canvas.back), np.zeros_like(canvas.plain)
        raster.draw_floor(back, camera.eye, camera.axes, camera.lens * SUPERSAMPLING, floor, self.reach, self.grid)
        whole = canvas._replace(
            colour=back,
            back=back,
            picture=plain,
            box=np.array([0, SUPERSAMPLING * width - 1, 0, SUPERSAMPLING * height - 1]),
        )
        raster.resolve(whole._replace(mask=np.zeros_like(canvas.mask)), np.zeros(3), 0.0)
        return _Shot(camera, floor, back, plain)

    def camera(self, points: Array, bases: Array | None = None, margins: Array | None = None) -> tuple[_Camera, float]:
        """Return the camera for points (p, 3), m, and the z coordinate of the floor, m; see `shot`."""
        feet = np.zeros((1, 3)) if bases is None else bases
        places = np.concatenate([np.asarray(points, dtype=float).reshape(-1, 3), feet])
        floor = float(places[:, 2].min()) - FLOOR_GAP * self.reach
        turn = np.linspace(0.0, 2 * np.pi, 8, endpoint=False)
        rim = np.column_stack([np.cos(turn), np.sin(turn), np.zeros(8)]) * BASE_RADIUS * self.radii[0]
        plate = rim + np.array([0.0, 0.0, floor - BASE_HALF_HEIGHT * self.radii[0]])
        plate = np.concatenate([plate + foot * (1.0, 1.0, 0.0) for foot in feet])
        radii = np.repeat([self._largest_radius(), 0.0], [len(places), len(plate)])
        if margins is None:
            margins = Caption.margins(self.size[1]) if self.overlays else MARGINS
        return _fit_camera(np.concatenate([places, plate]), radii, self.direction, self.size, margins), floor

    def _largest_radius(self) -> float:
        """Return the largest distance, m, of a drawn point of a motor, the target or the payload from its centre."""
        motor, ring = np.hypot(1.0, MOTOR_HALF_LENGTH) * self.radii.max(), RING_RADIUS * self.radii[-1]
        return float(max(motor, ring, self._payload_radius()))

    def _payload_radius(self) -> float:
        """Return the radius of the sphere of the payload, m; 0 without a payload."""
        load = self.model.arm.payload
        if load is None:
            return 0.0
        return float(max((load.mass / PAYLOAD_DENSITY * 0.75 / np.pi) ** (1 / 3), self.radii[-1]))

    def paint(
        self,
        state: Vector,
        target: Vector | None = None,
        caption: Caption | None = None,
        trail: Array | None = None,
        shot: _Shot | None = None,
        base: Vector | None = None,
    ) -> NDArray[np.uint8]:
        """Return a frame (height, width, 3) uint8 of the arm at a state.

        Args:
            state: state (2 d,).
            target: target of the tip (3,) in the frame of the picture, m; None for no target.
            caption: text and numbers over the picture.
            trail: past positions of the tip (t, 3) in the frame of the picture, m, the oldest first.
            shot: camera and background; None for camera and background of the previous frame, at first for the whole
                workspace.
            base: position of the base (3,) in the frame of the picture, m; None for its origin.
        """
        x = np.array(vector("state", state, 2 * self.model.n_dof))
        place = None if target is None else np.array(vector("target", target, 3, "m"))
        self._show(shot or self._shown or self.shot())
        assert self._shown is not None
        origin = np.zeros(3) if base is None else np.array(vector("base", base, 3, "m"))
        bent, rigid = (curves(self.model, x, POINTS, *gains) for gains in (self.gains, (0.0, 0.0)))
        bent, rigid = (each._replace(positions=each.positions + origin) for each in (bent, rigid))
        tubes, strain = tube_surfaces(bent, self._sections)
        links, scale = np.tile(rgb("#b8bec8"), (len(strain), 1)), np.broadcast_to(self.scale, self.model.n_joints)
        if scale.all():
            links = strain_colours(strain / np.repeat(scale, len(strain) // len(scale)))
        parts = self._parts(bent.positions, bent.frames, place, origin)
        mesh = _join_meshes([tubes, *(part for part, _ in parts)])
        colours = np.concatenate([links, *(np.tile(rgb(colour), (len(part.points), 1)) for part, colour in parts)])
        self._draw(mesh, colours)
        if trail is not None and len(trail) > 1:
            path = number_array("trail", trail, (len(trail), 3), "positions (t, 3), m")
            self._line(path, 1.2, TRAIL_START, TRAIL)
        for border in boundaries(self.workspace, self.reach):
            self._line(border, 1.0, 1.0, BOUNDARY)
        if place is not None:
            self._line(np.array([[*place[:2], self._shown.floor], place]), 0.5, 1.0, PLUMB_LINE)
        if self.gains != (1.0, 1.0):
            true = curves(self.model, x, 2).positions[-1, -1] + origin
            self._line(np.array([true, true + 1e-6]), 3.0, 1.0, TRAIL)
        canvas, ghost = self._canvas, self._project(tube_surfaces(rigid, self._sections)[0].points, SUPERSAMPLING)
        raster.mark_coverage(ghost, tubes.faces, canvas.mask, canvas.depth, canvas.box)
        raster.resolve(canvas, rgb(GHOST), GHOST_SHARE)
        picture = canvas.picture.copy()
        if self.overlays:
            (caption or Caption()).draw(picture, self.gains, float(np.max(self.scale)), self.grid)
        return picture

    def _show(self, shot: _Shot) -> None:
        """Restore the background where the last frame was drawn, or everywhere if the shot changed."""
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

    def _project(self, points: Array, samples: int) -> Array:
        """Return columns, rows and inverse depths (p, 3) of points (p, 3), m, with `samples` samples per pixel side."""
        assert self._shown is not None
        camera, result = self._shown.camera, np.empty_like(points)
        raster.project(np.ascontiguousarray(points), camera.eye, camera.axes, camera.lens * samples, result)
        return result

    def _draw(self, mesh: Mesh, colours: Array) -> None:
        """Draw a mesh with colours (p, 3) of its vertices, and its shadow on the floor."""
        assert self._shown is not None
        canvas, sun, box = self._canvas, np.array(raster.KEY_DIRECTION), np.array([1 << 30, -1, 1 << 30, -1])
        if self._shadow:
            fallen = mesh.points - (mesh.points[:, 2:] - self._shown.floor) / sun[2] * sun
            raster.mark_coverage(
                self._project(fallen, 1), mesh.faces, canvas.shadow, np.zeros((1, 1), dtype=np.float32), box
            )
        if box[1] >= 0:
            raster.draw_shadow(canvas, box, max(2, self.size[1] // 180), SHADOW_SHARE)
        screen = self._project(mesh.points, SUPERSAMPLING)
        raster.draw_triangles(canvas, screen, mesh.points, mesh.normals, colours, mesh.faces, self._shown.camera.eye)

    def _line(self, points: Array, radius: float, faintest: float, colour: str) -> None:
        """Draw a line; the radius is in pixels of a picture with 480 rows."""
        thick = radius * SUPERSAMPLING * max(self.size[1] / 480, 0.5)
        raster.draw_line(self._canvas, self._project(points, SUPERSAMPLING), thick, faintest, rgb(colour))

    def _parts(self, positions: Array, frames: Array, target: Array | None, origin: Array) -> list[tuple[Mesh, str]]:
        """Return the meshes of motors, post at the base, tip, payload and target, each with its colour."""
        assert self._shown is not None
        model, radii, up, floor = self.model, self.radii, np.array([0.0, 0.0, 1.0]), self._shown.floor
        result = []
        for i in range(model.n_joints):
            axis = frames[i, 0] @ model.constants.axis[i]
            result.append((CYLINDER.transformed(positions[i, 0], axis, radii[i], MOTOR_HALF_LENGTH * radii[i]), MOTOR))
        ground, half = np.array([*origin[:2], floor]), (origin[2] - floor) / 2
        result.append((SHARP_CYLINDER.transformed(ground + half * up, up, 0.8 * radii[0], half), POST))
        plate = BASE_RADIUS * radii[0], BASE_HALF_HEIGHT * radii[0]
        result.append((CYLINDER.transformed(ground, up, *plate), POST))
        load, end = model.arm.payload, positions[-1, -1]
        result.append((SPHERE.transformed(end, up, radii[-1], radii[-1]), TIP))
        if load is not None:
            ball = self._payload_radius()
            held = frames[-1, -1] @ (np.array(model.arm.links[-1].orientation).T @ (load.offset or np.zeros(3)))
            result.append((SPHERE.transformed(end + held, up, ball, ball), PAYLOAD))
        if target is not None:
            result.append((SPHERE.transformed(target, up, 0.55 * radii[-1], 0.55 * radii[-1]), TARGET))
            facing = -self._shown.camera.axes[2]
            ring = RING_RADIUS * radii[-1]
            result.append((RING.transformed(target, facing, ring, ring), TARGET))
        return result


def arm_frame(
    model: Model,
    state: Vector,
    target: Vector | None = None,
    size: tuple[int, int] = (480, 360),
    gain: float | Vector = 1.0,
) -> NDArray[np.uint8]:
    """Return one frame (height, width, 3), uint8, with an arm as large as possible; for many frames use a FramePainter.

    Args:
        model: model of the arm.
        state: state (2 d,).
        target: target of the tip (3,) in the base frame, m; None for no target.
        size: width and height, pixels.
        gain: magnification of the deflection of the links, or of links and joints, see `FramePainter`.
    """
    painter = FramePainter(model, size, gain=gain)
    points = curves(model, state, POINTS, *painter.gains).positions.reshape(-1, 3)
    if target is not None:
        points = np.vstack([points, vector("target", target, 3, "m")])
    return painter.paint(state, target, shot=painter.shot(points))


def grid(frames: Sequence[NDArray[np.uint8]], across: int | None = None) -> NDArray[np.uint8]:
    """Return several frames of one size as one picture (height, width, 3), uint8, in rows.

    Args:
        frames: frames (height, width, 3) uint8, such as the frames rendered by a vector environment.
        across: number of frames in a row; None for about as many columns as rows.
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


def _gains(gain: object) -> tuple[float, float]:
    """Return the magnifications of the deflection of the links and of the twist of the joints, at least 0."""
    if isinstance(gain, tuple | list | np.ndarray):
        links, joints = vector("gain", gain, 2)
        return non_negative("gain[0]", links), non_negative("gain[1]", joints)
    return non_negative("gain", gain), 1.0


def limiting_strains(model: Model, limits: float | Sequence[float]) -> Array:
    """Return the strains (n,) at the surface of the links for limits of the strains at their gauges, one or n.

    Args:
        model: model of the arm.
        limits: limits for the gauges of `deformation.root_strain_matrix`, m/m.
    """
    outlines, radii = [link.sections[0].outline for link in model.arm.links], gauge_radii(model)[:, :2]
    edges = [np.sqrt(3.0) * radius if each is None else np.array([each.y, each.z]) / 2.0
             for each, radius in zip(outlines, radii, strict=True)]  # fmt: skip
    return np.asarray(limits) * (edges / radii).min(axis=1)


def _strain_scale(model: Model) -> float:
    """Return a rounded strain for the ends of the colour scale: the root strain of a link under half the torque limit.

    Without a torque limit it is the strain under a tip force that deflects the link by REFERENCE_DEFLECTION.
    """
    result = []
    for link, joint in zip(model.arm.links, model.arm.joints, strict=True):
        section = link.sections[0]
        moment = min(section.second_moment_y, section.second_moment_z)
        outline = section.outline
        radius = np.sqrt(3.0 * moment / section.area) if outline is None else min(outline.y, outline.z) / 2
        curvature = 3 * REFERENCE_DEFLECTION / link.length  # 1/m
        if joint.torque_limit:
            curvature = 0.5 * joint.torque_limit / (section.youngs_modulus * moment)
        result.append(float(radius * curvature))
    return round_up(max(result))


def _join_meshes(meshes: Sequence[Mesh]) -> Mesh:
    """Return several meshes as one."""
    starts = np.cumsum([0, *(len(mesh.points) for mesh in meshes)])
    faces = [mesh.faces + start for mesh, start in zip(meshes, starts, strict=False)]
    points, normals = (np.concatenate([mesh[k] for mesh in meshes]) for k in range(2))
    return Mesh(points, normals, np.concatenate(faces).astype(np.int32))

"""Camera: from where an arm is seen, so that all that matters is in the picture."""

from typing import NamedTuple

import numpy as np

from flexman_gym.arrays import Array
from flexman_gym.checks import positive, refusal, vector
from flexman_gym.model.model import Model

AZIMUTH, ELEVATION = -58.0, 24.0  # degrees, as seen from the base; +X points to the right and +Y away
ASIDE, LOW, HIGH = 28.0, 14.0, 48.0  # degrees: beside the axes of a plane arm that stands, and above one that lies
ALIKE = 1e-6  # how far unit vectors of one direction may be apart
LENS = 15.0  # degrees from the middle to the upper edge
SLACK, NEAREST = 1e-3, 0.05  # part of the distance beyond what is needed; of the depth of the points in front of them


class Camera(NamedTuple):
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


def direction(model: Model, angles: object = None) -> tuple[float, float, float]:
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
            raise refusal("camera", angles, "azimuth and elevation (degrees), and a zoom, 1 by default")
        if not -89.0 <= given[1] <= 89.0:
            raise refusal("camera[1]", given[1], "an elevation from -89 to 89 (degrees)")
        return given[0], given[1], positive("camera[2]", given[2]) if len(given) == 3 else 1.0
    axis = common_axis(model)
    if axis is None:
        return AZIMUTH, ELEVATION, 1.0
    if abs(axis[2]) > 0.5:
        return AZIMUTH, HIGH, 1.0
    along = np.degrees(np.arctan2(-abs(axis[1]), -abs(axis[0])))  # the side that has +X to its right
    return along + ASIDE, LOW, 1.0


def fitted(points: Array, towards: tuple[float, float, float], size: tuple[int, int], clear: Array) -> Camera:
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
    half = np.tan(np.radians(LENS)) * np.array([size[0] / size[1], 1.0])
    low, high = (
        half * (2.0 * clear[[0, 3]] - 1.0),
        half * (1.0 - 2.0 * clear[[1, 2]]),
    )  # slopes of the rays at the edges
    seen = points @ axes.T
    across, depth = seen[:, :2], seen[:, 2:]
    # low (depth - eye) <= across - eye <= high (depth - eye) for all points: the eye lies between two lines
    least, most = (across - high * depth).max(axis=0), (across - low * depth).min(axis=0)
    nearest = min(((most - least) / (high - low)).min(), depth.min() - NEAREST * np.ptp(depth) - 1e-9)
    place = nearest - SLACK * (depth.mean() - nearest)
    eye = np.append((least + high * place + most + low * place) / 2, place)
    eye[2] += (depth.mean() - place) * (1.0 - 1.0 / towards[2])
    focal = size[1] / 2 / np.tan(np.radians(LENS))
    return Camera(eye @ axes, axes, np.array([focal, size[0] / 2, size[1] / 2]))


def common_axis(model: Model) -> Array | None:
    """Gives the direction (3,) about which all joints turn, in the base frame; None where there is no such one."""
    frame, axes = np.eye(3), []
    for mount, axis in zip(model.constants.mount.reshape(-1, 3, 3), model.constants.axis, strict=True):
        frame = frame @ mount
        axes.append(frame @ axis)
    return axes[0] if all(abs(abs(axes[0] @ axis) - 1.0) < ALIKE for axis in axes) else None


def reached(model: Model) -> Array:
    """Gives points (p, 3) m around all that an arm can reach: of a ball, or of a disc if it moves in one plane."""
    reach, axis = float(model.constants.length.sum()), common_axis(model)
    turn = np.linspace(0.0, 2 * np.pi, 16, endpoint=False)
    around = np.array([[np.cos(a) * np.cos(b), np.sin(a) * np.cos(b), np.sin(b)] for a in turn for b in turn])
    if axis is not None:
        around = around - (around @ axis)[:, None] * axis
        around /= np.maximum(np.linalg.norm(around, axis=1), ALIKE)[:, None]
    return reach * around

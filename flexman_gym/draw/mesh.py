"""Mesh: surfaces of links as their curves bend and twist them, and of the round parts beside them."""

from collections.abc import Sequence
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np

from flexman_gym.common.arrays import Array, IntArray
from flexman_gym.model.deformation import Curves
from flexman_gym.model.element import find_element
from flexman_gym.model.model import Model

SIDES = 16  # points around a section
MIN_RADIUS, MIN_HALF_SIDE = 0.008, 0.0025  # of the reach: radius of a round link and half a side of a strip, at least
ROUND_TOLERANCE = 0.02  # how far the radii of gyration of a section that is drawn round may be apart


class Mesh(NamedTuple):
    """Triangles.

    Attributes:
        points: (p, 3).
        normals: (p, 3) outward; not of unit length.
        faces: (f, 3) int32 points of triangles, counter-clockwise as seen from outside.
    """

    points: Array
    normals: Array
    faces: IntArray

    def placed(self, origin: Array, axis: Array, radius: float, half: float) -> "Mesh":
        """Gives it with its z axis along a unit `axis`, so much as large across and along."""
        x, y, z = axis
        side = np.array([0.0, z, -y] if abs(x) < 0.6 else [-z, 0.0, x]) / np.hypot(z, y if abs(x) < 0.6 else x)
        turned = np.array([side, axis[[1, 2, 0]] * side[[2, 0, 1]] - axis[[2, 0, 1]] * side[[1, 2, 0]], axis])
        return Mesh(self.points * (radius, radius, half) @ turned + origin, self.normals @ turned, self.faces)


class _SectionOutlines(NamedTuple):
    """Sections of a link as they are drawn, at P places.

    Attributes:
        points: (P, 16, 2) y and z, m.
        normals: (P, 16, 2).
        gauges: (P, 16, 2) y and z of the points whose strain is shown there: where the true section ends.
    """

    points: Array
    normals: Array
    gauges: Array

    @property
    def radius(self) -> float:
        """Half the largest width that is drawn, m."""
        return float(np.abs(self.points).max())


def section_outlines(model: Model, places: int) -> tuple[_SectionOutlines, ...]:
    """Gives the sections of all links at equally spaced places.

    A section has the outline that its link says. Without one it is a solid disc where its radii of gyration agree,
    else a solid rectangle, of the same radii of gyration. What would be thinner than a stroke is drawn thicker.

    Args:
        model: the model.
        places: on each link.
    """
    reach, result = float(model.constants.length.sum()), []
    for i, link in enumerate(model.arm.links):
        elements = model.elements(i)
        parts = [
            _section(find_element(elements, place)[0].section, reach) for place in np.linspace(0.0, link.length, places)
        ]
        result.append(_SectionOutlines(*(np.array(each) for each in zip(*parts, strict=True))))
    return tuple(result)


def _section(section: Any, reach: float) -> tuple[Array, Array, Array]:
    """Points, normals and gauges (16, 2) of a section."""
    gyration = np.sqrt(np.array([section.second_moment_z, section.second_moment_y]) / section.area)
    known, alike = section.outline, abs(gyration[0] / gyration[1] - 1.0) < ROUND_TOLERANCE
    half = np.sqrt(3.0) * gyration if known is None else np.array([known.y, known.z]) / 2
    if alike if known is None else known.shape != "strip":
        turn = (np.arange(SIDES) + 0.5) * 2 * np.pi / SIDES
        circle = np.column_stack([np.cos(turn), np.sin(turn)])
        radius = 2.0 * float(gyration.mean()) if known is None else half[0]
        return max(radius, MIN_RADIUS * reach) * circle, circle, radius * circle
    along = np.linspace(-1.0, 1.0, SIDES // 4)
    one = np.ones_like(along)
    sides = [np.column_stack(each) for each in ((one, along), (-along, one), (-one, -along), (along, -one))]
    flat = [np.column_stack(each) for each in ((one, 0 * one), (0 * one, one), (-one, 0 * one), (0 * one, -one))]
    square = np.concatenate(sides)
    return square * np.maximum(half, MIN_HALF_SIDE * reach), np.concatenate(flat), square * half


def tube_faces(links: int, places: int) -> IntArray:
    """Gives the triangles (f, 3) of links whose points are counted by link, place and side; their ends are closed."""
    point = np.arange(links * places * SIDES, dtype=np.int32).reshape(links, places, SIDES)
    after = np.roll(point, -1, axis=2)
    a, b, c, d = (each.ravel() for each in (point[:, :-1], after[:, :-1], after[:, 1:], point[:, 1:]))
    fan = np.array([(0, side, side + 1) for side in range(1, SIDES - 1)])
    root, tip = point[:, 0][:, fan[:, [0, 2, 1]]], point[:, -1][:, fan]
    sides = np.concatenate([np.column_stack([a, b, c]), np.column_stack([a, c, d])])
    return np.concatenate([sides, root.reshape(-1, 3), tip.reshape(-1, 3)])


def tube_surfaces(curves: Curves, sections: Sequence[_SectionOutlines]) -> tuple[Array, Array, Array]:
    """Gives points and normals (..., v, 3) of all links and the axial strain (..., v) that their points show.

    Args:
        curves: of the links, (..., n, P).
        sections: of each link.
    """
    points, normals, gauges = (np.array([section[k] for section in sections]) for k in range(3))
    across = curves.frames[..., 1:]
    surface = curves.positions[..., None, :] + np.einsum("...ipab,ipsb->...ipsa", across, points)
    outward = np.einsum("...ipab,ipsb->...ipsa", across, normals)
    stretch, curvature = curves.strains[..., 0, None], curves.curvatures[..., None, :]
    strain = stretch - gauges[..., 0] * curvature[..., 2] + gauges[..., 1] * curvature[..., 1]
    front = surface.shape[:-4]
    return surface.reshape(*front, -1, 3), outward.reshape(*front, -1, 3), strain.reshape(*front, -1)


@lru_cache(maxsize=8)
def _surface_of_revolution(profile: tuple[tuple[float, float, float, float], ...], sides: int = 24) -> Mesh:
    """Gives the surface that a profile of radius, height and their normal sweeps about the z axis.

    Args:
        profile: from below to above, the outside of a round part.
        sides: around the axis.
    """
    turn = np.linspace(0.0, 2 * np.pi, sides + 1)
    radius, height, out, up = np.array(profile).T[..., None]
    ring = np.array([np.cos(turn), np.sin(turn)])
    points, normals = (
        np.stack([across * ring[0], across * ring[1], along + 0 * turn], axis=-1).reshape(-1, 3)
        for across, along in ((radius, height), (out, up))
    )
    a = (np.arange(len(profile) - 1)[:, None] * (sides + 1) + np.arange(sides)).ravel()
    b, c, d = a + 1, a + sides + 2, a + sides + 1
    return Mesh(points, normals, np.concatenate([np.column_stack([a, b, c]), np.column_stack([a, c, d])]).astype("i4"))


def cylinder(bevel: float = 0.1) -> Mesh:
    """Gives a cylinder of radius 1 from -1 to 1, its edges broken."""
    inner, half = 1.0 - bevel, ((0.0, -1.0), (1.0 - bevel, -1.0))
    low = [(radius, height, 0.0, -1.0) for radius, height in half]
    edge = [(inner, -1.0, 0.4, -0.9), (1.0, -inner, 0.95, -0.3), (1.0, inner, 0.95, 0.3), (inner, 1.0, 0.4, 0.9)]
    return _surface_of_revolution((*low, *edge, (inner, 1.0, 0.0, 1.0), (0.0, 1.0, 0.0, 1.0)))


def sphere(rings: int = 12) -> Mesh:
    """Gives a sphere of radius 1."""
    turn = np.linspace(-np.pi / 2, np.pi / 2, rings + 1)
    return _surface_of_revolution(tuple((np.cos(t), np.sin(t), np.cos(t), np.sin(t)) for t in turn.tolist()))


def ring(thick: float = 0.11, rings: int = 10) -> Mesh:
    """Gives a ring of radius 1 in the x-y plane."""
    turn = np.linspace(-np.pi, np.pi, rings + 1)
    profile = ((1.0 + thick * np.cos(t), thick * np.sin(t), np.cos(t), np.sin(t)) for t in turn.tolist())
    return _surface_of_revolution(tuple(profile), 40)

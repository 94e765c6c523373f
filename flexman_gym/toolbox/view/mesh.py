"""Triangle meshes of deformed links and of round parts: motors, payload, target."""

from collections.abc import Mapping, Sequence
from functools import cache
from itertools import combinations, product
from typing import Any, NamedTuple

import numpy as np

from flexman_gym.common.arrays import Array, IntArray
from flexman_gym.model.deformation import Curves
from flexman_gym.model.element import Element
from flexman_gym.model.model import Model

SIDES = 16  # number of points on the outline of a section
MIN_RADIUS, MIN_HALF_SIDE = 0.008, 0.0025  # fractions of the reach; least radius of a round, half width of a flat link
ROUND_TOLERANCE = 0.02  # relative difference of the radii of gyration up to which a section is drawn round


class Mesh(NamedTuple):
    """Triangle mesh.

    Attributes:
        points: vertices (p, 3), m.
        normals: outward normals (p, 3), not of unit length.
        faces: vertices of triangles (f, 3) int32, counter-clockwise as seen from outside.
    """

    points: Array
    normals: Array
    faces: IntArray

    def transformed(self, origin: Array, axis: Array, radius: float, half: float) -> "Mesh":
        """Return the mesh scaled, rotated and translated.

        Args:
            origin: position of the origin of the mesh (3,), m.
            axis: direction of the z axis of the mesh (3,), a unit vector.
            radius: scale of x and y, m.
            half: scale of z, half of the length, m.
        """
        x, y, z = axis
        side = np.array([0.0, z, -y] if abs(x) < 0.6 else [-z, 0.0, x]) / np.hypot(z, y if abs(x) < 0.6 else x)
        turned = np.array([side, axis[[1, 2, 0]] * side[[2, 0, 1]] - axis[[2, 0, 1]] * side[[1, 2, 0]], axis])
        return Mesh(self.points * (radius, radius, half) @ turned + origin, self.normals @ turned, self.faces)


BORDER_POINTS = 120  # number of points of a circle or an edge
BORDER_TOLERANCE = 1e-6  # dimensionless; relative rounding error of points on the sphere of the reach


def boundaries(regions: Sequence[Mapping[str, Any]], reach: float) -> list[Array]:
    """Return lines (p, 3), m, on the boundaries of regions, within the sphere of the reach of an arm.

    A plane is drawn as the circle in which it intersects this sphere, a box as its edges and the circles of its sides,
    and a sphere as three circles.

    Args:
        regions: regions, see `Limits.workspace`.
        reach: sum of the lengths of the links, m.
    """
    turn, lines = np.linspace(0.0, 2.0 * np.pi, BORDER_POINTS), []
    circle = np.column_stack([np.cos(turn), np.sin(turn), np.zeros(BORDER_POINTS)])
    for region in regions:
        [(shape, (first, second))] = region.items()
        if shape == "sphere":
            parts = [np.array(first) + second * np.roll(circle, axis, axis=1) for axis in range(3)]
            lines += [(line, np.ones(BORDER_POINTS, dtype=bool)) for line in parts]
        elif shape == "half_space":
            lines += _plane_circle(np.array(first), second, reach * circle)
        else:
            ends = np.array([first, second])
            corners = [ends[list(each), range(3)] for each in product((0, 1), repeat=3)]
            edges = [pair for pair in combinations(corners, 2) if np.count_nonzero(pair[0] != pair[1]) == 1]
            lines += [(np.linspace(*pair, BORDER_POINTS), np.ones(BORDER_POINTS, dtype=bool)) for pair in edges]
            for axis, end in product(range(3), ends):
                for line, _ in _plane_circle(np.eye(3)[axis], end[axis], reach * circle):
                    line[:, axis] = end[axis]
                    lines.append((line, ((line >= ends[0]) & (line <= ends[1])).all(axis=1)))
    result = []
    for line, shown in lines:
        shown = shown & (np.linalg.norm(line, axis=1) <= (1.0 + BORDER_TOLERANCE) * reach)
        changes = np.flatnonzero(np.diff(np.concatenate([[False], shown, [False]]))).reshape(-1, 2)
        result += [line[start:stop] for start, stop in changes if stop - start > 1]
    return result


def _plane_circle(normal: Array, offset: float, circle: Array) -> list[tuple[Array, Any]]:
    """Return the circle in which a plane, normal . x = offset (m), intersects the sphere of a circle about 0."""
    size, reach = float(np.linalg.norm(normal)), float(circle[:, 0].max())
    distance, axes = offset / size, np.linalg.svd(normal[None] / size)[2]
    if abs(distance) >= reach:
        return []
    scale = np.sqrt(1.0 - (distance / reach) ** 2)
    around = distance * normal / size + scale * circle[:, :2] @ axes[1:]
    return [(around, np.ones(len(circle), dtype=bool))]


class _SectionOutlines(NamedTuple):
    """Outlines of the drawn sections of a link at P points.

    Attributes:
        points: y and z of the drawn outline (P, 16, 2), m.
        normals: outward normals (P, 16, 2).
        gauges: y and z of the true outline (P, 16, 2), m, where the strain is evaluated.
    """

    points: Array
    normals: Array
    gauges: Array

    @property
    def radius(self) -> float:
        """Half of the largest drawn width, m."""
        return float(np.abs(self.points).max())


def section_outlines(model: Model, places: int) -> tuple[_SectionOutlines, ...]:
    """Return the outlines of the sections of each link at equally spaced points.

    A section without a given outline is drawn as a solid disc if its radii of gyration are equal, and otherwise as a
    solid rectangle with the same radii of gyration. Very thin sections are drawn thicker.

    Args:
        model: model of the arm.
        places: number of points on each link.
    """
    reach, result = float(model.constants.length.sum()), []
    for i, link in enumerate(model.arm.links):
        elements = model.elements(i)
        parts = [
            _section(Element.find(elements, place)[0].section, reach) for place in np.linspace(0.0, link.length, places)
        ]
        result.append(_SectionOutlines(*(np.array(each) for each in zip(*parts, strict=True))))
    return tuple(result)


def _section(section: Any, reach: float) -> tuple[Array, Array, Array]:
    """Return points, normals and gauges (16, 2) of a section."""
    gyration = np.sqrt(np.array([section.second_moment_z, section.second_moment_y]) / section.area)
    outline, alike = section.outline, abs(gyration[0] / gyration[1] - 1.0) < ROUND_TOLERANCE
    half = np.sqrt(3.0) * gyration if outline is None else np.array([outline.y, outline.z]) / 2
    if alike if outline is None else outline.shape != "strip":
        turn = (np.arange(SIDES) + 0.5) * 2 * np.pi / SIDES
        circle = np.column_stack([np.cos(turn), np.sin(turn)])
        radius = 2.0 * float(gyration.mean()) if outline is None else half[0]
        return max(radius, MIN_RADIUS * reach) * circle, circle, radius * circle
    along = np.linspace(-1.0, 1.0, SIDES // 4)
    one = np.ones_like(along)
    sides = [np.column_stack(each) for each in ((one, along), (-along, one), (-one, -along), (along, -one))]
    flat = [np.column_stack(each) for each in ((one, 0 * one), (0 * one, one), (-one, 0 * one), (0 * one, -one))]
    square = np.concatenate(sides)
    return square * np.maximum(half, MIN_HALF_SIDE * reach), np.concatenate(flat), square * half


@cache
def _tube_faces(links: int, places: int) -> IntArray:
    """Return the triangles (f, 3) of links with closed ends; the order of the vertices is link, point, side."""
    point = np.arange(links * places * SIDES, dtype=np.int32).reshape(links, places, SIDES)
    after = np.roll(point, -1, axis=2)
    a, b, c, d = (each.ravel() for each in (point[:, :-1], after[:, :-1], after[:, 1:], point[:, 1:]))
    fan = np.array([(0, side, side + 1) for side in range(1, SIDES - 1)])
    root, tip = point[:, 0][:, fan[:, [0, 2, 1]]], point[:, -1][:, fan]
    sides = np.concatenate([np.column_stack([a, b, c]), np.column_stack([a, c, d])])
    return np.concatenate([sides, root.reshape(-1, 3), tip.reshape(-1, 3)])


def tube_surfaces(curves: Curves, sections: Sequence[_SectionOutlines]) -> tuple[Mesh, Array]:
    """Return the surface of all links at one state, with v vertices, and the axial strain (v,) at its vertices.

    Args:
        curves: centrelines of the n links at P points each.
        sections: section outlines of each link.
    """
    points, normals, gauges = (np.array([section[k] for section in sections]) for k in range(3))
    across = curves.frames[..., 1:]
    surface = curves.positions[..., None, :] + np.einsum("...ipab,ipsb->...ipsa", across, points)
    outward = np.einsum("...ipab,ipsb->...ipsa", across, normals)
    stretch, curvature = curves.strains[..., 0, None], curves.curvatures[..., None, :]
    strain = stretch - gauges[..., 0] * curvature[..., 2] + gauges[..., 1] * curvature[..., 1]
    return Mesh(surface.reshape(-1, 3), outward.reshape(-1, 3), _tube_faces(*strain.shape[:2])), strain.ravel()


def _surface_of_revolution(profile: tuple[tuple[float, float, float, float], ...], sides: int = 24) -> Mesh:
    """Return the surface of revolution of a profile about the z axis.

    Args:
        profile: radius, height, and the two components of the normal, from below to above.
        sides: number of points around the axis.
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


def _cylinder(bevel: float) -> Mesh:
    inner, half = 1.0 - bevel, ((0.0, -1.0), (1.0 - bevel, -1.0))
    low = [(radius, height, 0.0, -1.0) for radius, height in half]
    edge = [(inner, -1.0, 0.4, -0.9), (1.0, -inner, 0.95, -0.3), (1.0, inner, 0.95, 0.3), (inner, 1.0, 0.4, 0.9)]
    return _surface_of_revolution((*low, *edge, (inner, 1.0, 0.0, 1.0), (0.0, 1.0, 0.0, 1.0)))


def _sphere(rings: int) -> Mesh:
    turn = np.linspace(-np.pi / 2, np.pi / 2, rings + 1)
    return _surface_of_revolution(tuple((np.cos(t), np.sin(t), np.cos(t), np.sin(t)) for t in turn.tolist()))


def _ring(thick: float, rings: int) -> Mesh:
    turn = np.linspace(-np.pi, np.pi, rings + 1)
    profile = ((1.0 + thick * np.cos(t), thick * np.sin(t), np.cos(t), np.sin(t)) for t in turn.tolist())
    return _surface_of_revolution(tuple(profile), 40)


CYLINDER, SHARP_CYLINDER = _cylinder(0.1), _cylinder(0.01)  # radius 1, from z = -1 to 1; edges bevelled by 0.1 and 0.01
SPHERE = _sphere(12)  # radius 1
RING = _ring(0.11, 10)  # torus of radius 1 in the x-y plane

"""Bodies: the lumped masses of a link as mass points and stations of its beam."""

from collections.abc import Sequence

import numpy as np

from flexman_gym.arrays import Array
from flexman_gym.model.element import (
    GAUSS_POINTS,
    NODE_COORDINATES,
    Element,
    beam_shapes,
    beam_slopes,
    find_element,
)
from flexman_gym.scene.lumped import LumpedMass


def body_points(bodies: Sequence[LumpedMass], elements: Sequence[Element], size: int) -> tuple[Array, Array, Array]:
    """Gives masses (p,), positions (p, 3) and shapes (p, 3, size) of points with the mass and inertia of the bodies.

    A rigid body is six points of equal mass, two on each principal axis. A point mass is one.

    Args:
        bodies: lumped masses of the link.
        elements: of the link, base to tip.
        size: number of its node coordinates, the clamped node included.
    """
    masses, positions, shapes = [], [], []
    for each in bodies:
        points = _points(each)
        for point in points:
            masses.append(each.mass / len(points))
            positions.append([each.position + point[0], point[1], point[2]])
            shapes.append(_displacement(each, point, elements, size))
    return np.array(masses), np.array(positions), np.array(shapes)


def body_stations(bodies: Sequence[LumpedMass], elements: Sequence[Element], size: int) -> tuple[Array, Array, Array]:
    """Gives G (b, size, size), stations (b, 4) and shapes (b, 3, size) of the centres of mass of the bodies.

    Foreshortening draws a body back with its section. Arguments are those of `body_points`, results those of `Beam`.
    """
    centres = [np.array(each.offset or np.zeros(3)) for each in bodies]
    stations = [[each.mass, each.position + at[0], at[1], at[2]] for each, at in zip(bodies, centres, strict=True)]
    shapes = [_displacement(each, at, elements, size) for each, at in zip(bodies, centres, strict=True)]
    return (
        np.array([shortening(each.position, elements, size) for each in bodies]),
        np.array(stations),
        np.array(shapes),
    )


def _points(body: LumpedMass) -> Array:
    """Gives the places (p, 3) of points of equal mass relative to the axis at the section of a body, m."""
    centre = np.array(body.offset or np.zeros(3))
    if body.inertia is None:
        return centre[None]
    inertia = np.array(body.inertia)
    moments, axes = np.linalg.eigh(np.trace(inertia) / 2.0 * np.eye(3) - inertia)  # second moments of mass
    arms = (np.sqrt(3.0 * np.maximum(moments, 0.0) / body.mass) * axes).T
    return centre + np.vstack([arms, -arms])


def _displacement(body: LumpedMass, point: Array, elements: Sequence[Element], size: int) -> Array:
    """Gives the displacement (3, size) of a point of a body at (3,) from the axis: u + theta x r of its section."""
    element, xi = find_element(elements, body.position)
    turn = np.zeros((3, 2 * NODE_COORDINATES))
    turn[0, [3, 9]] = 1.0 - xi, xi
    slopes = beam_slopes(xi, element.length)
    turn[1], turn[2] = -slopes[1], slopes[0]  # theta_y = -w', theta_z = v'
    result = np.zeros((3, size))
    result[:, element.nodes] = beam_shapes(xi, element.length, 0.0, 0.0) + np.cross(turn.T, point).T
    return result


def shortening(position: float, elements: Sequence[Element], size: int) -> Array:
    """Gives the integral (size, size) of v'^T v' + w'^T w' from the base of a link to a position (m)."""
    abscissae, weights = np.polynomial.legendre.leggauss(GAUSS_POINTS)
    result = np.zeros((size, size))
    for element in elements:
        end = np.clip((position - element.start) / element.length, 0.0, 1.0)
        for xi, weight in zip(end * (1 + abscissae) / 2, end * weights / 2, strict=True):
            slopes = beam_slopes(xi, element.length)
            result[element.nodes, element.nodes] += weight * element.length * slopes.T @ slopes
    return result

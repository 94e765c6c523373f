"""Finite element of a link: shape functions and their slopes."""

from bisect import bisect_right
from collections.abc import Sequence
from typing import NamedTuple, Self

import numpy as np

from flexman_gym.common.arrays import Array
from flexman_gym.scene.link import Link, NonUniformLink

NODE_COORDINATES = 6  # number of coordinates of a node: u, v, w, phi, theta_y = -w', theta_z = v'
GAUSS_POINTS = 4  # number of Gauss points per element: exact to degree 7; mass integrals have degree 6


class Element(NamedTuple):
    """Finite element of a link between two neighbouring nodes.

    Attributes:
        section: uniform link section that contains the element.
        start: position of the first node of the element along the link, m.
        length: m.
        nodes: slice of its twelve node coordinates among the node coordinates of the link, including the clamped node
            0.
    """

    section: Link
    start: float
    length: float
    nodes: slice

    @classmethod
    def divide(cls, link: Link | NonUniformLink, elements: int) -> list[Self]:
        """Return the finite elements of a link, base to tip.

        Args:
            link: the link.
            elements: number of equal elements in each section of the link.
        """
        result: list[Self] = []
        start = 0.0
        for section in link.sections:
            length = (section.length or 1.0) / elements  # any length serves a rigid link of no length and mass
            for i in range(elements):
                first = NODE_COORDINATES * len(result)
                result.append(cls(section, start + i * length, length, slice(first, first + 2 * NODE_COORDINATES)))
            start += section.length
        return result

    @classmethod
    def find(cls, elements: Sequence[Self], position: float) -> tuple[Self, float]:
        """Return the element at a position along a link, and the relative position xi in it, from 0 to 1.

        Args:
            elements: elements of the link, base to tip.
            position: distance from the joint along the link, m, not negative. The element at a node is the outboard
                one.
        """
        element = elements[bisect_right(elements, position, key=lambda element: element.start) - 1]
        return element, (position - element.start) / element.length

    def shapes(self, xi: float, y: float = 0.0, z: float = 0.0) -> Array:
        """Return the displacement (3, 12) of a point of the element per unit of its twelve node coordinates.

        The displacement is [u - y v' - z w', v - z phi, w + y phi], with cubic Hermite polynomials for v and w and
        linear u and phi: the matrix S in Eq. (3), see `model.beam`.

        Args:
            xi: relative position along the element, from 0 to 1.
            y: coordinate of the point in the cross-section, m.
            z: coordinate of the point in the cross-section, m.
        """
        axial = (1 - xi, xi)
        deflection, slope = _hermite(xi, self.length), _hermite_derivative(xi, self.length)
        shapes = np.zeros((3, 2 * NODE_COORDINATES))
        for node in range(2):
            u, v, w, phi, theta_y, theta_z = range(NODE_COORDINATES * node, NODE_COORDINATES * (node + 1))
            shapes[0, u] = axial[node]
            shapes[1, phi], shapes[2, phi] = -z * axial[node], y * axial[node]
            shapes[1, v], shapes[0, v] = deflection[2 * node], -y * slope[2 * node]
            shapes[1, theta_z], shapes[0, theta_z] = deflection[2 * node + 1], -y * slope[2 * node + 1]
            shapes[2, w], shapes[0, w] = deflection[2 * node], -z * slope[2 * node]
            shapes[2, theta_y], shapes[0, theta_y] = -deflection[2 * node + 1], z * slope[2 * node + 1]
        return shapes

    def slopes(self, xi: float) -> Array:
        """Return the slopes v' and w' (2, 12) of the centreline of the element per unit of its twelve node coordinates.

        Args:
            xi: relative position along the element, from 0 to 1.
        """
        slope = np.array(_hermite_derivative(xi, self.length))
        slopes = np.zeros((2, 2 * NODE_COORDINATES))
        slopes[0, [1, 5, 7, 11]] = slope
        slopes[1, [2, 4, 8, 10]] = slope * [1.0, -1.0, 1.0, -1.0]  # theta_y = -w'
        return slopes


def section_points(link: Link) -> Array:
    """Return y and z (4, 2), m, of four points of equal mass with the second moments of a cross-section."""
    y = np.sqrt(2 * link.second_moment_z / link.area)
    z = np.sqrt(2 * link.second_moment_y / link.area)
    return np.array([[y, 0], [-y, 0], [0, z], [0, -z]])


def _hermite(xi: float, length: float) -> tuple[float, float, float, float]:
    """Return the cubic Hermite polynomials of deflection and slope at the first node, then of those at the second."""
    return (
        1 - 3 * xi**2 + 2 * xi**3,
        length * xi * (1 - xi) ** 2,
        3 * xi**2 - 2 * xi**3,
        length * xi**2 * (xi - 1),
    )


def _hermite_derivative(xi: float, length: float) -> tuple[float, float, float, float]:
    """Return the derivatives of the cubic Hermite polynomials with respect to the position along the element."""
    return (
        6 * xi * (xi - 1) / length,
        (1 - xi) * (1 - 3 * xi),
        6 * xi * (1 - xi) / length,
        xi * (3 * xi - 2),
    )

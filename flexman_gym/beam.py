"""The beam: finite elements of one link and the integrals that its dynamics needs.

A link is a straight Euler-Bernoulli beam along its own x axis, clamped to the floating frame at x = 0. Its mass is
represented by mass points, four Gauss points an element times four section points; they integrate the polynomials of
these elements exactly, so the sums below equal the volume integrals of Eq. 13 and 14.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from flexman_gym.arm import Link

Array = NDArray[np.float64]

GAUSS_POINTS = 4  # exact to degree 7; the mass of cubic Hermite shapes has degree 6
GROUP = 4  # the tip and the stations of a link, for foreshortening, fill groups of this many
NODE_COORDINATES = 6  # u, v, w, phi_x, theta_y = -w', theta_z = v'


@dataclass(frozen=True)
class Beam:
    """Discretised link with k elastic coordinates (k = 0 for a rigid link), in the link's beam frame.

    Attributes:
        masses: (p,) kg, mass of each mass point.
        positions: (p, 3) m, undeformed position of each mass point.
        shapes: (p, 3, k), displacement of each mass point per unit coordinate (S of Eq. 3).
        stiffness: (k, k), elastic stiffness (K of Eq. 18).
        tip_translation, tip_rotation: (3, k), displacement and rotation vector of the tip section (S^jt, S^jr).
        shortening: (s, k, k), G at each station: the foreshortening of the centreline from 0 to there is 1/2 q^T G q.
        stations: (s, 2) kg and m, mass and place of the stations on the centreline, first the tip, without mass.
        station_shapes: (s, 3, k) displacement of the centreline at the stations.
    """

    masses: Array
    positions: Array
    shapes: Array
    stiffness: Array
    tip_translation: Array
    tip_rotation: Array
    shortening: Array
    stations: Array
    station_shapes: Array

    @property
    def mass_matrix(self) -> Array:
        """(k, k) elastic mass matrix, sum of m S^T S over the mass points (lower right block of Eq. 13)."""
        return np.einsum("p,pia,pib->ab", self.masses, self.shapes, self.shapes)

    def reduced(self, basis: Array) -> "Beam":
        """The same beam in the coordinates p with q = basis @ p; basis: (k, m)."""
        return Beam(
            self.masses,
            self.positions,
            self.shapes @ basis,
            basis.T @ self.stiffness @ basis,
            self.tip_translation @ basis,
            self.tip_rotation @ basis,
            basis.T @ self.shortening @ basis,
            self.stations,
            self.station_shapes @ basis,
        )


@dataclass(frozen=True)
class ShapeIntegrals:
    """Mass integrals of a beam with k elastic coordinates; r0 is the undeformed position, S_a shape vector a.

    Attributes:
        mass: sum m, kg.
        first_moment: (3,) sum m r0.
        first_moment_shape: (k, 3) sum m S_a.
        second_moment: (3, 3) sum m r0 r0^T.
        position_shape: (k, 3, 3) sum m r0 S_a^T.
        shape_shape: (k, k, 3, 3) sum m S_b S_a^T, first index b.
        elastic: (k, k) sum m S_a . S_b.
    """

    mass: float
    first_moment: Array
    first_moment_shape: Array
    second_moment: Array
    position_shape: Array
    shape_shape: Array
    elastic: Array


def beam_shapes(xi: float, length: float, y: float, z: float) -> Array:
    """(3, 12) displacement of the point (xi * length, y, z) of one element per unit of its twelve node coordinates.

    u(x, y, z) = [u - y v' - z w', v - z phi, w + y phi] with cubic Hermite v, w and linear u, phi; xi in [0, 1].
    """
    axial = (1 - xi, xi)
    deflection, slope = _hermite(xi, length), _hermite_derivative(xi, length)
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


def beam_stiffness(link: Link, length: float) -> Array:
    """(12, 12) stiffness of one element of the given length: axial, St Venant torsion and bending in two planes."""
    stiffness = np.zeros((2 * NODE_COORDINATES, 2 * NODE_COORDINATES))
    bar = np.array([[1.0, -1.0], [-1.0, 1.0]]) / length
    stiffness[np.ix_([0, 6], [0, 6])] = link.youngs_modulus * link.area * bar
    stiffness[np.ix_([3, 9], [3, 9])] = link.shear_modulus * link.torsion_constant * bar
    a, b, c, d = 12 / length**3, 6 / length**2, 4 / length, 2 / length
    bending = np.array([[a, b, -a, b], [b, c, -b, d], [-a, -b, a, -b], [b, d, -b, c]])
    stiffness[np.ix_([1, 5, 7, 11], [1, 5, 7, 11])] = link.youngs_modulus * link.second_moment_z * bending
    mirror = np.array([1.0, -1.0, 1.0, -1.0])  # theta_y = -w'
    stiffness[np.ix_([2, 4, 8, 10], [2, 4, 8, 10])] = (
        link.youngs_modulus * link.second_moment_y * bending * np.outer(mirror, mirror)
    )
    return stiffness


def build_beam(link: Link, elements: int, flexible: bool = True) -> Beam:
    """Assembles a link from equal elements, with node 0 clamped to the floating frame: k = 6 * elements, or 0 if rigid.

    The coordinates are ordered node by node from the first free node to the tip.
    """
    length = link.length / elements
    size = NODE_COORDINATES * (elements + 1)
    stiffness = np.zeros((size, size))
    section = section_points(link)
    abscissae, weights = np.polynomial.legendre.leggauss(GAUSS_POINTS)
    masses, positions, shapes = [], [], []
    for element in range(elements):
        nodes = slice(NODE_COORDINATES * element, NODE_COORDINATES * (element + 2))
        stiffness[nodes, nodes] += beam_stiffness(link, length)
        for xi, weight in zip((1 + abscissae) / 2, weights / 2, strict=True):
            for y, z in section:
                masses.append(weight * length * link.density * link.area / len(section))
                positions.append([(element + xi) * length, y, z])
                shape = np.zeros((3, size))
                shape[:, nodes] = beam_shapes(xi, length, y, z)
                shapes.append(shape)
    shortening, stations, station_shapes = _stations(link, elements)
    kept = slice(NODE_COORDINATES, size if flexible else NODE_COORDINATES)
    identity = np.eye(size)
    return Beam(
        np.array(masses),
        np.array(positions),
        np.array(shapes)[:, :, kept],
        stiffness[kept, kept],
        identity[-6:-3, kept],
        identity[-3:, kept],
        shortening[:, kept, kept],
        stations,
        station_shapes[:, :, kept],
    )


def beam_slopes(xi: float, length: float) -> Array:
    """(2, 12) slopes v' and w' of the centreline of one element per unit of its twelve node coordinates."""
    slope = np.array(_hermite_derivative(xi, length))
    slopes = np.zeros((2, 2 * NODE_COORDINATES))
    slopes[0, [1, 5, 7, 11]] = slope
    slopes[1, [2, 4, 8, 10]] = slope * [1.0, -1.0, 1.0, -1.0]  # theta_y = -w'
    return slopes


def _stations(link: Link, elements: int) -> tuple[Array, Array, Array]:
    """G at each station (s, size, size), stations (s, 2) and their shapes (s, 3, size), the first at the tip.

    The other s - 1 >= elements + 1 stand for the polynomials nearest to the motion of the centreline: each, at a Gauss
    point of the link, is the mean with that point's Lagrange polynomial as weight. Products of such polynomials have
    the exact integral, and what stations leave of a mass matrix is a sum of squares, so it stays positive.
    G at a point is the integral of v'^T v' + w'^T w' from the base to there, by Gauss points that make it exact.
    """
    length, size = link.length / elements, NODE_COORDINATES * (elements + 1)
    count = GROUP * -(-(elements + 2) // GROUP) - 1
    points, shares = np.polynomial.legendre.leggauss(count)
    places = (1 + points) / 2 * elements
    abscissae, weights = np.polynomial.legendre.leggauss(GAUSS_POINTS)
    fine, parts = np.polynomial.legendre.leggauss((count + 7) // 2)  # exact to degree 5 of G times that of the weight
    before = np.zeros((size, size))
    integrals, shapes = np.zeros((count + 1, size, size)), np.zeros((count + 1, 3, size))
    for element in range(elements):
        nodes = slice(NODE_COORDINATES * element, NODE_COORDINATES * (element + 2))
        for end, part in [*zip((1 + fine) / 2, parts / elements, strict=True), (1.0, 0.0)]:
            integral, shape = before.copy(), np.zeros((3, size))
            shape[:, nodes] = beam_shapes(end, length, 0.0, 0.0)
            for xi, weight in zip(end * (1 + abscissae) / 2, end * weights / 2, strict=True):
                slopes = beam_slopes(xi, length)
                integral[nodes, nodes] += weight * length * slopes.T @ slopes
            means = part / shares * _lagrange(places, element + end)
            integrals[1:] += means[:, None, None] * integral
            shapes[1:] += means[:, None, None] * shape
        before = integral
    integrals[0], shapes[0] = before, shape
    stations = np.column_stack([link.mass * shares / 2, places * length])
    return integrals, np.vstack([[0.0, link.length], stations]), shapes


def _lagrange(places: Array, x: float) -> Array:
    """The polynomials that are one at each of the places and zero at the others, at x."""
    gaps = places[:, None] - places + np.eye(len(places))
    return np.prod((x - places + np.diag(1.0 - x + places)) / gaps, axis=1)


def section_points(link: Link) -> Array:
    """(4, 2) y, z of four points of equal weight that have the section's area and both its second moments of area."""
    y = np.sqrt(2 * link.second_moment_z / link.area)
    z = np.sqrt(2 * link.second_moment_y / link.area)
    return np.array([[y, 0], [-y, 0], [0, z], [0, -z]])


def shape_integrals(beam: Beam) -> ShapeIntegrals:
    """The constant integrals from which mass matrix and quadratic velocity terms (Eq. 13, 14) follow at any state."""
    m, r0, s = beam.masses, beam.positions, beam.shapes
    return ShapeIntegrals(
        mass=float(m.sum()),
        first_moment=m @ r0,
        first_moment_shape=np.einsum("p,pia->ai", m, s),
        second_moment=np.einsum("p,pi,pj->ij", m, r0, r0),
        position_shape=np.einsum("p,pi,pja->aij", m, r0, s),
        shape_shape=np.einsum("p,pib,pja->baij", m, s, s),
        elastic=beam.mass_matrix,
    )


def _hermite(xi: float, length: float) -> tuple[float, float, float, float]:
    return (
        1 - 3 * xi**2 + 2 * xi**3,
        length * xi * (1 - xi) ** 2,
        3 * xi**2 - 2 * xi**3,
        length * xi**2 * (xi - 1),
    )


def _hermite_derivative(xi: float, length: float) -> tuple[float, float, float, float]:
    return (
        6 * xi * (xi - 1) / length,
        (1 - xi) * (1 - 3 * xi),
        6 * xi * (1 - xi) / length,
        xi * (3 * xi - 2),
    )

"""The beam: finite elements of one link and the integrals that its dynamics needs.

A link is a straight Euler-Bernoulli beam along its own x axis, clamped to the floating frame at x = 0. Its mass is
represented by mass points, four Gauss points an element times four section points; they integrate the polynomials of
these elements exactly, so the sums below equal the volume integrals of Eq. 13 and 14.

Without rotary inertia the mass points lie on the centreline, and sections beside them resist nothing but rotation about
the beam axis: their energy is that of the rotation rate w_x + phi' of a frame with angular velocity w.
"""

from bisect import bisect_right
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from flexman_gym.arrays import Array
from flexman_gym.scene.arm import Link, NonUniformLink

GAUSS_POINTS = 4  # exact to degree 7; the mass of cubic Hermite shapes has degree 6
GROUP = 4  # the tip and the stations of a link, for foreshortening, fill groups of this many
NODE_COORDINATES = 6  # u, v, w, phi_x, theta_y = -w', theta_z = v'


class Element(NamedTuple):
    """One finite element of a link, between two neighbouring nodes."""

    section: Link  # the uniform link that it is a piece of
    start: float  # m, place of its first node along the link
    length: float  # m
    nodes: slice  # its twelve node coordinates among those of the link, the clamped node 0 included


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
        polar: (t,) kg m^2, inertia about the beam axis of sections that resist no other rotation; empty with rotary
            inertia, which the mass points hold.
        twist: (t, k), rotation of these sections about the beam axis per unit coordinate.
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
    polar: Array
    twist: Array

    @property
    def mass_matrix(self) -> Array:
        """(k, k) elastic mass matrix, sum of m S^T S over the mass points (lower right block of Eq. 13)."""
        spinning = (self.twist.T * self.polar) @ self.twist
        return np.einsum("p,pia,pib->ab", self.masses, self.shapes, self.shapes) + spinning

    def reduced(self, basis: Array) -> "Beam":
        """The same beam in the coordinates p with q = basis @ p; basis: (k, m)."""
        return replace(
            self,
            shapes=self.shapes @ basis,
            stiffness=basis.T @ self.stiffness @ basis,
            tip_translation=self.tip_translation @ basis,
            tip_rotation=self.tip_rotation @ basis,
            shortening=basis.T @ self.shortening @ basis,
            station_shapes=self.station_shapes @ basis,
            twist=self.twist @ basis,
        )


@dataclass(frozen=True)
class ShapeIntegrals:
    """Mass integrals of a beam with k elastic coordinates; r0 is the undeformed position, S_a shape vector a.

    Sections that resist rotation about the beam axis alone take part as the (fictitious) second moments of mass that
    give them the right inertia: j about x, nothing about y and z, and j_a about x for the rate of coordinate a.

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


def beam_elements(link: Link | NonUniformLink, elements: int) -> list[Element]:
    """The finite elements of a link, base to tip: so many equal ones in each of its sections."""
    result: list[Element] = []
    start = 0.0
    for section in link.sections:
        length = section.length / elements
        for i in range(elements):
            first = NODE_COORDINATES * len(result)
            result.append(Element(section, start + i * length, length, slice(first, first + 2 * NODE_COORDINATES)))
        start += section.length
    return result


def find_element(elements: Sequence[Element], position: float) -> tuple[Element, float]:
    """The element of a link at a position >= 0 (m), the outboard one at a node between two, and xi of 0 to 1 there."""
    element = elements[bisect_right(elements, position, key=lambda element: element.start) - 1]
    return element, (position - element.start) / element.length


def build_beam(link: Link | NonUniformLink, elements: int, flexible: bool = True, rotary_inertia: bool = True) -> Beam:
    """Assembles a link from equal elements in each section, with node 0 clamped to the floating frame.

    k = 6 * elements * number of sections, or 0 if rigid. The coordinates are ordered node by node from the first free
    node to the tip. Without rotary inertia the sections resist rotation about the beam axis only.
    """
    pieces = beam_elements(link, elements)
    size = NODE_COORDINATES * (len(pieces) + 1)
    stiffness = np.zeros((size, size))
    for piece in pieces:
        stiffness[piece.nodes, piece.nodes] += beam_stiffness(piece.section, piece.length)
    masses, positions, shapes = _mass_points(pieces, size, rotary_inertia)
    polar, twist = _spinning_sections([] if rotary_inertia else pieces, size)
    shortening, stations, station_shapes = _stations(pieces, size)
    kept = slice(NODE_COORDINATES, size if flexible else NODE_COORDINATES)
    identity = np.eye(size)
    return Beam(
        masses=masses,
        positions=positions,
        shapes=shapes[:, :, kept],
        stiffness=stiffness[kept, kept],
        tip_translation=identity[-6:-3, kept],
        tip_rotation=identity[-3:, kept],
        shortening=shortening[:, kept, kept],
        stations=stations,
        station_shapes=station_shapes[:, :, kept],
        polar=polar,
        twist=twist[:, kept],
    )


def _mass_points(elements: Sequence[Element], size: int, rotary_inertia: bool) -> tuple[Array, Array, Array]:
    """Masses (p,), positions (p, 3) and shapes (p, 3, size) of the mass points."""
    abscissae, weights = np.polynomial.legendre.leggauss(GAUSS_POINTS)
    masses, positions, shapes = [], [], []
    for section, start, length, nodes in elements:
        points = section_points(section) if rotary_inertia else np.zeros((1, 2))
        for xi, weight in zip((1 + abscissae) / 2, weights / 2, strict=True):
            for y, z in points:
                masses.append(weight * length * section.density * section.area / len(points))
                positions.append([start + xi * length, y, z])
                shape = np.zeros((3, size))
                shape[:, nodes] = beam_shapes(xi, length, y, z)
                shapes.append(shape)
    return np.array(masses), np.array(positions), np.array(shapes)


def _spinning_sections(elements: Sequence[Element], size: int) -> tuple[Array, Array]:
    """Polar inertias (t,) in kg m^2 and twists (t, size) of sections at the Gauss points of the elements."""
    abscissae, weights = np.polynomial.legendre.leggauss(GAUSS_POINTS)
    count = len(elements) * GAUSS_POINTS
    polar, twist = np.zeros(count), np.zeros((count, size))
    for i, (section, _, length, nodes) in enumerate(elements):
        rows = slice(GAUSS_POINTS * i, GAUSS_POINTS * (i + 1))
        polar[rows] = weights / 2 * length * section.density * (section.second_moment_y + section.second_moment_z)
        _, _, _, inner, *_, outer, _, _ = range(nodes.start, nodes.stop)
        twist[rows, inner], twist[rows, outer] = (1 - abscissae) / 2, (1 + abscissae) / 2
    return polar, twist


def beam_slopes(xi: float, length: float) -> Array:
    """(2, 12) slopes v' and w' of the centreline of one element per unit of its twelve node coordinates."""
    slope = np.array(_hermite_derivative(xi, length))
    slopes = np.zeros((2, 2 * NODE_COORDINATES))
    slopes[0, [1, 5, 7, 11]] = slope
    slopes[1, [2, 4, 8, 10]] = slope * [1.0, -1.0, 1.0, -1.0]  # theta_y = -w'
    return slopes


def _stations(elements: Sequence[Element], size: int) -> tuple[Array, Array, Array]:
    """G at each station (s, size, size), stations (s, 2) and their shapes (s, 3, size), the first at the tip.

    The other s - 1 >= elements + 1 stand for the polynomials nearest to the motion of the centreline: each, at a Gauss
    point of the link, is the mean with that point's Lagrange polynomial as weight. Products of such polynomials have
    the exact integral, and what stations leave of a mass matrix is a sum of squares, so it stays positive.
    G at a point is the integral of v'^T v' + w'^T w' from the base to there, by Gauss points that make it exact.
    """
    count = GROUP * -(-(len(elements) + 2) // GROUP) - 1
    abscissae, weights = np.polynomial.legendre.leggauss(GAUSS_POINTS)
    fine, parts = np.polynomial.legendre.leggauss((count + 7) // 2)  # exact to degree 5 of G times that of the weight
    points = np.concatenate([start + length * (1 + fine) / 2 for _, start, length, _ in elements])
    shares = np.concatenate([parts / 2 * length * each.density * each.area for each, _, length, _ in elements])
    places, masses = _gauss_rule(points, shares, count)
    before, means = np.zeros((size, size)), iter((shares / masses[:, None] * _lagrange(places, points)).T)
    integrals, shapes = np.zeros((count + 1, size, size)), np.zeros((count + 1, 3, size))
    for _, _, length, nodes in elements:
        for end in [*(1 + fine) / 2, 1.0]:
            integral, shape = before.copy(), np.zeros((3, size))
            shape[:, nodes] = beam_shapes(end, length, 0.0, 0.0)
            for xi, weight in zip(end * (1 + abscissae) / 2, end * weights / 2, strict=True):
                slopes = beam_slopes(xi, length)
                integral[nodes, nodes] += weight * length * slopes.T @ slopes
            if end < 1.0:
                mean = next(means)[:, None, None]
                integrals[1:] += mean * integral
                shapes[1:] += mean * shape
        before = integral
    integrals[0], shapes[0] = before, shape
    tip = [[0.0, elements[-1][1] + elements[-1][2]]]
    return integrals, np.vstack([tip, np.column_stack([masses, places])]), shapes


def _gauss_rule(places: Array, masses: Array, count: int) -> tuple[Array, Array]:
    """Places and masses (count,) that integrate polynomials to degree 2 count - 1 over many masses at their places.

    From the three-term recurrence of their orthogonal polynomials (Golub and Welsch, Math. Comp. 23, 1969).
    """
    diagonal, beside = np.zeros(count), np.zeros(count)
    before, now = np.zeros(len(places)), np.ones(len(places)) / np.sqrt(masses.sum())
    for i in range(count):
        diagonal[i] = masses @ (places * now**2)
        ahead = (places - diagonal[i]) * now - (beside[i - 1] if i else 0.0) * before
        beside[i] = np.sqrt(masses @ ahead**2)
        before, now = now, ahead / beside[i]
    found, vectors = np.linalg.eigh(np.diag(diagonal) + np.diag(beside[:-1], -1))  # reads the lower triangle
    return found, masses.sum() * vectors[0] ** 2


def _lagrange(places: Array, points: Array) -> Array:
    """(s, p) polynomials that are one at one of the places (s,) and zero at the others, at the points (p,)."""
    others = ~np.eye(len(places), dtype=bool)
    return np.array(
        [
            np.prod((points[:, None] - places[other]) / (place - places[other]), axis=1)
            for place, other in zip(places, others, strict=True)
        ]
    )


def section_points(link: Link) -> Array:
    """(4, 2) y, z of four points of equal weight that have the section's area and both its second moments of area."""
    y = np.sqrt(2 * link.second_moment_z / link.area)
    z = np.sqrt(2 * link.second_moment_y / link.area)
    return np.array([[y, 0], [-y, 0], [0, z], [0, -z]])


def shape_integrals(beam: Beam) -> ShapeIntegrals:
    """The constant integrals from which mass matrix and quadratic velocity terms (Eq. 13, 14) follow at any state."""
    m, r0, s = beam.masses, beam.positions, beam.shapes
    position_shape = np.einsum("p,pi,pja->aij", m, r0, s)
    half = beam.polar @ beam.twist / 2
    position_shape[:, 1, 2] += half
    position_shape[:, 2, 1] -= half
    return ShapeIntegrals(
        mass=float(m.sum()),
        first_moment=m @ r0,
        first_moment_shape=np.einsum("p,pia->ai", m, s),
        second_moment=np.einsum("p,pi,pj->ij", m, r0, r0) + beam.polar.sum() / 2 * np.diag([-1.0, 1.0, 1.0]),
        position_shape=position_shape,
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

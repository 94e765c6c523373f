"""Finite-element beam of one link: mass points, lumped masses, and stations for the foreshortening.

A link is a straight Euler-Bernoulli beam along the x axis of its beam frame, which is its floating frame and fixed to
the cross-section at x = 0. Mass points represent the mass: each element has four Gauss points along its length, with
four points in each cross-section. Their sums are exact for the polynomials of the elements and equal the volume
integrals in Eqs. (13) and (14) of the paper. Stations are points at which the foreshortening of the centreline is
evaluated; their masses represent the mass that it displaces.

Without rotary inertia the mass points lie on the centreline, and the cross-sections at the Gauss points have a moment
of inertia about the beam axis only. In a beam frame with the angular velocity w the angular velocity of a cross-section
about this axis is w_x + dphi/dt. Equation numbers are those of the paper "Dynamic modeling and simulation of spatial
manipulator with flexible links and joints", see `docs/theory.md`.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from flexman_gym.common.arrays import Array
from flexman_gym.model.element import GAUSS_POINTS, NODE_COORDINATES, Element, section_points
from flexman_gym.scene.link import Link, NonUniformLink
from flexman_gym.scene.rigid_body import LumpedMass

BLOCK = 2 * NODE_COORDINATES  # number of coordinates of an element
STATION_GROUP = 4  # divisor of the number of stations of a link, including its tip


def _beam_stations(elements: Sequence[Element], size: int) -> tuple[Array, Array, Array]:
    """Return matrix G, mass, position and shape functions of each station; the first station is the massless tip.

    The other s - 1 >= elements + 1 stations lie at the Gauss points of the mass distribution of the link. Their shape
    functions are the values at these points of the mass-weighted L2 projection of the motion onto polynomials of degree
    s - 2. Gauss quadrature is exact for products of two of them, so that the mass matrix minus the contribution of the
    stations is positive semidefinite.

    G at a point is the integral of v'^T v' + w'^T w' from the base to the point, by Gauss quadrature of exact order.

    Args:
        elements: elements of the link, base to tip.
        size: number of node coordinates of the link, including the clamped node.

    Returns:
        G (s, size, size), stations (s, 4) with mass (kg) and position along x, y and z (m), and shapes (s, 3, size).
    """
    count = STATION_GROUP * -(-(len(elements) + 2) // STATION_GROUP) - 1
    abscissae, weights = np.polynomial.legendre.leggauss(GAUSS_POINTS)
    # exact for G (degree 5) times the Lagrange polynomial
    fine, parts = np.polynomial.legendre.leggauss((count + 7) // 2)
    points = np.concatenate([start + length * (1 + fine) / 2 for _, start, length, _ in elements])
    point_masses = np.concatenate([parts / 2 * length * each.density * each.area for each, _, length, _ in elements])
    positions, masses = _gauss_rule(points, point_masses, count)
    means = iter((point_masses / masses[:, None] * _lagrange(positions, points)).T)
    integral, shapes = np.zeros((size, size)), np.zeros((count + 1, 3, size))
    # G couples neighbouring nodes only, so one block per element is summed
    blocks, sums = _blocks(integral, len(elements)), np.zeros((count, len(elements), BLOCK, BLOCK))
    for i, element in enumerate(elements):
        length, nodes = element.length, element.nodes
        inboard = integral[nodes, nodes].copy()
        for end in [*(1 + fine) / 2, 1.0]:
            shape = element.shapes(end)
            integral[nodes, nodes] = inboard
            for xi, weight in zip(end * (1 + abscissae) / 2, end * weights / 2, strict=True):
                slopes = element.slopes(xi)
                integral[nodes, nodes] += weight * length * slopes.T @ slopes
            if end < 1.0:
                mean = next(means)[:, None, None]
                sums[:, : i + 2] += mean[:, None] * blocks[: i + 2]
                shapes[1:, :, nodes] += mean * shape
    integrals = np.zeros((count + 1, size, size))
    integrals[0], shapes[0, :, nodes] = integral, shape
    for i, element in enumerate(elements):
        integrals[1:, element.nodes, element.nodes] = sums[:, i]
    stations = np.zeros((count + 1, 4))
    stations[0, 1] = elements[-1].start + elements[-1].length
    stations[1:, 0], stations[1:, 1] = masses, positions
    return integrals, stations, shapes


def _blocks(matrix: Array, count: int) -> Array:
    """Return a view (count, 12, 12) of the overlapping diagonal blocks of a matrix, one for each element."""
    row, column = matrix.strides
    step = NODE_COORDINATES * (row + column)
    return np.lib.stride_tricks.as_strided(matrix, (count, BLOCK, BLOCK), (step, row, column), writeable=False)


def _gauss_rule(positions: Array, masses: Array, count: int) -> tuple[Array, Array]:
    """Return points (m) and weights (kg) (count,) of the Gauss quadrature of a distribution of point masses.

    The quadrature is exact to degree 2 count - 1.

    Args:
        positions: (p,) positions of the point masses along the link, m.
        masses: (p,) kg.
        count: number of points of the quadrature.
    """
    # by the three-term recurrence of the orthogonal polynomials (Golub and Welsch, Math. Comp. 23, 1969)
    diagonal, off_diagonal = np.zeros(count), np.zeros(count)
    previous, current = np.zeros(len(positions)), np.ones(len(positions)) / np.sqrt(masses.sum())
    for i in range(count):
        diagonal[i] = masses @ (positions * current**2)
        following = (positions - diagonal[i]) * current - (off_diagonal[i - 1] if i else 0.0) * previous
        off_diagonal[i] = np.sqrt(masses @ following**2)
        previous, current = current, following / off_diagonal[i]
    # eigh reads the lower triangle only
    result, vectors = np.linalg.eigh(np.diag(diagonal) + np.diag(off_diagonal[:-1], -1))
    return result, masses.sum() * vectors[0] ** 2


def _lagrange(nodes: Array, points: Array) -> Array:
    """Return the Lagrange polynomials (s, p) of the nodes (s,), evaluated at the points (p,)."""
    others = ~np.eye(len(nodes), dtype=bool)
    return np.array(
        [
            np.prod((points[:, None] - nodes[other]) / (node - nodes[other]), axis=1)
            for node, other in zip(nodes, others, strict=True)
        ]
    )


def _lumped_mass_points(
    bodies: Sequence[LumpedMass], elements: Sequence[Element], size: int
) -> tuple[Array, Array, Array]:
    """Return masses (p,), positions (p, 3) and shapes (p, 3, size) of mass points that represent lumped masses.

    The points have the mass, centre of mass and inertia of the bodies: six points of equal mass for a rigid body, two
    on each principal axis, and one point for a point mass.

    Args:
        bodies: lumped masses of the link.
        elements: elements of the link, base to tip.
        size: number of node coordinates of the link, including the clamped node.
    """
    masses, positions, shapes = [], [], []
    for body in bodies:
        points = _body_points(body)
        for point in points:
            masses.append(body.mass / len(points))
            positions.append([body.position + point[0], point[1], point[2]])
            shapes.append(_displacement(body, point, elements, size))
    return np.array(masses), np.array(positions), np.array(shapes)


def _lumped_mass_stations(
    bodies: Sequence[LumpedMass], elements: Sequence[Element], size: int
) -> tuple[Array, Array, Array]:
    """Return G (b, size, size), stations (b, 4) and shapes (b, 3, size) of the centres of mass of b lumped masses.

    Foreshortening displaces a lumped mass together with its cross-section. Arguments as in `_lumped_mass_points`,
    results as in `Beam`.
    """
    centres = [np.array(body.offset or np.zeros(3)) for body in bodies]
    stations = [[body.mass, body.position + r[0], r[1], r[2]] for body, r in zip(bodies, centres, strict=True)]
    shapes = [_displacement(body, r, elements, size) for body, r in zip(bodies, centres, strict=True)]
    return (
        np.array([foreshortening_matrix(body.position, elements, size) for body in bodies]),
        np.array(stations),
        np.array(shapes),
    )


def _body_points(body: LumpedMass) -> Array:
    """Return positions (p, 3) in m, relative to the beam axis, of equal point masses that represent a body."""
    centre = np.array(body.offset or np.zeros(3))
    if body.inertia is None:
        return centre[None]
    inertia = np.array(body.inertia)
    moments, axes = np.linalg.eigh(np.trace(inertia) / 2.0 * np.eye(3) - inertia)  # second moments of mass
    distances = (np.sqrt(3.0 * np.maximum(moments, 0.0) / body.mass) * axes).T
    return centre + np.vstack([distances, -distances])


def _displacement(body: LumpedMass, point: Array, elements: Sequence[Element], size: int) -> Array:
    """Return the displacement u + theta x r (3, size) of a point of a lumped mass per unit of node coordinates.

    Args:
        body: lumped mass.
        point: (3,) position r relative to the beam axis at the cross-section of the body, m.
        elements: elements of the link, base to tip.
        size: number of node coordinates of the link, including the clamped node.
    """
    element, xi = Element.find(elements, body.position)
    theta = np.zeros((3, 2 * NODE_COORDINATES))
    theta[0, [3, 9]] = 1.0 - xi, xi
    slopes = element.slopes(xi)
    theta[1], theta[2] = -slopes[1], slopes[0]  # theta_y = -w', theta_z = v'
    result = np.zeros((3, size))
    result[:, element.nodes] = element.shapes(xi) + np.cross(theta.T, point).T
    return result


def foreshortening_matrix(position: float, elements: Sequence[Element], size: int) -> Array:
    """Return the matrix G (size, size), 1/m: the integral of v'^T v' + w'^T w' from the base of a link to a position.

    Args:
        position: upper limit of the integral, m.
        elements: elements of the link, base to tip.
        size: number of node coordinates of the link, including the clamped node.
    """
    abscissae, weights = np.polynomial.legendre.leggauss(GAUSS_POINTS)
    result = np.zeros((size, size))
    for element in elements:
        end = np.clip((position - element.start) / element.length, 0.0, 1.0)
        for xi, weight in zip(end * (1 + abscissae) / 2, end * weights / 2, strict=True):
            slopes = element.slopes(xi)
            result[element.nodes, element.nodes] += weight * element.length * slopes.T @ slopes
    return result


@dataclass(frozen=True)
class Beam:
    """Discretised link with k elastic coordinates, in its beam frame; k = 0 for a rigid link.

    Equation numbers are those of the paper.

    Attributes:
        masses: (p,) mass of each mass point, kg.
        positions: (p, 3) position of each mass point in the undeformed link, m.
        shapes: (p, 3, k) displacement of each mass point per unit coordinate (S in Eq. (3)).
        stiffness: (k, k) stiffness matrix (K in Eq. (18)).
        tip_translation: (3, k) displacement of the tip cross-section per unit coordinate (S^jt).
        tip_rotation: (3, k) rotation vector of the tip cross-section per unit coordinate (S^jr).
        shortening: (s, k, k) matrix G of each station, 1/m; the foreshortening of the centreline inboard of the station
            is 1/2 q^T G q, a displacement of - 1/2 q^T G q along x.
        stations: (s, 4) mass (kg) and position along x, y and z (m) of each station; the first is the massless tip. The
            stations of lumped masses may lie off the centreline.
        station_shapes: (s, 3, k) displacement of each station per unit coordinate.
        polar: (t,) moments of inertia of the cross-sections at the Gauss points about the beam axis, kg m^2, for a beam
            without rotary inertia; else empty, because the mass points represent the rotary inertia.
        twist: (t, k) rotation of these cross-sections about the beam axis per unit coordinate.
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
        """Elastic mass matrix (k, k), the sum of m S^T S over the mass points (lower right block in Eq. (13))."""
        torsional = (self.twist.T * self.polar) @ self.twist
        return np.einsum("p,pia,pib->ab", self.masses, self.shapes, self.shapes) + torsional

    def reduced(self, basis: Array) -> "Beam":
        """Return the beam in reduced coordinates p, with q = basis @ p.

        Args:
            basis: (k, m) elastic coordinates per unit of each reduced coordinate.
        """
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


def build_beam(link: Link | NonUniformLink, elements: int, flexible: bool = True, rotary_inertia: bool = True) -> Beam:
    """Assemble a link from equal elements in each section, with node 0 clamped to the floating frame.

    The coordinates are ordered node by node from the first free node to the tip.

    Args:
        link: the link.
        elements: number of elements in each section; k = 6 * elements * number of sections.
        flexible: False makes the link rigid, with k = 0.
        rotary_inertia: see `ModelChoice`; lumped masses have their inertia in any case.
    """
    parts = Element.divide(link, elements)
    size = NODE_COORDINATES * (len(parts) + 1)
    stiffness = np.zeros((size, size))
    for element in parts:
        stiffness[element.nodes, element.nodes] += element_stiffness(element.section, element.length)
    points, (polar, twist), stations = inboard_masses(link, parts, rotary_inertia)
    masses, positions, shapes = points
    free = slice(NODE_COORDINATES, size if flexible else NODE_COORDINATES)
    identity = np.eye(size)
    return Beam(
        masses=masses,
        positions=positions,
        shapes=shapes[:, :, free],
        stiffness=stiffness[free, free],
        tip_translation=identity[-6:-3, free],
        tip_rotation=identity[-3:, free],
        shortening=stations[0][:, free, free],
        stations=stations[1],
        station_shapes=stations[2][:, :, free],
        polar=polar,
        twist=twist[:, free],
    )


def element_stiffness(section: Link, length: float) -> Array:
    """Return the stiffness matrix (12, 12) of an element: axial, St Venant torsion, and bending in two planes.

    It is the integral in Eq. (18) over the volume of the element.

    Args:
        section: uniform link section that contains the element.
        length: length of the element, m.
    """
    stiffness = np.zeros((2 * NODE_COORDINATES, 2 * NODE_COORDINATES))
    bar = np.array([[1.0, -1.0], [-1.0, 1.0]]) / length
    stiffness[np.ix_([0, 6], [0, 6])] = section.youngs_modulus * section.area * bar
    stiffness[np.ix_([3, 9], [3, 9])] = section.shear_modulus * section.torsion_constant * bar
    a, b, c, d = 12 / length**3, 6 / length**2, 4 / length, 2 / length
    bending = np.array([[a, b, -a, b], [b, c, -b, d], [-a, -b, a, -b], [b, d, -b, c]])
    stiffness[np.ix_([1, 5, 7, 11], [1, 5, 7, 11])] = section.youngs_modulus * section.second_moment_z * bending
    mirror = np.array([1.0, -1.0, 1.0, -1.0])  # theta_y = -w'
    stiffness[np.ix_([2, 4, 8, 10], [2, 4, 8, 10])] = (
        section.youngs_modulus * section.second_moment_y * bending * np.outer(mirror, mirror)
    )
    return stiffness


def inboard_masses(
    link: Link | NonUniformLink,
    elements: Sequence[Element],
    rotary_inertia: bool,
    stiffening: bool = True,
    position: float = np.inf,
) -> tuple[tuple[Array, Array, Array], tuple[Array, Array], tuple[Array, Array, Array]]:
    """Return mass points, polar inertias and stations of the part of a link inboard of a position.

    A lumped mass at the position belongs to the outboard part.

    Args:
        link: the link.
        elements: elements of the link, base to tip, with `size` node coordinates including the clamped node.
        rotary_inertia: see `ModelChoice`.
        stiffening: False leaves out the stations.
        position: distance from the joint along the link, m; by default the whole link is included.

    Returns:
        Masses (p,), positions (p, 3) and shapes (p, 3, size); polar inertias (t,) and twists (t, size); G (s, size,
            size), stations (s, 4) and shapes (s, 3, size); see `Beam`.
    """
    size, bodies = NODE_COORDINATES * (len(elements) + 1), [body for body in link.masses if body.position < position]
    points = _mass_points(elements, size, rotary_inertia, position)
    if bodies:
        points = _joined(points, _lumped_mass_points(bodies, elements, size))
    sections = _polar_inertias([] if rotary_inertia else elements, size, position)
    if not stiffening:
        return points, sections, (np.zeros((0, size, size)), np.zeros((0, 4)), np.zeros((0, 3, size)))
    stations = _beam_stations(elements, size)
    inside = stations[1][:, 1] <= position
    if not inside.all():
        stations = stations[0][inside], stations[1][inside], stations[2][inside]
    return points, sections, _joined(stations, _lumped_mass_stations(bodies, elements, size)) if bodies else stations


def _joined(first: tuple[Array, ...], second: tuple[Array, ...]) -> tuple[Array, Array, Array]:
    """Return three arrays: the rows of each array of the first triple, followed by rows of the second triple."""
    one, two, three = (np.concatenate(rows) for rows in zip(first, second, strict=True))
    return one, two, three


def _mass_points(
    elements: Sequence[Element], size: int, rotary_inertia: bool, limit: float
) -> tuple[Array, Array, Array]:
    """Return masses (p,), positions (p, 3) and shapes (p, 3, size) of the mass points inboard of a limit (m)."""
    abscissae, weights = np.polynomial.legendre.leggauss(GAUSS_POINTS)
    masses, positions, shapes = [], [], []
    for element in elements:
        section, start, length, nodes = element
        points = section_points(section) if rotary_inertia else np.zeros((1, 2))
        end = np.clip((limit - start) / length, 0.0, 1.0)
        for xi, weight in zip(end * (1 + abscissae) / 2, end * weights / 2, strict=True):
            for y, z in points:
                masses.append(weight * length * section.density * section.area / len(points))
                positions.append([start + xi * length, y, z])
                shape = np.zeros((3, size))
                shape[:, nodes] = element.shapes(xi, y, z)
                shapes.append(shape)
    return np.array(masses), np.array(positions), np.array(shapes)


def _polar_inertias(elements: Sequence[Element], size: int, limit: float) -> tuple[Array, Array]:
    """Return polar inertias (t,), kg m^2, and twists (t, size) at the Gauss points, integrated up to a limit (m)."""
    abscissae, weights = np.polynomial.legendre.leggauss(GAUSS_POINTS)
    count = len(elements) * GAUSS_POINTS
    polar, twist = np.zeros(count), np.zeros((count, size))
    for i, (section, start, length, nodes) in enumerate(elements):
        end = np.clip((limit - start) / length, 0.0, 1.0)
        rows = slice(GAUSS_POINTS * i, GAUSS_POINTS * (i + 1))
        polar_moment = section.second_moment_y + section.second_moment_z
        polar[rows] = end * weights / 2 * length * section.density * polar_moment
        _, _, _, inner, *_, outer, _, _ = range(nodes.start, nodes.stop)
        twist[rows, inner], twist[rows, outer] = (1 - end) + end * (1 - abscissae) / 2, end * (1 + abscissae) / 2
    return polar, twist

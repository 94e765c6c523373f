"""Finite-element beam of one link: mass points, lumped masses and foreshortening stations.

A link is a straight Euler-Bernoulli beam along its own x axis, clamped to the floating frame at x = 0. Its mass is
represented by mass points: each element has four Gauss points, and each Gauss point has four section points. They
integrate the polynomials of these elements exactly, so their sums equal the volume integrals of Eq. 13 and 14. Stations
are the points of the centreline that represent its foreshortening.

Without rotary inertia the mass points lie on the centreline. The cross-sections there resist rotation about the beam
axis only. In a frame with angular velocity w they turn about this axis at the rate w_x + phi'.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from flexman_gym.common.arrays import Array
from flexman_gym.model.element import (
    GAUSS_POINTS,
    NODE_COORDINATES,
    Element,
    beam_elements,
    beam_shapes,
    beam_slopes,
    beam_stiffness,
    find_element,
    section_points,
)
from flexman_gym.scene.link import Link, NonUniformLink
from flexman_gym.scene.rigid_body import LumpedMass

BLOCK = 2 * NODE_COORDINATES  # coordinates of an element
STATION_GROUP = 4  # the number of stations of a link, with its tip, is a multiple of this


def _beam_stations(elements: Sequence[Element], size: int) -> tuple[Array, Array, Array]:
    """Return G at each station, the stations and their shape functions; the first station is the tip.

    The s - 1 >= elements + 1 inner stations represent the polynomials nearest to the motion of the centreline. Each
    lies at a Gauss point of the mass distribution of the link. Its motion is the mean of the motion of the centreline,
    weighted with the Lagrange polynomial of this point, so that products of such polynomials are integrated exactly.
    The mass matrix minus the contribution of the stations is a sum of squares and therefore stays positive.

    G at a point is the integral of v'^T v' + w'^T w' from the base to the point, exact by Gauss quadrature of
    sufficient order.

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
    shares = np.concatenate([parts / 2 * length * each.density * each.area for each, _, length, _ in elements])
    places, masses = _gauss_rule(points, shares, count)
    means = iter((shares / masses[:, None] * _lagrange(places, points)).T)
    integral, shapes = np.zeros((size, size)), np.zeros((count + 1, 3, size))
    # G couples neighbouring nodes only, so one block per element is summed
    blocks, sums = _blocks(integral, len(elements)), np.zeros((count, len(elements), BLOCK, BLOCK))
    for i, (_, _, length, nodes) in enumerate(elements):
        before = integral[nodes, nodes].copy()
        for end in [*(1 + fine) / 2, 1.0]:
            shape = beam_shapes(end, length, 0.0, 0.0)
            integral[nodes, nodes] = before
            for xi, weight in zip(end * (1 + abscissae) / 2, end * weights / 2, strict=True):
                slopes = beam_slopes(xi, length)
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
    stations[1:, 0], stations[1:, 1] = masses, places
    return integrals, stations, shapes


def _blocks(matrix: Array, count: int) -> Array:
    """Return a view (count, 12, 12) of the diagonal blocks of a matrix that belong to the elements."""
    row, column = matrix.strides
    step = NODE_COORDINATES * (row + column)
    return np.lib.stride_tricks.as_strided(matrix, (count, BLOCK, BLOCK), (step, row, column), writeable=False)


def _gauss_rule(places: Array, masses: Array, count: int) -> tuple[Array, Array]:
    """Return points and weights (count,) of the Gauss rule of a distribution of point masses.

    The rule is exact to degree 2 count - 1.

    Args:
        places: positions of the point masses, m.
        masses: their masses, kg.
        count: number of points of the rule.
    """
    # by the three-term recurrence of the orthogonal polynomials (Golub and Welsch, Math. Comp. 23, 1969)
    diagonal, off_diagonal = np.zeros(count), np.zeros(count)
    before, now = np.zeros(len(places)), np.ones(len(places)) / np.sqrt(masses.sum())
    for i in range(count):
        diagonal[i] = masses @ (places * now**2)
        ahead = (places - diagonal[i]) * now - (off_diagonal[i - 1] if i else 0.0) * before
        off_diagonal[i] = np.sqrt(masses @ ahead**2)
        before, now = now, ahead / off_diagonal[i]
    # eigh reads the lower triangle only
    result, vectors = np.linalg.eigh(np.diag(diagonal) + np.diag(off_diagonal[:-1], -1))
    return result, masses.sum() * vectors[0] ** 2


def _lagrange(places: Array, points: Array) -> Array:
    """Return the Lagrange polynomials (s, p) of the nodes (s,), evaluated at the points (p,)."""
    others = ~np.eye(len(places), dtype=bool)
    return np.array(
        [
            np.prod((points[:, None] - places[other]) / (place - places[other]), axis=1)
            for place, other in zip(places, others, strict=True)
        ]
    )


def _lumped_mass_points(
    bodies: Sequence[LumpedMass], elements: Sequence[Element], size: int
) -> tuple[Array, Array, Array]:
    """Return masses (p,), positions (p, 3) and shapes (p, 3, size) of points that represent lumped bodies.

    The points have the mass and inertia of the bodies: six points of equal mass for a rigid body, two on each principal
    axis, and one point for a point mass.

    Args:
        bodies: lumped masses of the link.
        elements: elements of the link, base to tip.
        size: number of its node coordinates, including the clamped node.
    """
    masses, positions, shapes = [], [], []
    for each in bodies:
        points = _body_points(each)
        for point in points:
            masses.append(each.mass / len(points))
            positions.append([each.position + point[0], point[1], point[2]])
            shapes.append(_displacement(each, point, elements, size))
    return np.array(masses), np.array(positions), np.array(shapes)


def _lumped_mass_stations(
    bodies: Sequence[LumpedMass], elements: Sequence[Element], size: int
) -> tuple[Array, Array, Array]:
    """Return G (b, size, size), stations (b, 4) and shapes (b, 3, size) of the centres of mass of lumped bodies.

    Foreshortening moves a body back together with its cross-section. The arguments are those of `_lumped_mass_points`,
    the results those of `Beam`.
    """
    centres = [np.array(each.offset or np.zeros(3)) for each in bodies]
    stations = [[each.mass, each.position + at[0], at[1], at[2]] for each, at in zip(bodies, centres, strict=True)]
    shapes = [_displacement(each, at, elements, size) for each, at in zip(bodies, centres, strict=True)]
    return (
        np.array([foreshortening_matrix(each.position, elements, size) for each in bodies]),
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
    arms = (np.sqrt(3.0 * np.maximum(moments, 0.0) / body.mass) * axes).T
    return centre + np.vstack([arms, -arms])


def _displacement(body: LumpedMass, point: Array, elements: Sequence[Element], size: int) -> Array:
    """Return the displacement (3, size) of a point of a body: u + theta x r of its cross-section.

    Args:
        body: lumped mass.
        point: (3,) position relative to the beam axis, m.
        elements: elements of the link, base to tip.
        size: number of its node coordinates, including the clamped node.
    """
    element, xi = find_element(elements, body.position)
    turn = np.zeros((3, 2 * NODE_COORDINATES))
    turn[0, [3, 9]] = 1.0 - xi, xi
    slopes = beam_slopes(xi, element.length)
    turn[1], turn[2] = -slopes[1], slopes[0]  # theta_y = -w', theta_z = v'
    result = np.zeros((3, size))
    result[:, element.nodes] = beam_shapes(xi, element.length, 0.0, 0.0) + np.cross(turn.T, point).T
    return result


def foreshortening_matrix(position: float, elements: Sequence[Element], size: int) -> Array:
    """Return G (size, size), the integral of v'^T v' + w'^T w' from the base of a link to a position (m).

    Args:
        position: upper limit of the integral, m.
        elements: elements of the link, base to tip.
        size: number of its node coordinates, including the clamped node.
    """
    abscissae, weights = np.polynomial.legendre.leggauss(GAUSS_POINTS)
    result = np.zeros((size, size))
    for element in elements:
        end = np.clip((position - element.start) / element.length, 0.0, 1.0)
        for xi, weight in zip(end * (1 + abscissae) / 2, end * weights / 2, strict=True):
            slopes = beam_slopes(xi, element.length)
            result[element.nodes, element.nodes] += weight * element.length * slopes.T @ slopes
    return result


@dataclass(frozen=True)
class Beam:
    """Discretised link with k elastic coordinates in its beam frame; k = 0 for a rigid link.

    Attributes:
        masses: (p,) mass of each mass point, kg.
        positions: (p, 3) undeformed position of each mass point, m.
        shapes: (p, 3, k) displacement of each mass point per unit coordinate (S of Eq. 3).
        stiffness: (k, k) elastic stiffness (K of Eq. 18).
        tip_translation: (3, k) displacement of the tip section per unit coordinate (S^jt).
        tip_rotation: (3, k) rotation vector of the tip section per unit coordinate (S^jr).
        shortening: (s, k, k) matrix G of each station; the foreshortening of the centreline from 0 to the station is
            1/2 q^T G q.
        stations: (s, 4) mass (kg) and position along x, y and z (m) of each station; the first is the massless tip. The
            stations of lumped masses may lie off the centreline.
        station_shapes: (s, 3, k) displacement of the stations per unit coordinate.
        polar: (t,) inertia about the beam axis of sections without other rotary inertia, kg m^2; empty with rotary
            inertia, which the mass points represent.
        twist: (t, k) rotation of these sections about the beam axis per unit coordinate.
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
        """Elastic mass matrix (k, k), the sum of m S^T S over the mass points (lower right block of Eq. 13)."""
        spinning = (self.twist.T * self.polar) @ self.twist
        return np.einsum("p,pia,pib->ab", self.masses, self.shapes, self.shapes) + spinning

    def reduced(self, basis: Array) -> "Beam":
        """Return the same beam in reduced coordinates p with q = basis @ p.

        Args:
            basis: (k, m).
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


@dataclass(frozen=True)
class ShapeIntegrals:
    """Mass integrals of a beam with k elastic coordinates; r0 is the undeformed position, S_a the shape function a.

    Cross-sections that resist rotation about the beam axis only, with inertia j, enter as fictitious second moments of
    mass: these give the inertia j about x and none about y and z, and for the rate of coordinate a the inertia j_a
    about x.

    Attributes:
        mass: sum m, kg.
        first_moment: (3,) sum m r0.
        first_moment_shape: (k, 3) sum m S_a.
        second_moment: (3, 3) sum m r0 r0^T.
        position_shape: (k, 3, 3) sum m r0 S_a^T.
        shape_shape: (k, k, 3, 3) sum m S_b S_a^T; the first index is b.
        elastic: (k, k) sum m S_a . S_b.
    """

    mass: float
    first_moment: Array
    first_moment_shape: Array
    second_moment: Array
    position_shape: Array
    shape_shape: Array
    elastic: Array


def build_beam(link: Link | NonUniformLink, elements: int, flexible: bool = True, rotary_inertia: bool = True) -> Beam:
    """Assemble a link from equal elements in each section, with node 0 clamped to the floating frame.

    The coordinates are ordered node by node from the first free node to the tip.

    Args:
        link: the link.
        elements: number of elements in each section; k = 6 * elements * number of sections.
        flexible: False makes the link rigid, with k = 0.
        rotary_inertia: False makes the cross-sections resist rotation about the beam axis only; lumped masses keep
            their inertia.
    """
    pieces = beam_elements(link, elements)
    size = NODE_COORDINATES * (len(pieces) + 1)
    stiffness = np.zeros((size, size))
    for piece in pieces:
        stiffness[piece.nodes, piece.nodes] += beam_stiffness(piece.section, piece.length)
    (masses, positions, shapes), (polar, twist) = link_points(link, pieces, rotary_inertia)
    shortening, centres, station_shapes = link_stations(link, pieces)
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
        stations=centres,
        station_shapes=station_shapes[:, :, kept],
        polar=polar,
        twist=twist[:, kept],
    )


def link_points(
    link: Link | NonUniformLink, elements: Sequence[Element], rotary_inertia: bool, until: float = np.inf
) -> tuple[tuple[Array, Array, Array], tuple[Array, Array]]:
    """Return the mass points and polar inertias of the part of a link inboard of a position; a body there is excluded.

    Args:
        link: the link.
        elements: its elements, base to tip, with `size` node coordinates including the clamped node.
        rotary_inertia: see `build_beam`.
        until: the position, m.

    Returns:
        Masses (p,), positions (p, 3) and shapes (p, 3, size); polar inertias (t,) and twists (t, size).
    """
    size, bodies = NODE_COORDINATES * (len(elements) + 1), [body for body in link.masses if body.position < until]
    points = _mass_points(elements, size, rotary_inertia, until)
    if bodies:
        points = _joined(points, _lumped_mass_points(bodies, elements, size))
    return points, _polar_inertias([] if rotary_inertia else elements, size, until)


def link_stations(
    link: Link | NonUniformLink, elements: Sequence[Element], until: float = np.inf
) -> tuple[Array, Array, Array]:
    """Return G (s, size, size), stations (s, 4) and shapes (s, 3, size) of the part of a link inboard of a position.

    The arguments are those of `link_points`, the results those of `Beam`, including the centres of mass of its bodies.

    Args:
        link: the link.
        elements: its elements, base to tip.
        until: the position, m.
    """
    size, bodies = NODE_COORDINATES * (len(elements) + 1), [body for body in link.masses if body.position < until]
    stations = _beam_stations(elements, size)
    inside = stations[1][:, 1] <= until
    if not inside.all():
        stations = stations[0][inside], stations[1][inside], stations[2][inside]
    return _joined(stations, _lumped_mass_stations(bodies, elements, size)) if bodies else stations


def _joined(first: tuple[Array, ...], second: tuple[Array, ...]) -> tuple[Array, Array, Array]:
    """Return three arrays with the rows of the first triple followed by those of the second."""
    one, two, three = (np.concatenate(rows) for rows in zip(first, second, strict=True))
    return one, two, three


def _mass_points(
    elements: Sequence[Element], size: int, rotary_inertia: bool, until: float = np.inf
) -> tuple[Array, Array, Array]:
    """Return masses (p,), positions (p, 3) and shapes (p, 3, size) of the mass points inboard of a position (m)."""
    abscissae, weights = np.polynomial.legendre.leggauss(GAUSS_POINTS)
    masses, positions, shapes = [], [], []
    for section, start, length, nodes in elements:
        points = section_points(section) if rotary_inertia else np.zeros((1, 2))
        end = np.clip((until - start) / length, 0.0, 1.0)
        for xi, weight in zip(end * (1 + abscissae) / 2, end * weights / 2, strict=True):
            for y, z in points:
                masses.append(weight * length * section.density * section.area / len(points))
                positions.append([start + xi * length, y, z])
                shape = np.zeros((3, size))
                shape[:, nodes] = beam_shapes(xi, length, y, z)
                shapes.append(shape)
    return np.array(masses), np.array(positions), np.array(shapes)


def _polar_inertias(elements: Sequence[Element], size: int, until: float = np.inf) -> tuple[Array, Array]:
    """Return polar inertias (t,) in kg m^2 and twists (t, size) of sections at Gauss points up to a position (m)."""
    abscissae, weights = np.polynomial.legendre.leggauss(GAUSS_POINTS)
    count = len(elements) * GAUSS_POINTS
    polar, twist = np.zeros(count), np.zeros((count, size))
    for i, (section, start, length, nodes) in enumerate(elements):
        end = np.clip((until - start) / length, 0.0, 1.0)
        rows = slice(GAUSS_POINTS * i, GAUSS_POINTS * (i + 1))
        area = section.second_moment_y + section.second_moment_z
        polar[rows] = end * weights / 2 * length * section.density * area
        _, _, _, inner, *_, outer, _, _ = range(nodes.start, nodes.stop)
        twist[rows, inner], twist[rows, outer] = (1 - end) + end * (1 - abscissae) / 2, end * (1 + abscissae) / 2
    return polar, twist


def shape_integrals(beam: Beam) -> ShapeIntegrals:
    """Return the constant integrals of the mass matrix and the quadratic velocity terms at any state (Eq. 13, 14)."""
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

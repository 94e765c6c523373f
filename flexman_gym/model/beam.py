"""Beam: the finite elements of one link and the integrals that its dynamics needs.

A link is a straight Euler-Bernoulli beam along its own x axis, clamped to the floating frame at x = 0. Mass points
represent its mass: an element has four Gauss points, and each Gauss point has four section points. They integrate the
polynomials of these elements exactly, so the sums below equal the volume integrals of Eq. 13 and 14.

Without rotary inertia the mass points lie on the centreline. The sections around them then resist rotation about the
beam axis only. In a frame with angular velocity w they turn about this axis at the rate w_x + phi'.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from flexman_gym.arrays import Array
from flexman_gym.model.bodies import body_points, body_stations
from flexman_gym.model.element import (
    GAUSS_POINTS,
    NODE_COORDINATES,
    Element,
    beam_elements,
    beam_shapes,
    beam_stiffness,
    section_points,
)
from flexman_gym.model.stations import beam_stations
from flexman_gym.scene.link import Link, NonUniformLink


@dataclass(frozen=True)
class Beam:
    """A discretised link with k elastic coordinates in the beam frame of the link; k = 0 for a rigid link.

    Attributes:
        masses: (p,) mass of each mass point, kg.
        positions: (p, 3) undeformed position of each mass point, m.
        shapes: (p, 3, k) displacement of each mass point per unit coordinate (S of Eq. 3).
        stiffness: (k, k) elastic stiffness (K of Eq. 18).
        tip_translation, tip_rotation: (3, k) displacement and rotation vector of the tip section per unit coordinate
            (S^jt, S^jr).
        shortening: (s, k, k) G at each station; the foreshortening of the centreline from 0 to the station is 1/2 q^T G
            q.
        stations: (s, 4) mass (kg) and place along x, y and z (m) of each station; the first is the tip, without mass.
            Those of lumped masses may lie beside the centreline.
        station_shapes: (s, 3, k) displacement of the stations per unit coordinate.
        polar: (t,) inertia about the beam axis of sections that resist no other rotation, kg m^2; empty with rotary
            inertia, which the mass points hold.
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
        """Gives the same beam in the coordinates p with q = basis @ p.

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
    """Mass integrals of a beam with k elastic coordinates; r0 is the undeformed position, S_a is shape vector a.

    Some sections resist rotation about the beam axis alone, with the inertia j. They enter as fictitious second moments
    of mass that give this inertia about x and none about y and z. For the rate of coordinate a they give the inertia
    j_a about x.

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
    """Assembles a link from equal elements in each section, with node 0 clamped to the floating frame.

    The coordinates are ordered node by node from the first free node to the tip.

    Args:
        link: the link.
        elements: in each section of the link; k = 6 * elements * number of sections.
        flexible: False makes the link rigid, with k = 0.
        rotary_inertia: False lets the sections resist rotation about the beam axis only; lumped masses keep their
            inertia.
    """
    pieces = beam_elements(link, elements)
    size = NODE_COORDINATES * (len(pieces) + 1)
    stiffness = np.zeros((size, size))
    for piece in pieces:
        stiffness[piece.nodes, piece.nodes] += beam_stiffness(piece.section, piece.length)
    points, stations = mass_points(pieces, size, rotary_inertia), beam_stations(pieces, size)
    if link.masses:
        points = _joined(points, body_points(link.masses, pieces, size))
        stations = _joined(stations, body_stations(link.masses, pieces, size))
    (masses, positions, shapes), (shortening, centres, station_shapes) = points, stations
    polar, twist = spinning_sections([] if rotary_inertia else pieces, size)
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


def _joined(first: tuple[Array, ...], second: tuple[Array, ...]) -> tuple[Array, Array, Array]:
    """Gives three arrays with the rows of the first and then those of the second."""
    one, two, three = (np.concatenate(rows) for rows in zip(first, second, strict=True))
    return one, two, three


def mass_points(
    elements: Sequence[Element], size: int, rotary_inertia: bool, until: float = np.inf
) -> tuple[Array, Array, Array]:
    """Gives masses (p,), positions (p, 3) and shapes (p, 3, size) of the mass points of a link up to a position (m)."""
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


def spinning_sections(elements: Sequence[Element], size: int, until: float = np.inf) -> tuple[Array, Array]:
    """Gives polar inertias (t,) in kg m^2 and twists (t, size) of sections at Gauss points up to a position (m)."""
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
    """Gives the constant integrals of mass matrix and quadratic velocity terms at any state (Eq. 13, 14)."""
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

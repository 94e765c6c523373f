"""Deformation of the links in a state: curvature, strain, strains at the roots, and centrelines."""

from functools import lru_cache
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from flexman_gym.common.arrays import Array, Vector
from flexman_gym.common.checks import finite, non_negative, number_array, vector, whole_number
from flexman_gym.common.errors import value_error
from flexman_gym.model.element import NODE_COORDINATES, Element
from flexman_gym.model.model import Model, check_model


def curvature(model: Model, state: Vector, link: int, position: float) -> Array:
    """Return torsion phi', curvature -w'' about y and curvature v'' about z (3,), rad/m, of a link in its beam frame.

    They are computed from derivatives of the shape functions: torsion is constant and curvature linear along each
    element, which is exact for static loads at the nodes. A rigid link has zero curvature.

    Args:
        model: model of the arm.
        state: (2 d,) coordinates and speeds.
        link: index of the link, from 0.
        position: distance from the joint along the link, m, at most its length. At a node between two elements (and
            thus between two sections) the outboard element is used.

    Examples:
        >>> model = fm.build_model(fm.catalog.one_joint())
        >>> fm.curvature(model, fm.rest_state(model, [0.0]), link=0, position=0.4)
        array([0., 0., 0.])
    """
    return _deformation(model, state, link, position)[1:]


def strain(model: Model, state: Vector, link: int, position: float, y: float = 0.0, z: float = 0.0) -> float:
    """Return the axial strain u' - y v'' - z w'', 1, at a point of a cross-section, as measured by a strain gauge.

    It is the first component of Eq. (16), see `model.beam`. Foreshortening causes no strain, because it preserves the
    length of the centreline.

    Args:
        model: model of the arm.
        state: (2 d,) coordinates and speeds.
        link: index of the link, from 0.
        position: distance along the link from its joint, m; see `curvature`.
        y: coordinate of the point in the cross-section, m.
        z: coordinate of the point in the cross-section, m.

    Examples:
        >>> model = fm.build_model(fm.catalog.one_joint())
        >>> fm.strain(model, fm.rest_state(model, [0.0]), link=0, position=0.0, y=0.001)
        0.0
    """
    stretch, _, about_y, about_z = _deformation(model, state, link, position)
    return float(stretch - finite("y", y, "m") * about_z + finite("z", z, "m") * about_y)


def gauge_radii(model: Model) -> Array:
    """Return the distances r_y, r_z and r (n, 3), m, of the strain gauges at the roots of the links from the beam axes.

    The bending strains are measured at y = +-r_y and z = +-r_z, the torsional strain at r. The distances are the radii
    of gyration of the root cross-section: sqrt(I_z / A), sqrt(I_y / A) and sqrt((I_y + I_z) / A).

    Args:
        model: model of the arm.
    """
    roots = [link.sections[0] for link in model.arm.links]
    along = np.array([[root.second_moment_z / root.area, root.second_moment_y / root.area] for root in roots])
    return np.sqrt(np.column_stack([along, along.sum(axis=1)]))


def root_strain_matrix(model: Model) -> Array:
    """Return the matrix (2 d, 3 n) by which a state (2 d,) is multiplied for the strains (3 n,) at the link roots.

    The strains of a link are half the difference of the axial strains at y = r_y and y = -r_y, half the difference of
    those at z = r_z and z = -r_z (bridges of two gauges on opposite sides), and the shear strain r phi' of torsion,
    with the distances of `gauge_radii`. Rigid links have zero strain.

    Args:
        model: model of the arm.
    """
    result = np.zeros((2 * model.n_dof, 3 * model.n_joints))
    for i, radii in enumerate(gauge_radii(model)):
        if model.bases[i].shape[1] == 0:
            continue
        root = model.elements(i)[0]
        _, twist, about_y, about_z = _element_strains(0.0, root.length) @ model.node_basis(i)[root.nodes]
        rows = radii[:, None] * np.array([-about_z, about_y, twist])
        result[model.elastic_columns(i), 3 * i : 3 * i + 3] = rows.T
    return result


def _deformation(model: Model, state: Vector, link: int, position: float) -> Array:
    """Return u', phi', -w'' and v'' (4,) at a position (m) along a link."""
    x = np.array(vector("state", state, 2 * check_model(model).n_dof))
    i = whole_number("link", link, 0, model.n_joints - 1)
    length, basis = model.arm.links[i].length, model.bases[i]
    place = finite("position", position, "m")
    if not 0.0 <= place <= length:
        raise value_error("position", position, f"a number from 0 to {length} (m), the length of link {i}")
    if basis.shape[1] == 0:
        return np.zeros(4)
    nodes = np.append(np.zeros(NODE_COORDINATES), basis @ x[model.elastic_columns(i)])
    element, xi = Element.find(model.elements(i), place)
    return _element_strains(xi, element.length) @ nodes[element.nodes]


def _element_strains(xi: float, length: float) -> Array:
    """Return u', phi', theta_y' = -w'' and theta_z' = v'' (4, 12) of an element per unit of its node coordinates."""
    u, v, w, phi, theta_y, theta_z = range(NODE_COORDINATES)
    rows = np.zeros((4, 2, NODE_COORDINATES))
    rows[0, :, u] = rows[1, :, phi] = np.array([-1.0, 1.0]) / length
    deflection = np.array([12 * xi - 6, 6 - 12 * xi]) / length**2
    slope = np.array([6 * xi - 4, 6 * xi - 2]) / length
    rows[3, :, v], rows[3, :, theta_z] = deflection, slope
    rows[2, :, w], rows[2, :, theta_y] = -deflection, slope  # theta_y = -w'
    return rows.reshape(4, -1)


MAX_POINTS = 1000  # largest number of points on each link
SLOPE_GAUSS_POINTS = 3  # number of Gauss points per interval; exact for the squares of quadratic slopes
DISPLACEMENT, ROTATION, STRAIN = slice(0, 3), slice(3, 6), slice(6, 10)  # rows of `_LinkShapes.rows`


class Curves(NamedTuple):
    """Centrelines of n links at P points each, from joint to tip; `...` are the leading axes of the states.

    Attributes:
        positions: (..., n, P, 3) in the base frame, m.
        frames: (..., n, P, 3, 3) rotation matrices; their columns are the axes of the cross-sections in the base frame.
        curvatures: (..., n, P, 3) torsion phi' and curvatures -w'' and v'', rad/m, see `curvature`.
        strains: (..., n, P, 4) axial strain u' of the centreline, bending strains -r_y v'' and -r_z w'', and shear
            strain r phi' of torsion, 1. The distances r_y, r_z and r are the radii of gyration of the cross-section,
            see `gauge_radii`.
    """

    positions: Array
    frames: Array
    curvatures: Array
    strains: Array


class _LinkShapes(NamedTuple):
    """Shape functions of a link with k elastic coordinates at P points of its centreline.

    Attributes:
        rows: (P, 10, k) u, v, w, then the rotations phi, -w', v', then u', phi', -w'', v'' per unit coordinate.
        slopes: (g, 2, k) v' and w' at Gauss points per unit coordinate, times the square root of half the quadrature
            weight; the foreshortening at a point is the sum of their squares over all inboard Gauss points.
        inboard: (P,) number of Gauss points inboard of each point.
        radii: (P, 3) radii of gyration sqrt(I_z / A), sqrt(I_y / A) and sqrt((I_y + I_z) / A), m.
    """

    rows: Array
    slopes: Array
    inboard: np.ndarray
    radii: Array


def curves(model: Model, states: Vector, points: int, gain: float = 1.0, joint_gain: float | None = None) -> Curves:
    """Return the centrelines of all links at equally spaced points, for any number of states.

    A point of a link is at R + A (u + S q), Eqs. (1) and (2), see `model.beam`, with the origin R and the rotation A of
    the beam frame. A cross-section is rotated relative to this frame by the rotation vector (phi, -w', v'), as the tip
    in Eq. (26). Foreshortening displaces a point by the exact integral of (v'^2 + w'^2) / 2. The last point is the tip
    of the link.

    Args:
        model: model of the arm.
        states: (..., 2 d) coordinates and speeds.
        points: number P of points on each link, from 2 to 1000.
        gain: magnification, 1, of the elastic displacements and rotations of the links in positions and frames, at
            least 0; curvatures and strains are not magnified.
        joint_gain: magnification, 1, of the joint twists (elastic deflections of the joints: motor angles minus
            link-side angles), at least 0; None for that of the links.

    Examples:
        >>> model = fm.build_model(fm.catalog.one_joint())
        >>> shape = fm.curves(model, fm.rest_state(model, [0.0]), points=5)
        >>> shape.positions.shape, shape.positions[0, -1].round(3)
        ((1, 5, 3), array([0.8, 0. , 0. ]))
    """
    d = check_model(model).n_dof
    shape = (*np.shape(states)[:-1], 2 * d)
    x = number_array("states", states, shape, f"numbers (..., {2 * d}), 2 d for each state").reshape(-1, 2 * d)
    count, gain = whole_number("points", points, 2, MAX_POINTS), non_negative("gain", gain)
    twist_gain = gain if joint_gain is None else non_negative("joint_gain", joint_gain)
    constants, n = model.constants, model.n_joints
    mounts = constants.mount.reshape(n, 3, 3)
    positions, frames = np.zeros((len(x), n, count, 3)), np.zeros((len(x), n, count, 3, 3))
    strain_rows, radii = np.zeros((len(x), n, count, 4)), np.zeros((n, count, 3))
    rotation, origin = np.broadcast_to(np.eye(3), (len(x), 3, 3)), np.zeros((len(x), 3))
    for i, link in enumerate(link_shapes(model, count)):
        motor = x[:, model.motor_columns[i]]
        angle = motor + twist_gain * (x[:, i] - motor)
        rotation = rotation @ mounts[i] @ _rotation_matrices(angle[:, None] * constants.axis[i])
        elastic = x[:, model.elastic_columns(i)]
        deformation = np.einsum("pck,tk->tpc", link.rows, elastic)
        local = gain * deformation[..., DISPLACEMENT]
        local[..., 0] += np.linspace(0.0, constants.length[i], count)
        local[..., 0] -= gain**2 * _foreshortening(link, elastic)
        positions[:, i] = origin[:, None] + np.einsum("tab,tpb->tpa", rotation, local)
        frames[:, i] = rotation[:, None] @ _rotation_matrices(gain * deformation[..., ROTATION])
        strain_rows[:, i], radii[i] = deformation[..., STRAIN], link.radii
        rotation, origin = frames[:, i, -1], positions[:, i, -1]
    factors = np.concatenate([np.ones((n, count, 1)), radii * (-1.0, 1.0, 1.0)], axis=-1)
    strains = strain_rows[..., [0, 3, 2, 1]] * factors
    result = positions, frames, strain_rows[..., 1:], strains
    return Curves(*(each.reshape(*shape[:-1], *each.shape[1:]) for each in result))


@lru_cache(maxsize=16)
def link_shapes(model: Model, points: int) -> tuple[_LinkShapes, ...]:
    """Return the shape functions of all links at equally spaced points.

    Args:
        model: model of the arm.
        points: number of points on each link.
    """
    return tuple(_shapes(model, i, points) for i in range(model.n_joints))


def _shapes(model: Model, link: int, points: int) -> _LinkShapes:
    """Return the shape functions of one link at equally spaced points."""
    elements, nodes = model.elements(link), model.node_basis(link)
    positions, k = np.linspace(0.0, model.constants.length[link], points), nodes.shape[1]
    rows, radii = np.zeros((points, 10, k)), np.zeros((points, 3))
    for row, radius, place in zip(rows, radii, positions, strict=True):
        element, xi = Element.find(elements, place)
        section = element.section
        moments = np.array([section.second_moment_z, section.second_moment_y])
        radius[:] = np.sqrt(np.append(moments, moments.sum()) / section.area)
        if k:
            basis = nodes[element.nodes]
            slope_v, slope_w = element.slopes(xi) @ basis
            row[DISPLACEMENT] = element.shapes(xi) @ basis
            row[ROTATION] = (1.0 - xi) * basis[3] + xi * basis[3 + NODE_COORDINATES], -slope_w, slope_v
            row[STRAIN] = _element_strains(xi, element.length) @ basis
    if not (k and model.choice.stiffening):
        return _LinkShapes(rows, np.zeros((0, 2, k)), np.zeros(points, dtype=int), radii)
    ends = np.unique(np.append(positions, [element.start for element in elements]))  # ends of the quadrature intervals
    abscissae, weights = np.polynomial.legendre.leggauss(SLOPE_GAUSS_POINTS)
    slopes = []
    for first, last in pairwise(ends):
        element, _ = Element.find(elements, (first + last) / 2)
        for at, weight in zip(abscissae, weights, strict=True):
            xi = (first + (1.0 + at) / 2 * (last - first) - element.start) / element.length
            root = np.sqrt(weight / 4 * (last - first))  # with a factor 1/2 of the integrand and 1/2 of the interval
            slopes.append(root * element.slopes(xi) @ nodes[element.nodes])
    return _LinkShapes(rows, np.array(slopes), SLOPE_GAUSS_POINTS * np.searchsorted(ends, positions), radii)


def _foreshortening(link: _LinkShapes, elastic: Array) -> Array:
    """Return the foreshortening (T, P) in m at the points of a link for elastic coordinates (T, k)."""
    squares = (np.einsum("gck,tk->tgc", link.slopes, elastic) ** 2).sum(axis=2)
    return np.cumsum(np.insert(squares, 0, 0.0, axis=1), axis=1)[:, link.inboard]


def _rotation_matrices(vectors: Array) -> Array:
    """Return the rotation matrices (..., 3, 3) of rotation vectors (..., 3)."""
    angle = np.sqrt((vectors**2).sum(axis=-1))[..., None, None]
    cross = np.zeros((*vectors.shape, 3))
    cross[..., 2, 1], cross[..., 0, 2], cross[..., 1, 0] = vectors[..., 0], vectors[..., 1], vectors[..., 2]
    cross = cross - np.swapaxes(cross, -1, -2)
    half = np.sinc(angle / (2 * np.pi))
    return np.eye(3) + np.sinc(angle / np.pi) * cross + half**2 / 2 * (cross @ cross)

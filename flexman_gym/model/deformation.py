"""Deformation of the links: curvature, strain and strain gauges at a place, and the centreline curves of a state."""

from functools import lru_cache
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from flexman_gym.common.arrays import Array, Vector
from flexman_gym.common.checks import finite, non_negative, number_array, value_error, vector, whole_number
from flexman_gym.model.element import NODE_COORDINATES, beam_shapes, beam_slopes, find_element
from flexman_gym.model.model import Model, check_model


def curvature(model: Model, state: Vector, link: int, position: float) -> Array:
    """Gives twist rate phi', curvature about y, -w'', and about z, v'', of a link, (3,) rad/m, in its beam frame.

    They are derivatives of the finite elements, linear along each element and exact under forces and moments at nodes.
    A rigid link has none.

    Args:
        model: the model.
        state: (2 d,).
        link: counted from 0.
        position: along the link, from 0 at its joint to its length at its tip, m. At a node between two elements, and
            so between two sections, the outboard element is taken.

    Raises:
        ValueError: for wrong shapes, values that are not finite, and a link or position that does not exist.
    """
    return _deformation(model, state, link, position)[1:]


def strain(model: Model, state: Vector, link: int, position: float, y: float = 0.0, z: float = 0.0) -> float:
    """Gives the axial strain u' - y v'' - z w'' at a point of a link's section, as a strain gauge there measures it.

    Foreshortening is no strain: the centreline keeps its length.

    Args:
        model: as in `curvature`.
        state: as in `curvature`.
        link: as in `curvature`.
        position: as in `curvature`.
        y: place in the section along y, m.
        z: place in the section along z, m.

    Raises:
        ValueError: as in `curvature`.
    """
    stretch, _, about_y, about_z = _deformation(model, state, link, position)
    return float(stretch - finite("y", y, "m") * about_z + finite("z", z, "m") * about_y)


def gauge_radii(model: Model) -> Array:
    """Gives how far from the axis the gauges at the root of each link are, (n, 3) m, along y, along z and around.

    They are radii of gyration of the section there: sqrt(I_z / A), sqrt(I_y / A) and sqrt((I_y + I_z) / A).

    Args:
        model: the model.
    """
    roots = [link.sections[0] for link in model.arm.links]
    along = np.array([[root.second_moment_z / root.area, root.second_moment_y / root.area] for root in roots])
    return np.sqrt(np.column_stack([along, along.sum(axis=1)]))


def root_strain_matrix(model: Model) -> Array:
    """Gives what strain gauges at the roots of all links read, (2 d, 3 n) per unit of a state.

    Three numbers of each link, at distances r of `gauge_radii`: half the difference of the axial strains at y = +-r,
    then at z = +-r, as a bridge of two gauges on opposite sides gives it; then the shear strain r phi' of the torsion.
    Rigid links read zero.

    Args:
        model: the model.
    """
    result = np.zeros((2 * model.n_dof, 3 * model.n_joints))
    for i, radii in enumerate(gauge_radii(model)):
        basis = model.bases[i]
        if basis.shape[1] == 0:
            continue
        root = model.elements(i)[0]
        nodes = np.vstack([np.zeros((NODE_COORDINATES, basis.shape[1])), basis])[root.nodes]
        _, twist, about_y, about_z = _element_strains(0.0, root.length) @ nodes
        rows = radii[:, None] * np.array([-about_z, about_y, twist])
        result[model.elastic_columns(i), 3 * i : 3 * i + 3] = rows.T
    return result


def _deformation(model: Model, state: Vector, link: int, position: float) -> Array:
    """Gives u', phi', -w'' and v'' (4,) at a position of a link."""
    x = np.array(vector("state", state, 2 * check_model(model).n_dof))
    i = whole_number("link", link, 0, model.n_joints - 1)
    length, basis = model.arm.links[i].length, model.bases[i]
    place = finite("position", position, "m")
    if not 0.0 <= place <= length:
        raise value_error("position", position, f"a number from 0 to {length} (m), the length of link {i}")
    if basis.shape[1] == 0:
        return np.zeros(4)
    nodes = np.append(np.zeros(NODE_COORDINATES), basis @ x[model.elastic_columns(i)])
    element, xi = find_element(model.elements(i), place)
    return _element_strains(xi, element.length) @ nodes[element.nodes]


def _element_strains(xi: float, length: float) -> Array:
    """Gives u', phi', theta_y' = -w'' and theta_z' = v'' (4, 12) of an element per unit of its node coordinates."""
    u, v, w, phi, theta_y, theta_z = range(NODE_COORDINATES)
    rows = np.zeros((4, 2, NODE_COORDINATES))
    rows[0, :, u] = rows[1, :, phi] = np.array([-1.0, 1.0]) / length
    deflection = np.array([12 * xi - 6, 6 - 12 * xi]) / length**2
    slope = np.array([6 * xi - 4, 6 * xi - 2]) / length
    rows[3, :, v], rows[3, :, theta_z] = deflection, slope
    rows[2, :, w], rows[2, :, theta_y] = -deflection, slope  # theta_y = -w'
    return rows.reshape(4, -1)


MAX_POINTS = 1000
SLOPE_GAUSS_POINTS = 3  # Gauss points between two breaks, exact for the squares of quadratic slopes
PLACE, TURN, STRAIN = slice(0, 3), slice(3, 6), slice(6, 10)  # rows of the shapes of a link


class Curves(NamedTuple):
    """Centrelines of n links at P places each, from joint to tip; `...` are the axes of the states in front.

    Attributes:
        positions: (..., n, P, 3) in the base frame, m.
        frames: (..., n, P, 3, 3) rotations whose columns are the axes of the sections in the base frame.
        curvatures: (..., n, P, 3) twist rate phi', -w'' and v'', rad/m, as `curvature` gives them.
        strains: (..., n, P, 4) stretch u' of the centreline; strain of bending at y = r_y and at z = r_z; shear strain
            of torsion at r. The distances are the radii of gyration of the section there, see `gauge_radii`.
    """

    positions: Array
    frames: Array
    curvatures: Array
    strains: Array


class _LinkShapes(NamedTuple):
    """What the curve of a link with k elastic coordinates is made of, at P places.

    Attributes:
        rows: (P, 10, k) u, v, w, then the rotations phi, -w', v', then u', phi', -w'', v'' per unit coordinate.
        slopes: (g, 2, k) v' and w' at Gauss points, each times the root of half its weight; foreshortening at a place
            is the sum of their squares up to there.
        before: (P,) number of Gauss points up to each place.
        radii: (P, 3) m, of gyration along y, along z and around.
    """

    rows: Array
    slopes: Array
    before: np.ndarray
    radii: Array


def curves(model: Model, states: Vector, points: int, gain: float = 1.0) -> Curves:
    """Gives the curves of all links at equally spaced places, for many states at once.

    A section is turned by exp(phi, -w', v') against the beam frame of its link, as the tip of the link is (Eq. 26).
    With foreshortening a place moves back by half the integral of its squared slopes, exactly. The last place is the
    tip of the link.

    Args:
        model: the model.
        states: (..., 2 d).
        points: places P on each link, from 2 to 1000.
        gain: by which elastic motion and the wind-up of joint springs are multiplied in positions and frames.
            Curvatures and strains stay what they are.

    Raises:
        ValueError: for wrong shapes, values that are not finite, too few points and a gain < 0.

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
    constants, n = model.constants, model.n_joints
    mounts = constants.mount.reshape(n, 3, 3)
    places, frames = np.zeros((len(x), n, count, 3)), np.zeros((len(x), n, count, 3, 3))
    deformed, radii = np.zeros((len(x), n, count, 4)), np.zeros((n, count, 3))
    turned, origin = np.broadcast_to(np.eye(3), (len(x), 3, 3)), np.zeros((len(x), 3))
    for i, link in enumerate(link_shapes(model, count)):
        motor = x[:, model.motor_columns[i]]
        angle = motor + gain * (x[:, i] - motor)
        turned = turned @ mounts[i] @ rotation_matrices(angle[:, None] * constants.axis[i])
        elastic = x[:, model.elastic_columns(i)]
        moved = np.einsum("pck,tk->tpc", link.rows, elastic)
        local = gain * moved[..., PLACE]
        local[..., 0] += np.linspace(0.0, constants.length[i], count)
        local[..., 0] -= gain**2 * _foreshortening(link, elastic)
        places[:, i] = origin[:, None] + np.einsum("tab,tpb->tpa", turned, local)
        frames[:, i] = turned[:, None] @ rotation_matrices(gain * moved[..., TURN])
        deformed[:, i], radii[i] = moved[..., STRAIN], link.radii
        turned, origin = frames[:, i, -1], places[:, i, -1]
    strains = deformed[..., [0, 3, 2, 1]] * np.concatenate([np.ones((n, count, 1)), radii * (-1.0, 1.0, 1.0)], axis=-1)
    result = places, frames, deformed[..., 1:], strains
    return Curves(*(each.reshape(*shape[:-1], *each.shape[1:]) for each in result))


@lru_cache(maxsize=16)
def link_shapes(model: Model, points: int) -> tuple[_LinkShapes, ...]:
    """Gives the shapes of all links at equally spaced places.

    Args:
        model: the model.
        points: places on each link.
    """
    return tuple(_shapes(model, i, points) for i in range(model.n_joints))


def _shapes(model: Model, link: int, points: int) -> _LinkShapes:
    length, basis, elements = model.constants.length[link], model.bases[link], model.elements(link)
    nodes = np.vstack([np.zeros((NODE_COORDINATES if basis.size else 0, basis.shape[1])), basis])
    places, k = np.linspace(0.0, length, points), basis.shape[1]
    rows, radii = np.zeros((points, 10, k)), np.zeros((points, 3))
    for row, radius, place in zip(rows, radii, places, strict=True):
        element, xi = find_element(elements, place)
        section = element.section
        moments = np.array([section.second_moment_z, section.second_moment_y])
        radius[:] = np.sqrt(np.append(moments, moments.sum()) / section.area)
        if k:
            own = nodes[element.nodes]
            across, up = beam_slopes(xi, element.length) @ own
            row[PLACE] = beam_shapes(xi, element.length, 0.0, 0.0) @ own
            row[TURN] = (1.0 - xi) * own[3] + xi * own[3 + NODE_COORDINATES], -up, across
            row[STRAIN] = _element_strains(xi, element.length) @ own
    if not (k and model.choice.stiffening):
        return _LinkShapes(rows, np.zeros((0, 2, k)), np.zeros(points, dtype=int), radii)
    breaks = np.unique(np.append(places, [each.start for each in elements]))
    abscissae, weights = np.polynomial.legendre.leggauss(SLOPE_GAUSS_POINTS)
    slopes = []
    for first, last in pairwise(breaks):
        element, _ = find_element(elements, (first + last) / 2)
        for at, weight in zip(abscissae, weights, strict=True):
            xi = (first + (1.0 + at) / 2 * (last - first) - element.start) / element.length
            part = np.sqrt(weight / 4 * (last - first))  # half of the integrand, and the weight of half an interval
            slopes.append(part * beam_slopes(xi, element.length) @ nodes[element.nodes])
    return _LinkShapes(rows, np.array(slopes), SLOPE_GAUSS_POINTS * np.searchsorted(breaks, places), radii)


def _foreshortening(link: _LinkShapes, elastic: Array) -> Array:
    """Gives by how much the places of a link have moved back, (T, P) m, at elastic coordinates (T, k)."""
    squares = (np.einsum("gck,tk->tgc", link.slopes, elastic) ** 2).sum(axis=2)
    return np.cumsum(np.insert(squares, 0, 0.0, axis=1), axis=1)[:, link.before]


def rotation_matrices(vectors: Array) -> Array:
    """Gives rotation matrices (..., 3, 3) of rotation vectors (..., 3)."""
    angle = np.sqrt((vectors**2).sum(axis=-1))[..., None, None]
    cross = np.zeros((*vectors.shape, 3))
    cross[..., 2, 1], cross[..., 0, 2], cross[..., 1, 0] = vectors[..., 0], vectors[..., 1], vectors[..., 2]
    cross = cross - np.swapaxes(cross, -1, -2)
    half = np.sinc(angle / (2 * np.pi))
    return np.eye(3) + np.sinc(angle / np.pi) * cross + half**2 / 2 * (cross @ cross)

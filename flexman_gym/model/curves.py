"""Curves: where the centrelines of all links run, how their sections are turned, and what they strain, over time."""

from functools import lru_cache
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from flexman_gym.arrays import Array, Vector
from flexman_gym.checks import non_negative, number_array, whole_number
from flexman_gym.model.element import NODE_COORDINATES, beam_shapes, beam_slopes, find_element
from flexman_gym.model.model import Model, checked_model
from flexman_gym.model.strain import element_strains

MOST_POINTS = 1000
SLOPE_POINTS = 3  # Gauss points between two breaks, exact for the squares of quadratic slopes
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


class LinkShapes(NamedTuple):
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
    d = checked_model(model).n_dof
    shape = (*np.shape(states)[:-1], 2 * d)
    x = number_array("states", states, shape, f"numbers (..., {2 * d}), 2 d for each state").reshape(-1, 2 * d)
    count, gain = whole_number("points", points, 2, MOST_POINTS), non_negative("gain", gain)
    constants, n = model.constants, model.n_joints
    mounts = constants.mount.reshape(n, 3, 3)
    places, frames = np.zeros((len(x), n, count, 3)), np.zeros((len(x), n, count, 3, 3))
    deformed, radii = np.zeros((len(x), n, count, 4)), np.zeros((n, count, 3))
    turned, origin = np.broadcast_to(np.eye(3), (len(x), 3, 3)), np.zeros((len(x), 3))
    for i, link in enumerate(link_shapes(model, count)):
        motor = x[:, model.motor_columns[i]]
        angle = motor + gain * (x[:, i] - motor)
        turned = turned @ mounts[i] @ rotations(angle[:, None] * constants.axis[i])
        elastic = x[:, model.elastic_columns(i)]
        moved = np.einsum("pck,tk->tpc", link.rows, elastic)
        local = gain * moved[..., PLACE]
        local[..., 0] += np.linspace(0.0, constants.length[i], count)
        local[..., 0] -= gain**2 * foreshortening(link, elastic)
        places[:, i] = origin[:, None] + np.einsum("tab,tpb->tpa", turned, local)
        frames[:, i] = turned[:, None] @ rotations(gain * moved[..., TURN])
        deformed[:, i], radii[i] = moved[..., STRAIN], link.radii
        turned, origin = frames[:, i, -1], places[:, i, -1]
    strains = deformed[..., [0, 3, 2, 1]] * np.concatenate([np.ones((n, count, 1)), radii * (-1.0, 1.0, 1.0)], axis=-1)
    result = places, frames, deformed[..., 1:], strains
    return Curves(*(each.reshape(*shape[:-1], *each.shape[1:]) for each in result))


@lru_cache(maxsize=16)
def link_shapes(model: Model, points: int) -> tuple[LinkShapes, ...]:
    """Gives the shapes of all links at equally spaced places.

    Args:
        model: the model.
        points: places on each link.
    """
    return tuple(_shapes(model, i, points) for i in range(model.n_joints))


def _shapes(model: Model, link: int, points: int) -> LinkShapes:
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
            row[STRAIN] = element_strains(xi, element.length) @ own
    if not (k and model.choice.stiffening):
        return LinkShapes(rows, np.zeros((0, 2, k)), np.zeros(points, dtype=int), radii)
    breaks = np.unique(np.append(places, [each.start for each in elements]))
    abscissae, weights = np.polynomial.legendre.leggauss(SLOPE_POINTS)
    slopes = []
    for first, last in pairwise(breaks):
        element, _ = find_element(elements, (first + last) / 2)
        for at, weight in zip(abscissae, weights, strict=True):
            xi = (first + (1.0 + at) / 2 * (last - first) - element.start) / element.length
            part = np.sqrt(weight / 4 * (last - first))  # half of the integrand, and the weight of half an interval
            slopes.append(part * beam_slopes(xi, element.length) @ nodes[element.nodes])
    return LinkShapes(rows, np.array(slopes), SLOPE_POINTS * np.searchsorted(breaks, places), radii)


def foreshortening(link: LinkShapes, elastic: Array) -> Array:
    """Gives by how much the places of a link have moved back, (T, P) m, at elastic coordinates (T, k)."""
    squares = (np.einsum("gck,tk->tgc", link.slopes, elastic) ** 2).sum(axis=2)
    return np.cumsum(np.insert(squares, 0, 0.0, axis=1), axis=1)[:, link.before]


def rotations(vectors: Array) -> Array:
    """Gives rotation matrices (..., 3, 3) of rotation vectors (..., 3)."""
    angle = np.sqrt((vectors**2).sum(axis=-1))[..., None, None]
    cross = np.zeros((*vectors.shape, 3))
    cross[..., 2, 1], cross[..., 0, 2], cross[..., 1, 0] = vectors[..., 0], vectors[..., 1], vectors[..., 2]
    cross = cross - np.swapaxes(cross, -1, -2)
    half = np.sinc(angle / (2 * np.pi))
    return np.eye(3) + np.sinc(angle / np.pi) * cross + half**2 / 2 * (cross @ cross)

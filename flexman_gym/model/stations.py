"""Stations: the points of a link's centreline that stand for its foreshortening."""

from collections.abc import Sequence

import numpy as np

from flexman_gym.arrays import Array
from flexman_gym.model.element import GAUSS_POINTS, NODE_COORDINATES, Element, beam_shapes, beam_slopes

BLOCK = 2 * NODE_COORDINATES  # coordinates of an element
GROUP = 4  # for foreshortening, the tip and the stations of a link fill groups of this size


def beam_stations(elements: Sequence[Element], size: int) -> tuple[Array, Array, Array]:
    """Gives G at each station, the stations and their shapes; the first station is the tip.

    The other s - 1 >= elements + 1 stations stand for the polynomials nearest to the motion of the centreline. Each
    lies at a Gauss point of the link. It is the mean of the motion with the Lagrange polynomial of this point as
    weight. Products of such polynomials have the exact integral. The mass matrix less the part of the stations is a sum
    of squares, so it stays positive.

    G at a point is the integral of v'^T v' + w'^T w' from the base to the point. It is exact, by enough Gauss points.

    Args:
        elements: of the link, base to tip.
        size: number of node coordinates of the link, the clamped node included.

    Returns:
        G (s, size, size), stations (s, 4) with mass (kg) and place along x, y and z (m), and shapes (s, 3, size).
    """
    count = GROUP * -(-(len(elements) + 2) // GROUP) - 1
    abscissae, weights = np.polynomial.legendre.leggauss(GAUSS_POINTS)
    fine, parts = np.polynomial.legendre.leggauss((count + 7) // 2)  # exact for G, of degree 5, times the weight
    points = np.concatenate([start + length * (1 + fine) / 2 for _, start, length, _ in elements])
    shares = np.concatenate([parts / 2 * length * each.density * each.area for each, _, length, _ in elements])
    places, masses = _gauss_rule(points, shares, count)
    means = iter((shares / masses[:, None] * _lagrange(places, points)).T)
    integral, shapes = np.zeros((size, size)), np.zeros((count + 1, 3, size))
    # G couples the coordinates of neighbouring nodes alone: only these blocks are summed, one for each element
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
    """Gives a view (count, 12, 12) of the blocks along the diagonal of a matrix that belong to elements."""
    row, column = matrix.strides
    step = NODE_COORDINATES * (row + column)
    return np.lib.stride_tricks.as_strided(matrix, (count, BLOCK, BLOCK), (step, row, column), writeable=False)


def _gauss_rule(places: Array, masses: Array, count: int) -> tuple[Array, Array]:
    """Gives places and masses (count,) that integrate polynomials to degree 2 count - 1 over many masses."""
    # from the three-term recurrence of the orthogonal polynomials (Golub and Welsch, Math. Comp. 23, 1969)
    diagonal, beside = np.zeros(count), np.zeros(count)
    before, now = np.zeros(len(places)), np.ones(len(places)) / np.sqrt(masses.sum())
    for i in range(count):
        diagonal[i] = masses @ (places * now**2)
        ahead = (places - diagonal[i]) * now - (beside[i - 1] if i else 0.0) * before
        beside[i] = np.sqrt(masses @ ahead**2)
        before, now = now, ahead / beside[i]
    result, vectors = np.linalg.eigh(np.diag(diagonal) + np.diag(beside[:-1], -1))  # reads the lower triangle
    return result, masses.sum() * vectors[0] ** 2


def _lagrange(places: Array, points: Array) -> Array:
    """Gives polynomials (s, p) that are one at one of the places (s,) and zero at the others, at the points (p,)."""
    others = ~np.eye(len(places), dtype=bool)
    return np.array(
        [
            np.prod((points[:, None] - places[other]) / (place - places[other]), axis=1)
            for place, other in zip(places, others, strict=True)
        ]
    )

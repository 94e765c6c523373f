"""Stations: the points of a link's centreline that stand for its foreshortening."""

from collections.abc import Sequence

import numpy as np

from flexman_gym.arrays import Array
from flexman_gym.model.element import GAUSS_POINTS, Element, beam_shapes, beam_slopes

GROUP = 4  # the tip and the stations of a link, for foreshortening, fill groups of this many


def beam_stations(elements: Sequence[Element], size: int) -> tuple[Array, Array, Array]:
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

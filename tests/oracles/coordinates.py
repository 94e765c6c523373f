"""Modes, modal damping and stations of uniform links, from their definitions and the oracle's beams.

This module shares no code with the library under test. Modes of different eigensolvers differ in their signs, in
digits depending on the ratio of stiffnesses, and for close frequencies; `agreed_modes` checks the modes under test and
then uses them as coordinates.
"""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from oracles.dense import beam_points, element_rows, gauss_points, payload_points, skew

AGREEMENT = 1e-7
EXACT = 10  # Gauss points of an element, for the product of a Lagrange polynomial and a quintic: to degree 19


@dataclass(frozen=True)
class Stations:
    """Points of a centreline, tip first: masses and positions (s, 2), shapes (s, 3, k) and G (s, k, k)."""

    stations: np.ndarray
    station_shapes: np.ndarray
    shortening: np.ndarray


def outboard_masses(arm, elements):
    """Return the inertia (6, 6) of all points outboard of each tip at zero angles, in its beam frame."""
    turns = [np.array(link.orientation) for link in arm.links]
    beams = [beam_points(link, count) for link, count in zip(arm.links, elements, strict=True)]
    tips = np.cumsum([turn[:, 0] * link.length for turn, link in zip(turns, arm.links, strict=True)], axis=0)
    payload, result = payload_points(arm.payload), []
    for i, turn in enumerate(turns):
        behind = [(tips[j - 1] + beams[j].r0 @ turns[j].T, beams[j].masses) for j in range(i + 1, len(turns))]
        total = np.zeros((6, 6))
        for places, masses in [*behind, (tips[-1] + payload.r0, payload.masses)]:
            arms = skew((places - tips[i]) @ turn)
            motion = np.concatenate([np.broadcast_to(np.eye(3), arms.shape), -arms], axis=2)  # by that of the tip
            total += np.einsum("p,pia,pib->ab", masses, motion, motion)
        result.append(total)
    return result


def loaded_link(link, count, outboard):
    """Return stiffness and mass matrix of a link with the load at its tip, (6 count, 6 count) each."""
    beam = beam_points(link, count)
    tip = np.vstack([beam.S_t, beam.S_r])
    return beam.K, np.einsum("p,pia,pib->ab", beam.masses, beam.S, beam.S) + tip.T @ outboard @ tip


def agreed_modes(given, stiffness, mass):
    """Return the given modes (size, k) after asserting that they are the k lowest up to rounding.

    With K = L L^T and y = L^T v they are eigenvectors of L^-1 M L^-T of unit modal mass, with the largest eigenvalues
    1 / omega^2. Modes of close frequencies may mix, as for any two eigensolvers.
    """
    factor = np.linalg.cholesky(stiffness)
    inverse = np.linalg.solve(factor, np.eye(len(factor)))
    flexibility = inverse @ mass @ inverse.T
    largest, vectors = np.linalg.eigvalsh(flexibility)[::-1][: given.shape[1]], factor.T @ given
    rounding = 100 * np.finfo(float).eps * largest[:1] / largest  # of what is stiff beside what is soft
    left = np.linalg.norm(flexibility @ vectors - largest * vectors, axis=0) / largest / np.linalg.norm(vectors, axis=0)
    assert (left <= np.maximum(AGREEMENT, rounding)).all()
    assert np.abs(given.T @ mass @ given - np.eye(given.shape[1])).max(initial=0.0) <= AGREEMENT
    return given


def own_damping(stiffness, mass, ratio):
    """Return C = 2 ratio M (M^-1 K)^1/2 = 2 ratio L (L^-1 M L^-T)^1/2 L^T, equal damping ratios of all modes."""
    factor = np.linalg.cholesky(stiffness)
    inverse = np.linalg.solve(factor, np.eye(len(factor)))
    squares, vectors = np.linalg.eigh(inverse @ mass @ inverse.T)
    return 2.0 * ratio * factor @ (vectors * np.sqrt(squares)) @ vectors.T @ factor.T


def agreed(own, given, scale):
    """Return a value after asserting that it equals the oracle's up to rounding, both divided by a scale."""
    assert np.shape(own) == np.shape(given)
    largest = np.abs(own / scale).max(initial=0.0)
    assert np.abs((own - given) / scale).max(initial=0.0) <= AGREEMENT * largest
    return given


def own_stations(link, count):
    """Return the stations of a uniform link: 4 ceil((count + 2) / 4) - 1 Gauss points of the whole link, and the tip.

    A station moves as the mean of the centreline weighted by the Lagrange polynomial of its point; G is the mean, with
    the same weights, of the integral of v'^T v' + w'^T w' from the base.
    """
    points, size, h = 4 * -(-(count + 2) // 4) - 1, 6 * (count + 1), link.length / count
    nodes, weights = gauss_points(points)
    places, masses = link.length * (1 + nodes) / 2, link.mass * weights / 2
    shapes, integrals = np.zeros((points + 1, 3, size)), np.zeros((points + 1, size, size))
    inner, parts = gauss_points(EXACT)
    before = np.zeros((size, size))
    for element in range(count):
        dofs = slice(6 * element, 6 * element + 12)
        for xi, part in zip((1 + inner) / 2, parts * h / 2, strict=True):
            x = (element + xi) * h
            others = [np.delete(places, s) for s in range(points)]
            share = [np.prod((x - each) / (places[s] - each)) for s, each in enumerate(others)]
            weighed = np.array(share) * part * link.mass / link.length / masses
            shapes[1:, :, dofs] += np.multiply.outer(weighed, element_rows(xi, h)[0][:3])
            integrals[1:] += np.multiply.outer(weighed, before)
            integrals[1:, dofs, dofs] += np.multiply.outer(weighed, _slopes(xi, h))
        before[dofs, dofs] += _slopes(1.0, h)
    shapes[0, :, dofs], integrals[0] = element_rows(1.0, h)[0][:3], before
    table = np.column_stack([np.r_[0.0, masses], np.r_[link.length, places]])
    return Stations(table, shapes[:, :, 6:], integrals[:, 6:, 6:])


@lru_cache(1000)
def _slopes(end, h):
    """Return the integral (12, 12) of v'^T v' + w'^T w' over an element of length h, up to a share of its length."""
    nodes, weights = gauss_points(4)
    total = np.zeros((12, 12))
    for xi, weight in zip(end * (1 + nodes) / 2, end * h * weights / 2, strict=True):
        slope = element_rows(xi, h)[0][4:]
        total += weight * slope.T @ slope
    return total

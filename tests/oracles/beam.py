"""A beam of the oracle: one link as mass points, and the rotations that a chain of links needs (Eq. 1-3, 13-18).

A point moves by S q and, where a bent link is foreshortened, back along x by 1/2 q^T G q. SI units, radians.
"""

from dataclasses import dataclass, replace
from math import factorial

import numpy as np
from numpy.polynomial.polynomial import Polynomial, polyder, polyval

_E1 = np.array([1.0, 0.0, 0.0])


@dataclass(frozen=True)
class Beam:
    """One link as P mass points with k elastic coordinates, in its own frame: x along the link, 0 at its joint."""

    r0: np.ndarray  # (P, 3) undeformed positions, m
    masses: np.ndarray  # (P,) kg
    S: np.ndarray  # (P, 3, k) a point moves by S q, Eq. 3
    K: np.ndarray  # (k, k) stiffness, Eq. 18
    S_t: np.ndarray  # (3, k) displacement of the tip
    S_r: np.ndarray  # (3, k) rotation vector of the tip, rows phi_x, theta_y, theta_z
    G: np.ndarray  # (P, k, k) a point also moves back by 1/2 q^T G q
    G_t: np.ndarray  # (k, k) the same at the tip

    def points(self, q):
        """Positions r (P, 3) of the mass points at q (k,), and dr/dq (P, 3, k)."""
        return self.r0 + self.S @ q - np.multiply.outer(0.5 * q @ self.G @ q, _E1), self.S - _rows(self.G @ q)

    def tip_displacement(self, q):
        """Displacement d (3,) of the tip at q (k,), and dd/dq (3, k)."""
        return self.S_t @ q - 0.5 * q @ self.G_t @ q * _E1, self.S_t - _rows(self.G_t @ q)

    def curvature(self, dq):
        """Accelerations d2r/dq2 q' q' of the mass points (P, 3) and of the tip (3,) at the rates dq (k,)."""
        return -np.multiply.outer(dq @ self.G @ dq, _E1), -dq @ self.G_t @ dq * _E1


_GENERATORS = np.array([np.cross(np.eye(3), unit) for unit in np.eye(3)])  # the skew matrices of e1, e2, e3


def skew(a):
    """Matrices (..., 3, 3) with skew(a) b = a x b, of vectors a (..., 3)."""
    return np.tensordot(a, _GENERATORS, 1)


def rotation(phi):
    """Rotation matrix (3, 3) of the rotation vector phi (3,): the exponential map."""
    X, p = skew(phi), np.linalg.norm(phi)
    return np.eye(3) + np.sinc(p / np.pi) * X + 0.5 * np.sinc(0.5 * p / np.pi) ** 2 * X @ X


# Power series in s = p^2 of (1 - cos p) / p^2 and (p - sin p) / p^3, which are 0/0 at p = 0; to round-off for p < 2 pi.
_C2, _C3 = (Polynomial([(-1) ** k / factorial(2 * k + n) for k in range(20)]) for n in (2, 3))
_DC2, _DC3 = _C2.deriv(), _C3.deriv()


def tangent(phi, rate):
    """T(phi) and its derivative for phi' = rate (3, 3): T phi' is rotation(phi)'s angular velocity, parent frame."""
    X, dX, s, ds = skew(phi), skew(rate), phi @ phi, 2.0 * phi @ rate
    T = np.eye(3) + _C2(s) * X + _C3(s) * X @ X
    dT = _C2(s) * dX + _C3(s) * (dX @ X + X @ dX) + ds * (_DC2(s) * X + _DC3(s) * X @ X)
    return T, dT


# Hermite cubics of xi for the end values v_1, v_1', v_2, v_2' (a column each, lowest power first).
_HERMITE = np.array([[1, 0, -3, 2], [0, 1, -2, 1], [0, 0, 3, -2], [0, 0, -1, 1]]).T


def element_rows(xi, h):
    """Shape functions of a 2-node element of length h at x = xi h; dofs u, v, w, phi_x, theta_y, theta_z of both nodes.

    Returns the rows u, v, w, phi, v', w' as (6, 12), and the rows of the strains u', v'', w'', phi' as (4, 12).
    """
    linear, stretch = [1.0 - xi, xi], [-1.0 / h, 1.0 / h]
    cubic, slope, bend = (np.array([1, h, 1, h]) / h**m * polyval(xi, polyder(_HERMITE, m)) for m in range(3))
    u, v, w, phi = [0, 6], [1, 5, 7, 11], [2, 4, 8, 10], [3, 9]
    sign = np.array([1, -1, 1, -1])  # theta_y = -w'
    fields, strains = np.zeros((6, 12)), np.zeros((4, 12))
    for row, (dofs, values) in enumerate(
        [(u, linear), (v, cubic), (w, sign * cubic), (phi, linear), (v, slope), (w, sign * slope)]
    ):
        fields[row, dofs] = values
    for row, (dofs, values) in enumerate([(u, stretch), (v, bend), (w, sign * bend), (phi, stretch)]):
        strains[row, dofs] = values
    return fields, strains


def beam_points(link, elements, basis=None):
    """Finite elements of a link clamped at x = 0 as a `Beam`: Eq. 3 and 18 with a quadrature in place of the integrals.

    Coordinates: 6 a node, from the node next to the joint to the tip; a basis (6 elements, m) sets q_full = basis @ q.
    Four Gauss points an element integrate products of cubics exactly; four section points give A, I_y and I_z exactly.
    """
    size, h = 6 * (elements + 1), link.length / elements
    y, z = np.sqrt(2.0 * link.second_moment_z / link.area), np.sqrt(2.0 * link.second_moment_y / link.area)
    E, G = link.youngs_modulus, link.shear_modulus
    rigidity = [E * link.area, E * link.second_moment_z, E * link.second_moment_y, G * link.torsion_constant]
    nodes, weights = np.polynomial.legendre.leggauss(4)
    r0, masses, S, K = [], [], [], np.zeros((size, size))
    for element in range(elements):
        dofs = slice(6 * element, 6 * element + 12)
        for xi, weight in zip((1.0 + nodes) / 2.0, weights * h / 2.0, strict=True):
            (u, v, w, phi, dv, dw), strains = element_rows(xi, h)
            K[dofs, dofs] += weight * strains.T @ np.diag(rigidity) @ strains
            for py, pz in [(y, 0.0), (-y, 0.0), (0.0, z), (0.0, -z)]:
                shape = np.zeros((3, size))
                shape[:, dofs] = [u - py * dv - pz * dw, v - pz * phi, w + py * phi]
                r0.append([(element + xi) * h, py, pz])
                masses.append(link.density * link.area * weight / 4.0)
                S.append(shape)
    free = np.eye(size)[:, 6:]  # node 0 is clamped to the frame
    basis = free if basis is None else free @ basis
    k = basis.shape[1]
    straight = np.zeros((len(masses), k, k)), np.zeros((k, k))
    return Beam(np.array(r0), np.array(masses), S @ basis, basis.T @ K @ basis, basis[-6:-3], basis[-3:], *straight)


def shortened(beam, stations, basis):
    """The beam with the foreshortening of its centreline, given in the coordinates that basis @ q sets.

    The motion of its centreline is taken out, as stations of negative mass, and put back with foreshortening.
    `stations` are those of `oracles.coordinates`.
    """
    mass, place = stations.stations.T
    r0 = np.outer(place, _E1)
    S, G = stations.station_shapes @ basis, basis.T @ stations.shortening @ basis
    return replace(
        beam,
        r0=np.concatenate([beam.r0, r0, r0]),
        masses=np.concatenate([beam.masses, -mass, mass]),
        S=np.concatenate([beam.S, S, S]),
        G=np.concatenate([beam.G, 0.0 * G, G]),
        G_t=basis.T @ stations.shortening[0] @ basis,  # the first station is the tip
    )


def payload_points(payload):
    """The payload (None: nothing) as a rigid `Beam` in the frame of the tip: a point, or six with the same inertia."""
    none = np.zeros((0, 0))
    r0, masses = np.zeros((0, 3)), np.zeros(0)
    if payload is not None:
        r0, masses = np.array([payload.offset or np.zeros(3)]), np.array([payload.mass])
        if payload.inertia is not None:
            inertia = np.array(payload.inertia)
            squares, axes = np.linalg.eigh(0.5 * np.trace(inertia) * np.eye(3) - inertia)  # sum m d d^T
            arms = np.sqrt(3.0 * np.maximum(squares, 0.0) / payload.mass) * axes
            r0, masses = r0 + np.vstack([arms.T, -arms.T]), np.full(6, payload.mass / 6.0)
    P = len(masses)
    return Beam(r0, masses, np.zeros((P, 3, 0)), none, np.zeros((3, 0)), np.zeros((3, 0)), np.zeros((P, 0, 0)), none)


def _rows(a):
    """(..., 3, k) with a (..., k) in the row of x and zeros in the others."""
    return _E1[:, None] * a[..., None, :]

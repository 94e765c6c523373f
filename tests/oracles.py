"""An oracle: the paper's equations of a flexible arm, stated densely and slowly to check the fast kernels against.

Two nouns: `Beam`, one link as mass points (Eq. 1-3, 13-18), and `Chain`, the arm in joint and elastic coordinates
(Eq. 4-14 and 22-46); beside them the closed-form eigenvalues of a uniform beam. They use nothing but NumPy and SciPy,
so that they share no error with the code under test. SI units, radians. Capital letters are matrices of the paper.
"""

from dataclasses import dataclass, replace
from itertools import pairwise
from math import factorial

import numpy as np
from numpy.polynomial.polynomial import Polynomial, polyder, polyval

from flexman_gym.closed_forms import beam_eigenvalues as beam_eigenvalues
from flexman_gym.closed_forms import hub_eigenvalues as hub_eigenvalues


@dataclass(frozen=True)
class Beam:
    """One link as P mass points with k elastic coordinates, in its own frame: x along the link, 0 at its joint."""

    r0: np.ndarray  # (P, 3) undeformed positions, m
    masses: np.ndarray  # (P,) kg
    S: np.ndarray  # (P, 3, k) a point moves by S q, Eq. 3
    K: np.ndarray  # (k, k) stiffness, Eq. 18
    S_t: np.ndarray  # (3, k) displacement of the tip
    S_r: np.ndarray  # (3, k) rotation vector of the tip, rows phi_x, theta_y, theta_z


@dataclass(frozen=True)
class LinkMotion:
    """Position and velocity of one link's frame in the base frame, and its entries D and gamma in Eq. 34."""

    R: np.ndarray  # (3,) origin
    A: np.ndarray  # (3, 3) columns are the axes of the beam frame
    axis: np.ndarray  # (3,) joint axis, Eq. 29
    rates: np.ndarray  # (6 + k,) velocity of the origin, angular velocity, elastic rates
    q: np.ndarray  # (k,) elastic coordinates
    D: np.ndarray  # (6, 6 + k) takes the rates to the velocity and angular velocity of the tip, Eq. 36
    gamma: np.ndarray  # (6 + k,) accelerations of the frame that are quadratic in the speeds of x, Eq. 32-33


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
    return Beam(np.array(r0), np.array(masses), S @ basis, basis.T @ K @ basis, basis[-6:-3], basis[-3:])


class Chain:
    """Dense equations of motion of an arm, Eq. 8-14 and 22-46.

    Angular velocity and acceleration stand where the paper has Euler parameters and their derivatives: omega = G beta'
    has one beta' (normal to beta) for every omega, so the motion is the same. Link i has the absolute accelerations
    [R'', omega', q''] (6 + k,), the first two in the base frame. The elastic rotation of a tip turns the next joint by
    the exponential map; the exact derivatives of that map replace Eq. 26.

    Coordinates x = [theta (n), theta_m (flexible joints only), q_1, q_2, ...]; speeds v in the same order. In x, rotor
    i is at motor[i] and q_i at elastic[i]; damping[i] is the damping matrix of link i.
    Frames: joint frame E_1 = I, A_i = E_i rotation(axis_i theta_i) F_i, E_{i+1} = A_i rotation(S_r q_i) F_i^T.
    A rigid joint takes its torque directly, has no damping, and its rotor adds to the inertia of its own angle only.
    """

    def __init__(self, arm, elements=2, flexible_links=True, flexible_joints=True, bases=None, link_damping=None):
        """Take one value or one a link for `elements` and `flexible_links`; a list or None for the last two.

        A basis is (6 elements, m), a link damping matrix (m, m). An entry None is the full basis, or C = beta K.
        """
        n = len(arm.links)
        elements, flexible_links = np.broadcast_to(elements, n), np.broadcast_to(flexible_links, n)
        self.arm, self.n = arm, n
        self.axes = [np.array(joint.axis, dtype=float) for joint in arm.joints]
        self.orientations = [np.array(link.orientation, dtype=float) for link in arm.links]
        self.gravity = np.array(arm.gravity, dtype=float)
        self.beams, self.damping = [], []
        for i, link in enumerate(arm.links):
            basis = bases[i] if bases is not None else None
            if not flexible_links[i]:
                basis = np.zeros((6 * elements[i], 0))  # a rigid link is a beam without coordinates
            beam = beam_points(link, int(elements[i]), basis)
            given = link_damping[i] if link_damping is not None and flexible_links[i] else None
            self.beams.append(beam)
            self.damping.append(arm.stiffness_proportional_damping * beam.K if given is None else np.array(given))
        if arm.payload is not None:  # one more mass point, at the tip of the last link
            last, tip = self.beams[-1], np.array([arm.links[-1].length, 0.0, 0.0])
            r0, masses = np.vstack([last.r0, tip]), np.append(last.masses, arm.payload.mass)
            self.beams[-1] = replace(last, r0=r0, masses=masses, S=np.concatenate([last.S, last.S_t[None]]))
        springs = [i for i, joint in enumerate(arm.joints) if flexible_joints and joint.stiffness is not None]
        self.motor = {joint: n + place for place, joint in enumerate(springs)}  # index of theta_m in x
        ends = n + len(springs) + np.cumsum([0] + [beam.K.shape[0] for beam in self.beams])
        self.elastic = [slice(a, b) for a, b in pairwise(ends)]  # q_i in x
        self.n_dof = int(ends[-1])

    def _motion(self, x, v):
        """Outward pass, Eq. 24-33: the `LinkMotion` of every link, then position and velocity of the tip (3,)."""
        R, E, tip_rates, tip_gamma, motions = np.zeros(3), np.eye(3), np.zeros(6), np.zeros(6), []
        for i, beam in enumerate(self.beams):
            F, q, dq = self.orientations[i], x[self.elastic[i]], v[self.elastic[i]]
            A, axis = E @ rotation(self.axes[i] * x[i]) @ F, E @ self.axes[i]
            spin, zero = axis * v[i], np.zeros(3)  # Eq. 28
            gamma = np.r_[tip_gamma + np.r_[zero, skew(tip_rates[3:]) @ spin], np.zeros(q.size)]
            rates = np.r_[tip_rates + np.r_[zero, spin], dq]

            phi, dphi, W = beam.S_r @ q, beam.S_r @ dq, skew(rates[3:6])
            T, dT = tangent(phi, dphi)
            lever, slide = A @ (beam.S_t @ q) + A[:, 0] * self.arm.links[i].length, A @ beam.S_t @ dq
            D = np.block([[np.eye(3), -skew(lever), A @ beam.S_t], [np.zeros((3, 3)), np.eye(3), A @ T @ beam.S_r]])
            motions.append(LinkMotion(R, A, axis, rates, q, D, gamma))

            tip_rates = D @ rates
            tip_gamma = np.r_[W @ (W @ lever + 2.0 * slide), W @ A @ T @ dphi + A @ dT @ dphi]
            R, E = R + lever, A @ rotation(phi) @ F.T
        return motions, R, tip_rates[:3]

    @staticmethod
    def _point_matrix(beam, motion):
        """Levers A u (P, 3) and L (P, 3, 6 + k) of Eq. 8, so that a mass point moves with L [R', omega, q'], Eq. 4."""
        lever = (beam.r0 + beam.S @ motion.q) @ motion.A.T
        identity = np.broadcast_to(np.eye(3), (len(lever), 3, 3))
        return lever, np.concatenate([identity, -skew(lever), motion.A @ beam.S], axis=2)

    def _link_equation(self, i, motion):
        """M (6 + k, 6 + k) of Eq. 13 and the force Q_e + Q_v + Q_s (6 + k,) of Eq. 21 of link i; Q_e is gravity."""
        beam, W, dq = self.beams[i], skew(motion.rates[3:6]), motion.rates[6:]
        lever, L = self._point_matrix(beam, motion)
        Q = lever @ (W @ W).T + 2.0 * (beam.S @ dq) @ (W @ motion.A).T  # Eq. 10
        M = np.einsum("p,pia,pib->ab", beam.masses, L, L)
        force = np.einsum("p,pia,pi->a", beam.masses, L, self.gravity - Q)
        force[6:] -= beam.K @ motion.q + self.damping[i] @ dq
        return M, force

    def _projection(self, motions):
        """B = D^-1 H, one column a coordinate of x, and D^-1 gamma: Eq. 35-43.

        The frame of a link is clamped to its joint, so its own D_i is the identity. Columns of rotors are zero.
        """
        ends = np.cumsum([0] + [motion.gamma.size for motion in motions])
        D, H = np.eye(ends[-1]), np.zeros((ends[-1], self.n_dof))
        for i, (start, end) in enumerate(pairwise(ends)):
            H[start + 3 : start + 6, i] = motions[i].axis
            H[start + 6 : end, self.elastic[i]] = np.eye(end - start - 6)
            if i + 1 < self.n:
                D[end : end + 6, start:end] = -motions[i].D
        return np.linalg.solve(D, H), np.linalg.solve(D, np.concatenate([motion.gamma for motion in motions]))

    def _equation(self, x, v, torque):
        """M_bar and Q_bar of Eq. 46 (n_dof, n_dof), (n_dof,), with the joints of Eq. 23."""
        motions, _, _ = self._motion(x, v)
        B, bias = self._projection(motions)
        M_bar, Q_bar, start = np.zeros((self.n_dof, self.n_dof)), np.zeros(self.n_dof), 0
        for i, motion in enumerate(motions):
            rows = slice(start, start + motion.gamma.size)
            M, force = self._link_equation(i, motion)
            M_bar += B[rows].T @ M @ B[rows]
            Q_bar += B[rows].T @ (force - M @ bias[rows])
            start = rows.stop
        for i, joint in enumerate(self.arm.joints):
            driven = self.motor.get(i, i)
            M_bar[driven, driven] += joint.rotor_inertia
            Q_bar[driven] += torque[i]
            if i in self.motor:
                reaction = joint.stiffness * (x[driven] - x[i]) + joint.damping * (v[driven] - v[i])
                Q_bar[i] += reaction
                Q_bar[driven] -= reaction
        return M_bar, Q_bar

    def mass_matrix(self, x):
        """M_bar of Eq. 46 with the rotors, (n_dof, n_dof)."""
        return self._equation(x, np.zeros(self.n_dof), np.zeros(self.n))[0]

    def acceleration(self, x, v, torque):
        """Accelerations (n_dof,) under the motor torques (n,), N m: Eq. 45."""
        return np.linalg.solve(*self._equation(x, v, torque))

    def tip(self, x):
        """Position (3,) of the tip of the last link, m."""
        return self._motion(x, np.zeros(self.n_dof))[1]

    def tip_velocity(self, x, v):
        """Velocity (3,) of the tip of the last link, m/s."""
        return self._motion(x, v)[2]

    def points(self, x, v):
        """Masses (N,), positions (N, 3) and velocities (N, 3) of every mass point of links and payload, Eq. 1 and 4."""
        masses, positions, velocities = [], [], []
        for beam, motion in zip(self.beams, self._motion(x, v)[0], strict=True):
            lever, L = self._point_matrix(beam, motion)
            masses.append(beam.masses)
            positions.append(motion.R + lever)
            velocities.append(L @ motion.rates)
        return np.concatenate(masses), np.concatenate(positions), np.concatenate(velocities)

    def energy(self, x, v):
        """Kinetic (with rotors), elastic (links and joints) and gravitational energy (zero at the base origin), J."""
        masses, positions, velocities = self.points(x, v)
        kinetic = 0.5 * masses @ np.sum(velocities**2, axis=1)
        elastic = sum(0.5 * x[q] @ beam.K @ x[q] for q, beam in zip(self.elastic, self.beams, strict=True))
        for i, joint in enumerate(self.arm.joints):
            kinetic += 0.5 * joint.rotor_inertia * v[self.motor.get(i, i)] ** 2
            if i in self.motor:
                elastic += 0.5 * joint.stiffness * (x[self.motor[i]] - x[i]) ** 2
        return kinetic, elastic, -masses @ positions @ self.gravity

    def angular_momentum(self, x, v):
        """Angular momentum (3,) of links and payload about the base origin, kg m^2/s, rotors excluded.

        Only the first rotor enters the balance about axis_1: without a moment of gravity, axis_1 . angular_momentum +
        J_1 theta_m1' (theta_1' where joint 1 is rigid) grows at the rate T_1. The other rotors turn relative to their
        links and their absolute rotation is dropped (Eq. 23), so they neither take nor give momentum about axis_1.
        """
        masses, positions, velocities = self.points(x, v)
        return masses @ np.cross(positions, velocities)

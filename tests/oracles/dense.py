"""An oracle: the paper's equations of a flexible arm, stated densely and slowly to check the fast kernels against.

`Chain` is the arm in joint and elastic coordinates (Eq. 4-14 and 22-46), its links are the mass points of
`oracle_beam` (Eq. 1-3, 13-18); beside them the closed-form eigenvalues of a uniform beam. They use nothing but NumPy,
so that they share no error with the code under test. SI units, radians. Capital letters are matrices of the paper.
"""

from dataclasses import dataclass, field, replace
from functools import cache, lru_cache
from itertools import pairwise
from math import factorial
from typing import Any

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
        """Return the positions r (P, 3) of the mass points at q (k,), and dr/dq (P, 3, k)."""
        return self.r0 + self.S @ q - np.multiply.outer(0.5 * q @ self.G @ q, _E1), self.S - _rows(self.G @ q)

    def tip_displacement(self, q):
        """Return the displacement d (3,) of the tip at q (k,), and dd/dq (3, k)."""
        return self.S_t @ q - 0.5 * q @ self.G_t @ q * _E1, self.S_t - _rows(self.G_t @ q)

    def curvature(self, dq):
        """Return the accelerations d2r/dq2 q' q' of the mass points (P, 3) and of the tip (3,) at the rates dq (k,)."""
        return -np.multiply.outer(dq @ self.G @ dq, _E1), -dq @ self.G_t @ dq * _E1


_GENERATORS = np.array([np.cross(np.eye(3), unit) for unit in np.eye(3)])  # the skew matrices of e1, e2, e3


def skew(a):
    """Return the matrices (..., 3, 3) with skew(a) b = a x b, of vectors a (..., 3)."""
    return np.tensordot(a, _GENERATORS, 1)


def rotation(phi):
    """Return the rotation matrix (3, 3) of the rotation vector phi (3,): the exponential map."""
    X, p = skew(phi), np.linalg.norm(phi)
    return np.eye(3) + np.sinc(p / np.pi) * X + 0.5 * np.sinc(0.5 * p / np.pi) ** 2 * X @ X


# Power series in s = p^2 of (1 - cos p) / p^2 and (p - sin p) / p^3, which are 0/0 at p = 0; to round-off for p < 2 pi.
_C2, _C3 = (Polynomial([(-1) ** k / factorial(2 * k + n) for k in range(20)]) for n in (2, 3))
_DC2, _DC3 = _C2.deriv(), _C3.deriv()


def tangent(phi, rate):
    """Return T(phi) and its derivative for phi' = rate (3, 3); T phi' is the angular velocity in the parent frame."""
    X, dX, s, ds = skew(phi), skew(rate), phi @ phi, 2.0 * phi @ rate
    T = np.eye(3) + _C2(s) * X + _C3(s) * X @ X
    dT = _C2(s) * dX + _C3(s) * (dX @ X + X @ dX) + ds * (_DC2(s) * X + _DC3(s) * X @ X)
    return T, dT


# Hermite cubics of xi for the end values v_1, v_1', v_2, v_2' (a column each, lowest power first).
_HERMITE = np.array([[1, 0, -3, 2], [0, 1, -2, 1], [0, 0, 3, -2], [0, 0, -1, 1]]).T
_DERIVATIVES = [polyder(_HERMITE, m) for m in range(3)]
gauss_points = cache(np.polynomial.legendre.leggauss)


@lru_cache(1000)
def element_rows(xi, h):
    """Return the shape functions of a 2-node element of length h at x = xi h.

    The dofs are u, v, w, phi_x, theta_y, theta_z of both nodes. The result has the rows u, v, w, phi, v', w' as (6,
    12), and the rows of the strains u', v'', w'', phi' as (4, 12).
    """
    linear, stretch = [1.0 - xi, xi], [-1.0 / h, 1.0 / h]
    cubic, slope, bend = (np.array([1, h, 1, h]) / h**m * polyval(xi, each) for m, each in enumerate(_DERIVATIVES))
    u, v, w, phi = [0, 6], [1, 5, 7, 11], [2, 4, 8, 10], [3, 9]
    sign = np.array([1, -1, 1, -1])  # theta_y = -w'
    fields, strains = np.zeros((6, 12)), np.zeros((4, 12))
    for row, (dofs, values) in enumerate(
        [(u, linear), (v, cubic), (w, sign * cubic), (phi, linear), (v, slope), (w, sign * slope)]
    ):
        fields[row, dofs] = values
    for row, (dofs, values) in enumerate([(u, stretch), (v, bend), (w, sign * bend), (phi, stretch)]):
        strains[row, dofs] = values
    fields.flags.writeable = strains.flags.writeable = False
    return fields, strains


def beam_points(link, elements, basis=None):
    """Return the finite elements of a link clamped at x = 0 as a `Beam`: Eq. 3 and 18 by quadrature.

    Coordinates: 6 a node, from the node next to the joint to the tip; a basis (6 elements, m) sets q_full = basis @ q.
    Four Gauss points an element integrate products of cubics exactly; four section points give A, I_y and I_z exactly.
    """
    size, h = 6 * (elements + 1), link.length / elements
    y, z = np.sqrt(2.0 * link.second_moment_z / link.area), np.sqrt(2.0 * link.second_moment_y / link.area)
    E, G = link.youngs_modulus, link.shear_modulus
    rigidity = [E * link.area, E * link.second_moment_z, E * link.second_moment_y, G * link.torsion_constant]
    nodes, weights = gauss_points(4)
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
    """Return the beam with the foreshortening of its centreline, in the coordinates that basis @ q sets.

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
    """Return the payload as a rigid `Beam` in the tip frame: no point for None, one point, or six of equal inertia."""
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
    """Return (..., 3, k) with a (..., k) in the row of x and zeros in the other rows."""
    return _E1[:, None] * a[..., None, :]


@dataclass(frozen=True)
class LinkModel:
    """Quantities of a link of a `Chain` other than its elements, which have 6 coordinates each."""

    basis: np.ndarray | None = None  # (6 elements, k) coordinates of the elements per unit of q; None keeps them
    damping: np.ndarray | None = None  # (k, k); None takes C = beta K
    stations: Any = None  # where it is foreshortened, see `shortened`; None is a link without foreshortening


@dataclass(frozen=True)
class Base:
    """Prescribed rotation of the base at a time; vectors in the world frame, whose origin is that of the base."""

    attitude: np.ndarray = field(default_factory=lambda: np.eye(3))  # (3, 3) columns are the axes of the base frame
    rate: np.ndarray = field(default_factory=lambda: np.zeros(3))  # (3,) angular velocity, rad/s
    acceleration: np.ndarray = field(default_factory=lambda: np.zeros(3))  # (3,) angular acceleration, rad/s^2


FIXED = Base()


@dataclass(frozen=True)
class LinkMotion:
    """Position and velocity of one link's frame in the base frame, and its entries D and gamma in Eq. 34.

    The tip of the last link has one too, as if it were a link without coordinates.
    """

    R: np.ndarray  # (3,) origin
    A: np.ndarray  # (3, 3) columns are the axes of the beam frame
    axis: np.ndarray  # (3,) joint axis, Eq. 29
    rates: np.ndarray  # (6 + k,) velocity of the origin, angular velocity, elastic rates
    q: np.ndarray  # (k,) elastic coordinates
    D: np.ndarray  # (6, 6 + k) takes the rates to the velocity and angular velocity of the tip, Eq. 36
    gamma: np.ndarray  # (6 + k,) accelerations of the frame that are quadratic in the speeds of x, Eq. 32-33


class Chain:
    """Dense equations of motion of an arm, Eq. 8-14 and 22-46.

    Angular velocity and acceleration stand where the paper has Euler parameters and their derivatives: omega = G beta'
    has one beta' (normal to beta) for every omega, so the motion is the same. Link i has the absolute accelerations
    [R'', omega', q''] (6 + k,), the first two in the base frame. The elastic rotation of a tip turns the next joint by
    the exponential map; the exact derivatives of that map replace Eq. 26.

    Coordinates x = [theta (n), theta_m (flexible joints only), q_1, q_2, ...]; speeds v in the same order. In x, rotor
    i is at motor[i] and q_i at elastic[i]; damping[i] is the damping matrix of link i.
    Frames: joint frame E_1 = I, A_i = E_i rotation(axis_i theta_i) F_i, E_{i+1} = A_i rotation(S_r q_i) F_i^T. The
    payload is a rigid body in E_{n+1}.
    A rigid joint takes its torque directly, and its rotor turns with its angle. A rotor adds to the inertia of its own
    coordinate only (Eq. 23), unless rotors are `spinning`: carried by the link before, each also turns with that link
    about the joint axis, and has the inertia of a disk about that axis and none across it.
    """

    def __init__(
        self, arm, elements=2, flexible_links=True, flexible_joints=True, link_models=None, spinning_rotors=False
    ):
        """Take one value or one a link for `elements` and `flexible_links`; a list of n `LinkModel` or None."""
        n = len(arm.links)
        elements, flexible_links = np.broadcast_to(elements, n), np.broadcast_to(flexible_links, n)
        self.arm, self.n, self.spinning_rotors = arm, n, spinning_rotors
        self.axes = [np.array(joint.axis, dtype=float) for joint in arm.joints]
        self.orientations = [np.array(link.orientation, dtype=float) for link in arm.links]
        self.gravity = np.array(arm.gravity, dtype=float)
        self.beams, self.damping = [], []
        for i, (link, given) in enumerate(zip(arm.links, link_models or [LinkModel()] * n, strict=True)):
            basis = np.eye(6 * elements[i]) if given.basis is None else given.basis
            if not flexible_links[i]:
                basis, given = np.zeros((6 * elements[i], 0)), LinkModel()  # a rigid link is a beam without coordinates
            beam = beam_points(link, int(elements[i]), basis)
            self.beams.append(beam if given.stations is None else shortened(beam, given.stations, basis))
            proportional = arm.stiffness_proportional_damping * beam.K
            self.damping.append(proportional if given.damping is None else np.array(given.damping))
        self.bodies = [*self.beams, payload_points(arm.payload)]
        springs = [i for i, joint in enumerate(arm.joints) if flexible_joints and joint.stiffness is not None]
        self.motor = {joint: n + place for place, joint in enumerate(springs)}  # index of theta_m in x
        ends = n + len(springs) + np.cumsum([0] + [beam.K.shape[0] for beam in self.beams])
        self.elastic = [slice(a, b) for a, b in pairwise(ends)]  # q_i in x
        self.n_dof = int(ends[-1])

    def _motion(self, x, v, base=FIXED):
        """Compute the outward pass, Eq. 24-33: return the `LinkMotion` of every link and, last, of the tip."""
        R, E, motions = np.zeros(3), base.attitude, []
        tip_rates, tip_gamma = np.r_[np.zeros(3), base.rate], np.r_[np.zeros(3), base.acceleration]
        for i, beam in enumerate(self.beams):
            F, q, dq = self.orientations[i], x[self.elastic[i]], v[self.elastic[i]]
            A, axis = E @ rotation(self.axes[i] * x[i]) @ F, E @ self.axes[i]
            spin, zero = axis * v[i], np.zeros(3)  # Eq. 28
            gamma = np.r_[tip_gamma + np.r_[zero, skew(tip_rates[3:]) @ spin], np.zeros(q.size)]
            rates = np.r_[tip_rates + np.r_[zero, spin], dq]

            phi, dphi, W = beam.S_r @ q, beam.S_r @ dq, skew(rates[3:6])
            T, dT = tangent(phi, dphi)
            displacement, shape = beam.tip_displacement(q)
            lever, slide = A @ displacement + A[:, 0] * self.arm.links[i].length, A @ shape @ dq
            D = np.block([[np.eye(3), -skew(lever), A @ shape], [np.zeros((3, 3)), np.eye(3), A @ T @ beam.S_r]])
            motions.append(LinkMotion(R, A, axis, rates, q, D, gamma))

            tip_rates = D @ rates
            bend = A @ beam.curvature(dq)[1]
            tip_gamma = np.r_[W @ (W @ lever + 2.0 * slide) + bend, W @ A @ T @ dphi + A @ dT @ dphi]
            R, E = R + lever, A @ rotation(phi) @ F.T
        motions.append(LinkMotion(R, E, np.zeros(3), tip_rates, np.zeros(0), np.eye(6), tip_gamma))
        return motions

    @staticmethod
    def _point_matrix(beam, motion):
        """Return levers A u (P, 3) and L (P, 3, 6 + k) of Eq. 8; a mass point moves with L [R', omega, q'], Eq. 4."""
        position, shape = beam.points(motion.q)
        lever = position @ motion.A.T
        identity = np.broadcast_to(np.eye(3), (len(lever), 3, 3))
        return lever, np.concatenate([identity, -skew(lever), motion.A @ shape], axis=2)

    def _link_equation(self, i, motion, gravity):
        """Return M (6 + k, 6 + k) of Eq. 13 and Q_e + Q_v + Q_s (6 + k,) of Eq. 21 of link i; Q_e is gravity."""
        beam, W, dq = self.bodies[i], skew(motion.rates[3:6]), motion.rates[6:]
        lever, L = self._point_matrix(beam, motion)
        Q = lever @ (W @ W).T + 2.0 * L[:, :, 6:] @ dq @ W.T + beam.curvature(dq)[0] @ motion.A.T  # Eq. 10
        M = np.einsum("p,pia,pib->ab", beam.masses, L, L)
        force = np.einsum("p,pia,pi->a", beam.masses, L, gravity - Q)
        if i < self.n:
            force[6:] -= beam.K @ motion.q + self.damping[i] @ dq
        return M, force

    def _projection(self, motions):
        """Return B = D^-1 H, one column per coordinate of x, and D^-1 gamma of every link and the tip: Eq. 35-43.

        The frame of a link is clamped to its joint, so its own D_i is the identity. Columns of rotors are zero.
        """
        ends = np.cumsum([0] + [motion.gamma.size for motion in motions])
        D, H = np.eye(ends[-1]), np.zeros((ends[-1], self.n_dof))
        for i, (start, end) in enumerate(pairwise(ends)):
            if i < self.n:
                H[start + 3 : start + 6, i] = motions[i].axis
                H[start + 6 : end, self.elastic[i]] = np.eye(end - start - 6)
                D[end : end + 6, start:end] = -motions[i].D
        B, bias = np.linalg.solve(D, H), np.linalg.solve(D, np.concatenate([motion.gamma for motion in motions]))
        return [(B[start:end], bias[start:end]) for start, end in pairwise(ends)]

    def equation(self, x, v, torque, tip_force=None, base_acceleration=None, base=FIXED):
        """Return M_bar and Q_bar of Eq. 46, (n_dof, n_dof) and (n_dof,), with the joints of Eq. 23."""
        motions = self._motion(x, v, base)
        projection = self._projection(motions)
        # What rests on an accelerated base sees that acceleration as gravity the other way.
        gravity = self.gravity if base_acceleration is None else self.gravity - base.attitude @ base_acceleration
        M_bar, Q_bar = np.zeros((self.n_dof, self.n_dof)), np.zeros(self.n_dof)
        for i, (motion, (B, bias)) in enumerate(zip(motions, projection, strict=True)):
            M, force = self._link_equation(i, motion, gravity)
            M_bar += B.T @ M @ B
            Q_bar += B.T @ (force - M @ bias)
        for i, motion in enumerate(motions[: self.n]):
            inertia, force = self._rotor(i, motion, *projection[i], v)
            M_bar += inertia
            Q_bar += force + self._joint_force(i, x, v)
            Q_bar[self.motor.get(i, i)] += torque[i]
        if tip_force is not None:
            Q_bar += projection[-1][0][:3].T @ base.attitude @ tip_force
        return M_bar, Q_bar

    def _rotor(self, i, motion, B, bias, v):
        """Return inertia (n_dof, n_dof) and velocity-quadratic force (n_dof,) of rotor i; B, bias: those of link i.

        A spinning rotor has the angular momentum h axis with h = J (axis . w + theta_m'), w the angular velocity of
        what carries it. Its rate h' axis + h w x axis does work on w + axis theta_m'.
        """
        J, axis, row = self.arm.joints[i].rotor_inertia, motion.axis, np.zeros(self.n_dof)
        row[self.motor.get(i, i)] = 1.0
        if not self.spinning_rotors:
            return J * np.outer(row, row), np.zeros(self.n_dof)
        carrier = B[3:6].copy()  # B v = w + axis theta', and no other column has theta' in it
        carrier[:, i] = 0.0
        w = motion.rates[3:6] - axis * v[i]
        row += axis @ carrier
        rate = axis @ w + v[self.motor.get(i, i)]
        quadratic = axis @ bias[3:6]  # the part of it that is joint i's own, w x axis theta', is normal to the axis
        return J * np.outer(row, row), -J * (row * quadratic + rate * np.cross(w, axis) @ carrier)

    def _joint_force(self, i, x, v):
        """Return the force (n_dof,) of spring, damper and friction of joint i; friction acts on the motor."""
        joint, driven, force = self.arm.joints[i], self.motor.get(i, i), np.zeros(self.n_dof)
        if i in self.motor:
            reaction = joint.stiffness * (x[driven] - x[i]) + joint.damping * (v[driven] - v[i])
            force[i] += reaction
            force[driven] -= reaction
        viscous, coulomb = getattr(joint, "viscous_friction", 0.0), getattr(joint, "coulomb_friction", 0.0)
        force[driven] -= viscous * v[driven]
        if coulomb > 0.0:
            slip = v[driven] / joint.stribeck_rate
            static = coulomb if joint.static_friction is None else joint.static_friction
            force[driven] -= np.tanh(v[driven] / joint.coulomb_rate) * (coulomb + (static - coulomb) / (1.0 + slip**2))
        return force

    def mass_matrix(self, x):
        """Return M_bar of Eq. 46 with the rotors, (n_dof, n_dof)."""
        return self.equation(x, np.zeros(self.n_dof), np.zeros(self.n))[0]

    def acceleration(self, x, v, torque, tip_force=None, base_acceleration=None, base=FIXED):
        """Return the accelerations (n_dof,) under the motor torques (n,), N m: Eq. 45.

        A force on the tip (3,) N and an acceleration of the base (3,) m/s^2 are in the base frame. Coordinates and
        speeds are relative to the base.
        """
        return np.linalg.solve(*self.equation(x, v, torque, tip_force, base_acceleration, base))

    def driven(self, x, v, torque, prescribed, *disturbances):
        """Return accelerations (n_dof,) and motor torques (n,) for prescribed motors {joint: acceleration, rad/s^2}.

        The torques (n,) that are given hold for the other motors; where a joint is rigid its angle is its motor's.
        `disturbances` are the last arguments of `equation`.
        """
        free_torque = np.where(np.isin(np.arange(self.n), list(prescribed)), 0.0, torque)
        M, Q = self.equation(x, v, free_torque, *disturbances)
        a, held = np.zeros(self.n_dof), np.zeros(self.n_dof, dtype=bool)
        for joint, value in prescribed.items():
            a[self.motor.get(joint, joint)], held[self.motor.get(joint, joint)] = value, True
        a[~held] = np.linalg.solve(M[np.ix_(~held, ~held)], (Q - M @ a)[~held])
        needed = (M @ a - Q)[[self.motor.get(i, i) for i in range(self.n)]]
        return a, np.where(np.isin(np.arange(self.n), list(prescribed)), needed, torque)

    def tip(self, x):
        """Return the position (3,) of the tip of the last link, m."""
        return self._motion(x, np.zeros(self.n_dof))[-1].R

    def tip_velocity(self, x, v):
        """Return the velocity (3,) of the tip of the last link, m/s."""
        return self._motion(x, v)[-1].rates[:3]

    def tip_axes(self, x):
        """Return the axes (3, 3), columns, of the beam frame at the end of the last link, with its elastic rotation."""
        return self._motion(x, np.zeros(self.n_dof))[-1].A @ self.orientations[-1]

    def tip_acceleration(self, x, v, a, base=FIXED):
        """Return the acceleration (3,) of the tip less that of the base origin for accelerations a (n_dof,), Eq. 32."""
        B, bias = self._projection(self._motion(x, v, base))[-1]
        return (B @ a + bias)[:3]

    def points(self, x, v, base=FIXED):
        """Return masses (N,), positions and velocities (N, 3) of all mass points: links, then payload, Eq. 1, 4."""
        masses, positions, velocities = [], [], []
        for beam, motion in zip(self.bodies, self._motion(x, v, base), strict=True):
            lever, L = self._point_matrix(beam, motion)
            masses.append(beam.masses)
            positions.append(motion.R + lever)
            velocities.append(L @ motion.rates)
        return np.concatenate(masses), np.concatenate(positions), np.concatenate(velocities)

    def rotors(self, x, v, base=FIXED):
        """Return the axes (n, 3) of the rotors in the base frame, and their rates (n,); absolute if they spin."""
        motions = self._motion(x, v, base)[: self.n]
        axes, rates = np.array([motion.axis for motion in motions]), v[[self.motor.get(i, i) for i in range(self.n)]]
        if self.spinning_rotors:
            rates = rates + [motion.axis @ motion.rates[3:6] - v[i] for i, motion in enumerate(motions)]
        return axes, rates

    def energy(self, x, v, base=FIXED):
        """Return the kinetic (with rotors), elastic and gravitational energy (zero at the base origin), J."""
        masses, positions, velocities = self.points(x, v, base)
        _, rates = self.rotors(x, v, base)
        kinetic = 0.5 * masses @ np.sum(velocities**2, axis=1)
        elastic = sum(0.5 * x[q] @ beam.K @ x[q] for q, beam in zip(self.elastic, self.beams, strict=True))
        for i, joint in enumerate(self.arm.joints):
            kinetic += 0.5 * joint.rotor_inertia * rates[i] ** 2
            if i in self.motor:
                elastic += 0.5 * joint.stiffness * (x[self.motor[i]] - x[i]) ** 2
        return kinetic, elastic, -masses @ positions @ self.gravity

    def angular_momentum(self, x, v):
        """Return the angular momentum (3,) about the base origin, kg m^2/s: links, payload and spinning rotors.

        Without a moment of gravity, axis_1 . angular_momentum grows at the rate T_1 where rotors spin. Where they do
        not, only the first enters that balance: axis_1 . angular_momentum + J_1 theta_m1' (theta_1' where joint 1 is
        rigid) does. The others turn relative to their links and their absolute rotation is dropped (Eq. 23), so they
        neither take nor give momentum about axis_1.
        """
        masses, positions, velocities = self.points(x, v)
        momentum = masses @ np.cross(positions, velocities)
        if self.spinning_rotors:
            axes, rates = self.rotors(x, v)
            momentum += [joint.rotor_inertia for joint in self.arm.joints] * rates @ axes
        return momentum

"""Internal loads of a moving arm: joint reactions and section forces, and the energies of its parts."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from flexman_gym.common.arrays import Array
from flexman_gym.kernels import inverse
from flexman_gym.kernels.layout import make_work
from flexman_gym.model.beam import foreshortening_matrix, inboard_masses
from flexman_gym.model.element import NODE_COORDINATES, Element
from flexman_gym.model.model import Model
from flexman_gym.model.vibration import elastic_energies

FIELDS = ("reaction", "frame_acceleration", "spin", "velocity", "tip", "rotation", "payload_spin", "payload_moment",
          "payload_rotary", "tip_velocity")  # names of arrays of `kernels.layout.Work`  # fmt: skip


class FrameMotion:
    """Motion of the beam frames along a trajectory of T states; each vector is expressed in the frame of its link.

    Args:
        model: model of the arm.
        states: (T, 2 d).
        accelerations: (T, d) generalised accelerations.
        inputs: (T, n + 6), n motor torques (N m, not used), tip force (3, N) and base acceleration (3, m/s^2), all in
            the base frame; (T, n + 15) with gravity (m/s^2), angular velocity (rad/s) and angular acceleration
            (rad/s^2) of a rotating base.

    Attributes:
        model, states, accelerations: the arguments.
        reaction: (T, n + 1, 6) force (N) and moment (N m) on each link at its origin, and on the payload at the tip.
        frame_acceleration: (T, n, 6) acceleration of the origin minus the acceleration of gravity (m/s^2), and angular
            acceleration (rad/s^2).
        spin: (T, n, 3) angular velocity, rad/s.
        velocity: (T, n, 3) velocity of the origin, m/s.
        tip: (T, n, 3) position of the tip of each link relative to its origin, m.
        rotation: (T, n, 3, 3) rotation matrix from the frame of each link to the frame of the inboard link.
        payload_spin: (T, 3) angular velocity of the payload, rad/s; vectors of the payload are expressed in the frame
            of the last link.
        payload_moment: (T, 3) first moment of mass of the payload about the tip, kg m.
        payload_rotary: (T, 3, 3) rotary inertia of the payload about the tip, expressed in the frame of the last link,
            kg m^2.
        tip_velocity: (T, 3) velocity of the tip of the last link, m/s.
    """

    reaction: Array
    frame_acceleration: Array
    spin: Array
    velocity: Array
    tip: Array
    rotation: Array
    payload_spin: Array
    payload_moment: Array
    payload_rotary: Array
    tip_velocity: Array

    def __init__(self, model: Model, states: Array, accelerations: Array, inputs: Array) -> None:
        self.model, self.states, self.accelerations = model, states, accelerations
        n, d, count = model.n_joints, model.n_dof, len(states)
        work, out, records = make_work(model.constants), np.zeros(d), []
        rotates = inputs.shape[1] > n + 6
        self._gravity = inputs[:, n + 6 : n + 9] if rotates else np.tile(model.constants.gravity, (count, 1))
        for state, acceleration, row, gravity in zip(states, accelerations, inputs, self._gravity, strict=True):
            field = gravity - row[n + 3 : n + 6]
            constants = model.constants._replace(gravity=field)
            work.drive[n + 6 :] = np.concatenate([field, row[n + 9 :]]) if rotates else ()
            inverse.inertial_forces(constants, work, state[:d], state[d:], acceleration, out)
            records.append([getattr(work, name).copy() for name in FIELDS])
        shapes = {"rotation": (count, n, 3, 3), "payload_rotary": (count, 3, 3)}
        shapes |= {name: (count, 3) for name in ("payload_spin", "payload_moment", "tip_velocity")}
        for k, name in enumerate(FIELDS):
            stacked = np.array([record[k] for record in records])
            setattr(self, name, stacked.reshape(shapes.get(name, stacked.shape)))
        force, arm = inputs[:, n : n + 3], np.zeros((count, 3))
        rotations = [np.eye(3)[None].repeat(count, axis=0)]
        for i in range(n):
            rotations.append(rotations[-1] @ self.rotation[:, i])
        for i in reversed(range(n)):  # the reactions of the kernel do not include the external force on the tip
            tip_force = np.einsum("tji,tj->ti", rotations[i + 1], force)
            arm = self.tip[:, i] + (np.einsum("tij,tj->ti", self.rotation[:, i + 1], arm) if i + 1 < n else 0.0)
            self.reaction[:, i] -= np.hstack([tip_force, np.cross(arm, tip_force)])

    def section_forces(self, link: int, positions: Sequence[float]) -> Array:
        """Return force (N) and moment (N m) (T, P, 6) of the outboard part of a link on its inboard part, beam frame.

        By d'Alembert's principle they equal the inertial and gravity forces of the inboard part minus the reaction at
        the origin of the link; points have the accelerations in Eqs. (9) and (10), see `model.beam`. At a lumped mass
        the cross-section lies on the inboard side of the mass. With foreshortening the stations represent the inboard
        part.

        Args:
            link: index of the link, from 0.
            positions: (P,) distances along the link, m.
        """
        q, q_rate, q_acceleration = self._elastic(link)
        w, w_rate, root = self.spin[:, link], self.frame_acceleration[:, link, 3:], self.reaction[:, link]
        result = np.zeros((len(self.states), len(positions), 6))
        for k, position in enumerate(positions):
            inboard = _inboard_points(self.model, link, position)
            points, velocities, relative = inboard.motion(q, q_rate, q_acceleration)
            absolute = relative + self.frame_acceleration[:, None, link, :3] + _cross(w_rate, points)
            absolute += _cross(w, _cross(w, points) + 2.0 * velocities)
            forces = inboard.masses[:, None] * absolute
            section = _section_point(self.model, link, position).motion(q, q_rate, q_acceleration)[0][:, 0]
            moment = root[:, 3:] - np.cross(section, root[:, :3])
            moment -= np.cross(points - section[:, None], forces).sum(axis=1)
            twist_rate, twist_acceleration = q_rate @ inboard.twist.T, q_acceleration @ inboard.twist.T
            along = (inboard.polar * (w_rate[:, :1] + twist_acceleration)).sum(axis=1)
            across = (inboard.polar * (w[:, :1] + twist_rate)).sum(axis=1)[:, None] * np.cross(w, [1.0, 0.0, 0.0])
            moment -= across + np.outer(along, [1.0, 0.0, 0.0])
            result[:, k] = np.hstack([forces.sum(axis=1) - root[:, :3], -moment])
        return result

    def part_energies(self) -> dict[str, Array]:
        """Return the energies of each link and joint, (T, n), and of the payload, (T, 1), J, by name.

        Their sum is the total energy of the arm. Points have the velocity in Eq. (4), see `model.beam`.
        """
        model, states = self.model, self.states
        n, d, constants = model.n_joints, model.n_dof, model.constants
        kinetic, gravitational = np.zeros((2, len(states), n))
        rotation, origin = np.eye(3)[None].repeat(len(states), axis=0), np.zeros((len(states), 3))
        for i in range(n):
            points = _inboard_points(model, i)
            q, q_rate, _ = self._elastic(i)
            positions, velocities, _ = points.motion(q, q_rate, q_rate)
            velocities = velocities + self.velocity[:, None, i] + _cross(self.spin[:, i], positions)
            section_rates = self.spin[:, i, :1] + q_rate @ points.twist.T  # rad/s, about the beam axis
            kinetic[:, i] = ((velocities**2).sum(axis=2) @ points.masses + section_rates**2 @ points.polar) / 2.0
            rotation = rotation @ self.rotation[:, i]
            centre = np.einsum("p,tpi->ti", points.masses, positions)
            first_moment = points.masses.sum() * origin + np.einsum("tij,tj->ti", rotation, centre)
            gravitational[:, i] = -np.einsum("ti,ti->t", first_moment, self._gravity)
            origin = origin + np.einsum("tij,tj->ti", rotation, self.tip[:, i])
        mass, w, v = constants.payload_mass[0], self.payload_spin, self.tip_velocity
        payload_kinetic = mass * (v**2).sum(axis=1) / 2.0 + np.einsum("ti,ti->t", v, np.cross(w, self.payload_moment))
        payload_kinetic += np.einsum("ti,tij,tj->t", w, self.payload_rotary, w) / 2.0
        payload_first_moment = mass * origin + np.einsum("tij,tj->ti", rotation, self.payload_moment)
        motor_rates = states[:, d + model.motor_columns]
        # rad/s; angular velocity of the inboard link, which carries the rotor, about the joint axis
        carrier_rates = np.einsum("tni,ni->tn", self.spin, constants.axis) - states[:, d : d + n]
        rotors = constants.rotor_inertia * (motor_rates + carrier_rates * (constants.carried_inertia > 0.0)) ** 2 / 2.0
        elastic = elastic_energies(model, states[:, :d]) / 2.0
        return {
            "link_kinetic": kinetic, "link_elastic": elastic[:, :n], "link_gravitational": gravitational,
            "rotor_kinetic": rotors, "joint_elastic": elastic[:, n:],
            "payload_kinetic": payload_kinetic[:, None],
            "payload_gravitational": -np.einsum("ti,ti->t", payload_first_moment, self._gravity)[:, None],
        }  # fmt: skip

    def _elastic(self, link: int) -> tuple[Array, Array, Array]:
        """Return elastic coordinates of a link, their speeds and their accelerations, (T, k) each."""
        columns, d = self.model.elastic_columns(link), self.model.n_dof
        return self.states[:, columns], self.states[:, d:][:, columns], self.accelerations[:, columns]


class _Points(NamedTuple):
    """Mass points of a link with k elastic coordinates.

    Attributes:
        masses: (p,) kg.
        positions: (p, 3) positions in the undeformed link, m.
        shapes: (p, 3, k) displacement per unit coordinate.
        shortening: (p, k, k) foreshortening matrices G, 1/m.
        polar: (t,) moments of inertia of cross-sections about the beam axis, kg m^2.
        twist: (t, k) rotation of these cross-sections about the beam axis per unit coordinate.
    """

    masses: Array
    positions: Array
    shapes: Array
    shortening: Array
    polar: Array
    twist: Array

    def reduced(self, basis: Array) -> "_Points":
        """Return the points in reduced coordinates p, with q = basis @ p."""
        shortening = basis.T @ self.shortening @ basis
        return self._replace(shapes=self.shapes @ basis, shortening=shortening, twist=self.twist @ basis)

    def motion(self, q: Array, q_rate: Array, q_acceleration: Array) -> tuple[Array, Array, Array]:
        """Return positions (m), velocities (m/s) and accelerations (m/s^2) (T, p, 3) relative to the beam frame.

        Args:
            q: (T, k) elastic coordinates.
            q_rate: (T, k) their time derivatives.
            q_acceleration: (T, k) their second time derivatives.
        """
        displacement, velocities, accelerations = (
            np.einsum("pik,tk->tpi", self.shapes, each) for each in (q, q_rate, q_acceleration)
        )
        gradient = np.einsum("pab,tb->tpa", self.shortening, q)  # gradient of the foreshortening
        displacement[..., 0] -= np.einsum("tpa,ta->tp", gradient, q) / 2.0
        velocities[..., 0] -= np.einsum("tpa,ta->tp", gradient, q_rate)
        quadratic = np.einsum("ta,pab,tb->tp", q_rate, self.shortening, q_rate)
        accelerations[..., 0] -= np.einsum("tpa,ta->tp", gradient, q_acceleration) + quadratic
        return self.positions + displacement, velocities, accelerations


def _inboard_points(model: Model, link: int, position: float = np.inf) -> _Points:
    """Return the mass points of a link inboard of a position (m); a lumped mass at the position is left out."""
    elements = model.elements(link)
    size = NODE_COORDINATES * (len(elements) + 1)
    (masses, positions, shapes), (polar, twist), (shortening, stations, station_shapes) = inboard_masses(
        model.arm.links[link], elements, model.choice.rotary_inertia, model.choice.stiffening, position
    )
    matrices = np.zeros((len(masses), size, size))
    # negative masses remove the contribution of the stations, which is added again with foreshortening
    masses = np.r_[masses, -stations[:, 0], stations[:, 0]]
    positions = np.concatenate([positions, stations[:, 1:], stations[:, 1:]])
    shapes = np.concatenate([shapes, station_shapes, station_shapes])
    matrices = np.concatenate([matrices, 0.0 * shortening, shortening])
    return _Points(masses, positions, shapes, matrices, polar, twist).reduced(model.node_basis(link))


def _section_point(model: Model, link: int, position: float) -> _Points:
    """Return the massless point on the centreline of a link at a position (m)."""
    elements = model.elements(link)
    size = NODE_COORDINATES * (len(elements) + 1)
    element, xi = Element.find(elements, position)
    shapes = np.zeros((1, 3, size))
    shapes[0][:, element.nodes] = element.shapes(xi)
    shortening = foreshortening_matrix(position, elements, size)[None] * model.choice.stiffening
    point, no_twist = np.array([[position, 0.0, 0.0]]), np.zeros((0, size))
    return _Points(np.zeros(1), point, shapes, shortening, np.zeros(0), no_twist).reduced(model.node_basis(link))


def _cross(vector: Array, points: Array) -> Array:
    """Return the cross products (T, p, 3) of a vector (T, 3) with the vectors of p points (T, p, 3)."""
    return np.cross(vector[:, None], points)

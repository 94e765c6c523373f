"""Internal loads of a moving arm: joint reactions, section forces and the energies of its parts."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from flexman_gym.common.arrays import Array
from flexman_gym.kernels import inverse
from flexman_gym.kernels.layout import make_work
from flexman_gym.model.beam import foreshortening_matrix, link_points, link_stations
from flexman_gym.model.element import NODE_COORDINATES, beam_shapes, find_element
from flexman_gym.model.model import Model
from flexman_gym.model.vibration import elastic_energies

FIELDS = ("reaction", "frame_acceleration", "spin", "velocity", "tip", "rotation", "payload_spin", "payload_moment",
          "payload_rotary", "tip_velocity")  # fmt: skip


class FrameMotion(NamedTuple):
    """Motion of the link frames at T instants; every vector in the frame of its link.

    Attributes:
        reaction: (T, n + 1, 6) force and moment on each link at its origin, and on the payload at the last tip.
        frame_acceleration: (T, n, 6) acceleration of the origins, with gravity as an upward acceleration, and angular
            acceleration.
        spin: (T, n, 3) angular velocity.
        velocity: (T, n, 3) velocity of the origin.
        tip: (T, n, 3) tip of each link relative to its origin.
        rotation: (T, n, 3, 3) rotation to the frame of the previous link.
        payload_spin: (T, 3) see `kernels.layout.Work`, as for the next three.
        payload_moment: (T, 3)
        payload_rotary: (T, 3, 3)
        tip_velocity: (T, 3)
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


def frame_motion(model: Model, states: Array, rates: Array, drives: Array) -> FrameMotion:
    """Return the motion of the link frames along a trajectory.

    Args:
        model: model of the arm.
        states: (T, 2 d).
        rates: (T, d) accelerations.
        drives: (T, n + 6); the force on the tip (N) and the acceleration of the base (m/s^2) are used.
    """
    n, d, times = model.n_joints, model.n_dof, len(states)
    work, out, records = make_work(model.constants), np.zeros(d), []
    for state, rate, drive in zip(states, rates, drives, strict=True):
        constants = model.constants._replace(gravity=model.constants.gravity - drive[n + 3 :])
        inverse.inertial_forces(constants, work, state[:d], state[d:], rate, out)
        records.append([getattr(work, name).copy() for name in FIELDS])
    shapes = {"rotation": (times, n, 3, 3), "payload_rotary": (times, 3, 3)}
    shapes |= {name: (times, 3) for name in ("payload_spin", "payload_moment", "tip_velocity")}
    stacked = {name: np.array([row[k] for row in records]) for k, name in enumerate(FIELDS)}
    result = FrameMotion(**{name: each.reshape(shapes.get(name, each.shape)) for name, each in stacked.items()})
    force, arm = drives[:, n : n + 3], np.zeros((times, 3))
    rotations = [np.eye(3)[None].repeat(times, axis=0)]
    for i in range(n):
        rotations.append(rotations[-1] @ result.rotation[:, i])
    for i in reversed(range(n)):  # the reactions above leave out the external force on the tip
        own = np.einsum("tji,tj->ti", rotations[i + 1], force)
        arm = result.tip[:, i] + (np.einsum("tij,tj->ti", result.rotation[:, i + 1], arm) if i + 1 < n else 0.0)
        result.reaction[:, i] -= np.hstack([own, np.cross(arm, own)])
    return result


def section_forces(
    model: Model, motion: FrameMotion, states: Array, rates: Array, link: int, positions: Sequence[float]
) -> Array:
    """Return force and moment (T, P, 6), in N and N m, of the outboard part of a link on its inboard part.

    They are the inertial and gravity forces of the inboard part minus the reaction at the origin of the link
    (d'Alembert), so that the balance is exact. At a lumped mass the inboard side of the section is used. With
    foreshortening the inboard part is represented by the stations.

    Args:
        model: model of the arm.
        motion: result of `frame_motion`.
        states: (T, 2 d) as for `frame_motion`.
        rates: (T, d) accelerations.
        link: index from 0.
        positions: (P,) along the link, m.
    """
    q, speed, rate = _elastic(model, link, states, rates)
    w, turning = motion.spin[:, link], motion.frame_acceleration[:, link, 3:]
    root = motion.reaction[:, link]
    result = np.zeros((len(states), len(positions), 6))
    for k, position in enumerate(positions):
        inboard = _points(model, link, position)
        place, velocities, accelerations = inboard.motion(q, speed, rate)
        accelerations = accelerations + motion.frame_acceleration[:, None, link, :3] + _cross(turning, place)
        accelerations += _cross(w, _cross(w, place) + 2.0 * velocities)
        forces = inboard.masses[:, None] * accelerations
        at = _section(model, link, position).motion(q, speed, rate)[0][:, 0]
        moment = root[:, 3:] - np.cross(at, root[:, :3]) - np.cross(place - at[:, None], forces).sum(axis=1)
        twisting, twisted = rate @ inboard.twist.T, speed @ inboard.twist.T
        about = (inboard.polar * (turning[:, :1] + twisting)).sum(axis=1)
        across = (inboard.polar * (w[:, :1] + twisted)).sum(axis=1)[:, None] * np.cross(w, [1.0, 0.0, 0.0])
        moment -= across + np.outer(about, [1.0, 0.0, 0.0])
        result[:, k] = np.hstack([forces.sum(axis=1) - root[:, :3], -moment])
    return result


def part_energies(model: Model, motion: FrameMotion, states: Array) -> dict[str, Array]:
    """Return the energies of links and joints, (T, n), and of the payload, (T, 1), in J, by name.

    Their sum is the energy of the arm.

    Args:
        model: model of the arm.
        motion: result of `frame_motion`.
        states: (T, 2 d) as for `frame_motion`.
    """
    n, d, constants = model.n_joints, model.n_dof, model.constants
    kinetic, height = np.zeros((2, len(states), n))
    rotation, origin = np.eye(3)[None].repeat(len(states), axis=0), np.zeros((len(states), 3))
    for i in range(n):
        points = _points(model, i)
        q, speed, _ = _elastic(model, i, states, states[:, d:])
        place, velocities, _ = points.motion(q, speed, speed)
        velocities = velocities + motion.velocity[:, None, i] + _cross(motion.spin[:, i], place)
        twisted = motion.spin[:, i, :1] + speed @ points.twist.T
        kinetic[:, i] = ((velocities**2).sum(axis=2) @ points.masses + twisted**2 @ points.polar) / 2.0
        rotation = rotation @ motion.rotation[:, i]
        centre = np.einsum("p,tpi->ti", points.masses, place)
        first_moment = points.masses.sum() * origin + np.einsum("tij,tj->ti", rotation, centre)
        height[:, i] = -first_moment @ constants.gravity
        origin = origin + np.einsum("tij,tj->ti", rotation, motion.tip[:, i])
    mass, w, v = constants.payload_mass[0], motion.payload_spin, motion.tip_velocity
    payload_kinetic = mass * (v**2).sum(axis=1) / 2.0 + np.einsum("ti,ti->t", v, np.cross(w, motion.payload_moment))
    payload_kinetic += np.einsum("ti,tij,tj->t", w, motion.payload_rotary, w) / 2.0
    payload_first_moment = mass * origin + np.einsum("tij,tj->ti", rotation, motion.payload_moment)
    motors = states[:, d + model.motor_columns]
    # spin, about the axis of each joint, of the body that carries its rotor
    carriers = np.einsum("tni,ni->tn", motion.spin, constants.axis) - states[:, d : d + n]
    rotors = constants.rotor_inertia * (motors + carriers * (constants.carried_inertia > 0.0)) ** 2 / 2.0
    elastic = elastic_energies(model, states[:, :d]) / 2.0
    return {
        "link_kinetic": kinetic, "link_elastic": elastic[:, :n], "link_gravitational": height,
        "rotor_kinetic": rotors, "joint_elastic": elastic[:, n:],
        "payload_kinetic": payload_kinetic[:, None],
        "payload_gravitational": -(payload_first_moment @ constants.gravity)[:, None],
    }  # fmt: skip


class _Points(NamedTuple):
    """Points of a link with k elastic coordinates.

    Attributes:
        masses: (p,) kg.
        places: (p, 3) undeformed positions, m.
        shapes: (p, 3, k) displacement per unit coordinate.
        shortening: (p, k, k) foreshortening matrices G.
        polar: (t,) polar inertias of sections, kg m^2.
        twist: (t, k) rotation of these sections about the beam axis per unit coordinate.
    """

    masses: Array
    places: Array
    shapes: Array
    shortening: Array
    polar: Array
    twist: Array

    def reduced(self, basis: Array) -> "_Points":
        """Return the same points in the coordinates p with q = basis @ p."""
        shortening = basis.T @ self.shortening @ basis
        return self._replace(shapes=self.shapes @ basis, shortening=shortening, twist=self.twist @ basis)

    def motion(self, q: Array, speed: Array, rate: Array) -> tuple[Array, Array, Array]:
        """Return positions, velocities and accelerations (T, p, 3) in the frame of the link.

        Args:
            q: (T, k) elastic coordinates.
            speed: (T, k) their rates.
            rate: (T, k) their second derivatives.
        """
        displacement, velocities, accelerations = (
            np.einsum("pik,tk->tpi", self.shapes, each) for each in (q, speed, rate)
        )
        bend = np.einsum("pab,tb->tpa", self.shortening, q)
        displacement[..., 0] -= np.einsum("tpa,ta->tp", bend, q) / 2.0
        velocities[..., 0] -= np.einsum("tpa,ta->tp", bend, speed)
        quadratic = np.einsum("ta,pab,tb->tp", speed, self.shortening, speed)
        accelerations[..., 0] -= np.einsum("tpa,ta->tp", bend, rate) + quadratic
        return self.places + displacement, velocities, accelerations


def _points(model: Model, link: int, until: float = np.inf) -> _Points:
    """Return the points of a link inboard of a position (m); a body there is outboard."""
    beam_link, pieces = model.arm.links[link], model.elements(link)
    size = NODE_COORDINATES * (len(pieces) + 1)
    (masses, places, shapes), (polar, twist) = link_points(beam_link, pieces, model.choice.rotary_inertia, until)
    matrices = np.zeros((len(masses), size, size))
    if model.choice.stiffening:
        # remove the motion of the stations, and add it again with foreshortening
        shortening, stations, station_shapes = link_stations(beam_link, pieces, until)
        masses = np.r_[masses, -stations[:, 0], stations[:, 0]]
        places = np.concatenate([places, stations[:, 1:], stations[:, 1:]])
        shapes = np.concatenate([shapes, station_shapes, station_shapes])
        matrices = np.concatenate([matrices, 0.0 * shortening, shortening])
    return _Points(masses, places, shapes, matrices, polar, twist).reduced(_basis(model, link, size))


def _section(model: Model, link: int, position: float) -> _Points:
    """Return the massless point of the centreline of a link at a position (m)."""
    pieces = model.elements(link)
    size = NODE_COORDINATES * (len(pieces) + 1)
    element, xi = find_element(pieces, position)
    shapes = np.zeros((1, 3, size))
    shapes[0][:, element.nodes] = beam_shapes(xi, element.length, 0.0, 0.0)
    shortening = foreshortening_matrix(position, pieces, size)[None] * model.choice.stiffening
    at, none = np.array([[position, 0.0, 0.0]]), np.zeros((0, size))
    return _Points(np.zeros(1), at, shapes, shortening, np.zeros(0), none).reduced(_basis(model, link, size))


def _basis(model: Model, link: int, size: int) -> Array:
    """Return all node coordinates (size, k) of a link, clamped ones included, per unit of its elastic coordinates."""
    own = model.bases[link]
    return np.vstack([np.zeros((size - len(own), own.shape[1])), own])


def _elastic(model: Model, link: int, states: Array, rates: Array) -> tuple[Array, Array, Array]:
    """Return elastic coordinates, speeds and accelerations (T, k) of a link."""
    columns, d = model.elastic_columns(link), model.n_dof
    return states[:, columns], states[:, d:][:, columns], rates[:, columns]


def _cross(turn: Array, places: Array) -> Array:
    """Return the cross products (T, p, 3) of (T, 3) with (T, p, 3)."""
    return np.cross(turn[:, None], places)

"""Loads: what joints and sections carry while an arm moves, and the energies of its parts."""

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
    """How the links move at T instants; every vector in the frame of its link.

    Attributes:
        reaction: (T, n + 1, 6) force and moment that each link needs at its origin, and the payload at the last tip.
        frame_acceleration: (T, n, 6) of the origins, gravity as an upward acceleration, and angular.
        spin, velocity: (T, n, 3) angular velocity, and velocity of the origin.
        tip: (T, n, 3) of each link from its origin.
        rotation: (T, n, 3, 3) to the frame of the link before.
        payload_spin, payload_moment, tip_velocity: (T, 3), and payload_rotary (T, 3, 3), see `kernels.layout.Work`.
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
    """Gives the motion of the links.

    Args:
        model: the model.
        states: (T, 2 d).
        rates: (T, d) accelerations.
        drives: (T, n + 6), of which the force on the tip (N) and the acceleration of the base (m/s^2) are used.
    """
    n, d, times = model.n_joints, model.n_dof, len(states)
    work, out, seen = make_work(model.constants), np.zeros(d), []
    for state, rate, drive in zip(states, rates, drives, strict=True):
        constants = model.constants._replace(gravity=model.constants.gravity - drive[n + 3 :])
        inverse.inertial_forces(constants, work, state[:d], state[d:], rate, out)
        seen.append([getattr(work, name).copy() for name in FIELDS])
    shapes = {"rotation": (times, n, 3, 3), "payload_rotary": (times, 3, 3)}
    shapes |= {name: (times, 3) for name in ("payload_spin", "payload_moment", "tip_velocity")}
    stacked = {name: np.array([row[k] for row in seen]) for k, name in enumerate(FIELDS)}
    result = FrameMotion(**{name: each.reshape(shapes.get(name, each.shape)) for name, each in stacked.items()})
    force, arm = drives[:, n : n + 3], np.zeros((times, 3))
    turned = [np.eye(3)[None].repeat(times, axis=0)]
    for i in range(n):
        turned.append(turned[-1] @ result.rotation[:, i])
    for i in reversed(range(n)):  # what pushes the tip need not come through the links
        own = np.einsum("tji,tj->ti", turned[i + 1], force)
        arm = result.tip[:, i] + (np.einsum("tij,tj->ti", result.rotation[:, i + 1], arm) if i + 1 < n else 0.0)
        result.reaction[:, i] -= np.hstack([own, np.cross(arm, own)])
    return result


def section_forces(
    model: Model, motion: FrameMotion, states: Array, rates: Array, link: int, positions: Sequence[float]
) -> Array:
    """Gives force and moment (T, P, 6) with which the outboard part of a link acts on the inboard part.

    It is what the inboard part takes less what the link needs at its origin (d'Alembert), so that it balances exactly.
    At a lumped mass it is the inboard side. With foreshortening the inboard part is that of the stations.

    Args:
        model: as of `frame_motion`.
        motion: result of `frame_motion`.
        states: as of `frame_motion`.
        rates: as of `frame_motion`.
        link: counted from 0.
        positions: (P,) along the link, m.
    """
    q, speed, rate = _elastic(model, link, states, rates)
    w, turning = motion.spin[:, link], motion.frame_acceleration[:, link, 3:]
    root = motion.reaction[:, link]
    result = np.zeros((len(states), len(positions), 6))
    for k, position in enumerate(positions):
        inboard = _points(model, link, position)
        place, moves, gains = inboard.moved(q, speed, rate)
        gains = gains + motion.frame_acceleration[:, None, link, :3] + _cross(turning, place)
        gains += _cross(w, _cross(w, place) + 2.0 * moves)
        forces = inboard.masses[:, None] * gains
        at = _section(model, link, position).moved(q, speed, rate)[0][:, 0]
        moment = root[:, 3:] - np.cross(at, root[:, :3]) - np.cross(place - at[:, None], forces).sum(axis=1)
        twisting, twisted = rate @ inboard.twist.T, speed @ inboard.twist.T
        about = (inboard.polar * (turning[:, :1] + twisting)).sum(axis=1)
        across = (inboard.polar * (w[:, :1] + twisted)).sum(axis=1)[:, None] * np.cross(w, [1.0, 0.0, 0.0])
        moment -= across + np.outer(about, [1.0, 0.0, 0.0])
        result[:, k] = np.hstack([forces.sum(axis=1) - root[:, :3], -moment])
    return result


def part_energies(model: Model, motion: FrameMotion, states: Array) -> dict[str, Array]:
    """Gives energies (T, n) of links and joints, and (T, 1) of the payload, J, by name; their sum is that of the arm.

    Args:
        model: as of `frame_motion`.
        motion: result of `frame_motion`.
        states: as of `frame_motion`.
    """
    n, d, constants = model.n_joints, model.n_dof, model.constants
    kinetic, height = np.zeros((2, len(states), n))
    turned, origin = np.eye(3)[None].repeat(len(states), axis=0), np.zeros((len(states), 3))
    for i in range(n):
        points = _points(model, i)
        q, speed, _ = _elastic(model, i, states, states[:, d:])
        place, moves, _ = points.moved(q, speed, speed)
        moves = moves + motion.velocity[:, None, i] + _cross(motion.spin[:, i], place)
        twisted = motion.spin[:, i, :1] + speed @ points.twist.T
        kinetic[:, i] = ((moves**2).sum(axis=2) @ points.masses + twisted**2 @ points.polar) / 2.0
        turned = turned @ motion.rotation[:, i]
        centre = np.einsum("p,tpi->ti", points.masses, place)
        raised = points.masses.sum() * origin + np.einsum("tij,tj->ti", turned, centre)
        height[:, i] = -raised @ constants.gravity
        origin = origin + np.einsum("tij,tj->ti", turned, motion.tip[:, i])
    mass, w, v = constants.payload_mass[0], motion.payload_spin, motion.tip_velocity
    carried = mass * (v**2).sum(axis=1) / 2.0 + np.einsum("ti,ti->t", v, np.cross(w, motion.payload_moment))
    carried += np.einsum("ti,tij,tj->t", w, motion.payload_rotary, w) / 2.0
    hung = mass * origin + np.einsum("tij,tj->ti", turned, motion.payload_moment)
    motors = states[:, d + model.motor_columns]
    axes = np.einsum("tni,ni->tn", motion.spin, constants.axis) - states[:, d : d + n]  # of what carries the rotors
    rotors = constants.rotor_inertia * (motors + axes * (constants.carried_inertia > 0.0)) ** 2 / 2.0
    bent = elastic_energies(model, states[:, :d]) / 2.0
    return {
        "link_kinetic": kinetic, "link_elastic": bent[:, :n], "link_gravitational": height,
        "rotor_kinetic": rotors, "joint_elastic": bent[:, n:],
        "payload_kinetic": carried[:, None], "payload_gravitational": -(hung @ constants.gravity)[:, None],
    }  # fmt: skip


class _Points(NamedTuple):
    """Points of a link: masses (p,), places (p, 3), shapes (p, 3, k), G (p, k, k); polar (t,) and twist (t, k)."""

    masses: Array
    places: Array
    shapes: Array
    drawn: Array
    polar: Array
    twist: Array

    def reduced(self, basis: Array) -> "_Points":
        """Gives the same points in the coordinates p with q = basis @ p."""
        drawn = basis.T @ self.drawn @ basis
        return self._replace(shapes=self.shapes @ basis, drawn=drawn, twist=self.twist @ basis)

    def moved(self, q: Array, speed: Array, rate: Array) -> tuple[Array, Array, Array]:
        """Gives places, velocities and accelerations (T, p, 3) in the frame of the link, for elastic ones (T, k)."""
        place, moves, gains = (np.einsum("pik,tk->tpi", self.shapes, each) for each in (q, speed, rate))
        bend = np.einsum("pab,tb->tpa", self.drawn, q)
        place[..., 0] -= np.einsum("tpa,ta->tp", bend, q) / 2.0
        moves[..., 0] -= np.einsum("tpa,ta->tp", bend, speed)
        gains[..., 0] -= np.einsum("tpa,ta->tp", bend, rate) + np.einsum("ta,pab,tb->tp", speed, self.drawn, speed)
        return self.places + place, moves, gains


def _points(model: Model, link: int, until: float = np.inf) -> _Points:
    """Gives the points of a link inboard of a position, m; a body there is outboard."""
    whole, pieces = model.arm.links[link], model.elements(link)
    size = NODE_COORDINATES * (len(pieces) + 1)
    (masses, places, shapes), (polar, twist) = link_points(whole, pieces, model.choice.rotary_inertia, until)
    drawn = np.zeros((len(masses), size, size))
    if model.choice.stiffening:
        # the motion of stations is taken out, and put back with foreshortening
        drawing, stations, moved = link_stations(whole, pieces, until)
        masses = np.r_[masses, -stations[:, 0], stations[:, 0]]
        places = np.concatenate([places, stations[:, 1:], stations[:, 1:]])
        shapes = np.concatenate([shapes, moved, moved])
        drawn = np.concatenate([drawn, 0.0 * drawing, drawing])
    return _Points(masses, places, shapes, drawn, polar, twist).reduced(_basis(model, link, size))


def _section(model: Model, link: int, position: float) -> _Points:
    """Gives the point of the centreline of a link at a position, without mass."""
    pieces = model.elements(link)
    size = NODE_COORDINATES * (len(pieces) + 1)
    element, xi = find_element(pieces, position)
    shapes = np.zeros((1, 3, size))
    shapes[0][:, element.nodes] = beam_shapes(xi, element.length, 0.0, 0.0)
    drawn = foreshortening_matrix(position, pieces, size)[None] * model.choice.stiffening
    at, none = np.array([[position, 0.0, 0.0]]), np.zeros((0, size))
    return _Points(np.zeros(1), at, shapes, drawn, np.zeros(0), none).reduced(_basis(model, link, size))


def _basis(model: Model, link: int, size: int) -> Array:
    """Gives the node coordinates (size, k) of a link, the clamped ones too, per unit of its elastic coordinates."""
    own = model.bases[link]
    return np.vstack([np.zeros((size - len(own), own.shape[1])), own])


def _elastic(model: Model, link: int, states: Array, rates: Array) -> tuple[Array, Array, Array]:
    """Gives elastic coordinates, speeds and accelerations (T, k) of a link."""
    columns, d = model.elastic_columns(link), model.n_dof
    return states[:, columns], states[:, d:][:, columns], rates[:, columns]


def _cross(turn: Array, places: Array) -> Array:
    """Gives the cross products (T, p, 3) of (T, 3) with (T, p, 3)."""
    return np.cross(turn[:, None], places)

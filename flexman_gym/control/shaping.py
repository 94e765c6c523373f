"""Shaping: actions that shape the reference of a tracking controller; an action of 0 is the controller."""

from collections.abc import Mapping

import numpy as np

from flexman_gym.arrays import Array, Flags, IntArray
from flexman_gym.checks import non_negative, refusal
from flexman_gym.control.controller import Controller, Episode, Readings
from flexman_gym.control.feedback import OutputFeedback
from flexman_gym.control.observer import Estimate
from flexman_gym.control.plant import Plant
from flexman_gym.control.shape import Authority, Shape
from flexman_gym.simulation.readings import Readings as Quantities

DEPARTURE, ANGLE = 1.0 / 30.0, 0.01  # of a range, and rad: up to where departures and errors of angles are small
LARGEST = 100.0  # number that is shown


class Shaping:
    """Pace of the reference, offsets of its joints and torques beside the law, on what the base estimates.

    It shows the agent what the base knows: the state by quantities, their departures from the reference as arcsinh,
    errors of the motors, the reference, its clock and its shape, the last torques and actions, payload and stiffness.

    Args:
        plant: the arm.
        base: an observer and a law that tracks references.
        authority: pace, offset, torque and fading, see `Authority`.

    Raises:
        ValueError: one line with field, value and what is allowed.
    """

    def __init__(self, plant: Plant, base: Controller | None, **authority: object) -> None:
        if not isinstance(base, OutputFeedback):
            allowed = "torque, or it with a base that has an observer and tracks: adaptive-lqr, lqg or privileged-lqr"
            raise refusal("actions", "shaping", allowed)
        self._base, self._law, self._plant = base, base.law, plant
        far = Authority(**{name: non_negative(f"actions.{name}", value) for name, value in authority.items()})
        self.strength = far.torque if far.fading == 0.0 else None
        n = self.joints = len(plant.torque_limit)
        self._shape = self._law.shape = Shape(self._law.slews, self._law.limits, plant.period, far)
        every = ("pace", *(f"{part}_{joint + 1}" for part in ("offset", "torque") for joint in range(n)))
        self._columns = np.flatnonzero(np.repeat([far.pace, far.offset, far.torque], [1, n, n]) > 0.0)
        self.names = tuple(every[column] for column in self._columns)
        self.sensors: tuple[object, ...] = tuple(base.sensors)
        self._quantities = Quantities(plant.model)
        self._ranges = np.concatenate([plant.measured()[name][0] for name in self._quantities.places])
        sizes = {"estimate": 8 * n, "departures": 8 * n, "angle_errors": 2 * n, "reference": 2 * n, "way": 3 * n}
        sizes |= {"clock": 6, "offsets": 2 * n, "applied": n, "action": len(self.names)}
        sizes |= {"parameters": 1 + 2 * n, "deviations": 1 + 2 * n}
        self.shown: Mapping[str, int] = sizes
        self._seen = np.zeros((0, sum(sizes.values())))

    def reset(self, arms: IntArray, episode: Episode) -> None:
        """Starts new episodes of the arms (r,).

        Raises:
            ValueError: for a goal that moves.
        """
        if episode.reference is not None:
            raise refusal("actions", "shaping", "torque: the goal of this task moves, and slews alone can be shaped")
        self._shape.reset(arms)
        self._base.reset(arms, episode)

    def act(self, actions: Array, readings: Readings, applied: Array, playing: Flags) -> Array:
        """Gives what the motors (b, n) are asked for, parts of the torque limits."""
        arms = np.flatnonzero(playing)
        self._shape.wanted[arms[:, None], self._columns] = actions[arms]
        return self._base.act(readings, applied, playing)

    def look(self, readings: Readings, applied: Array, playing: Flags) -> Array:
        """Gives what it shows of all arms, (b, sum of the sizes in `shown`), anew of those that are playing (b,)."""
        if len(self._seen) < len(playing):
            self._seen = np.zeros((len(playing), self._seen.shape[1]))
        if playing.any():
            estimate, arms = self._base.look(readings, applied, playing), np.flatnonzero(playing)
            self._law.plan(estimate, playing)
            shown = np.concatenate(list(self._parts(estimate, applied, arms).values()), axis=1)
            self._seen[arms] = np.clip(np.nan_to_num(shown), -LARGEST, LARGEST)
        return self._seen

    def _parts(self, estimate: Estimate, applied: Array, arms: IntArray) -> dict[str, Array]:
        """What is shown of the arms (r,), by name."""
        law, slews, model, d = self._law, self._law.slews, self._plant.model, self._plant.model.n_dof
        states, reference, now = estimate.states[arms], law.reference(estimate, arms), law.clock(estimate, arms)
        motors, (place, speed, change) = model.motor_columns, slews.at(now, arms)
        way, left = slews.way[arms], slews.begun[arms] + slews.lasting[arms] - now
        errors = slews.start[arms] + way + slews.shift[arms] - states[:, motors]
        departures = np.arcsinh(self._read(states - reference) / (DEPARTURE * self._ranges))
        ways = [way * (1.0 - place)[:, None], way * speed[:, None], way * change[:, None]]
        clock = [place, speed, change, np.maximum(left, 0.0), slews.pace[arms], slews.begun[arms] + slews.lasting[arms]]
        return {
            "estimate": self._read(states),
            "departures": departures,
            "angle_errors": np.concatenate([errors, np.arcsinh(errors / ANGLE)], axis=1),
            "reference": np.concatenate([reference[:, motors], reference[:, d + motors]], axis=1),
            "way": np.concatenate(ways, axis=1),
            "clock": np.stack(clock, axis=1),
            "offsets": self._shape.offsets[arms].reshape(len(arms), 2 * self.joints),
            "applied": applied[arms],
            "action": self._shape.wanted[arms][:, self._columns],
            "parameters": self._parameters(estimate, arms),
            "deviations": self._deviations(arms),
        }

    def _read(self, states: Array) -> Array:
        """The quantities (r, 8 n) of states (r, 2 d)."""
        named = self._quantities.named(states)
        return np.concatenate([named[name] for name in self._quantities.places], axis=1)

    def _parameters(self, estimate: Estimate, arms: IntArray) -> Array:
        """Payload (kg), and stiffness of joints and links as parts of the nominal one, (r, 1 + 2 n)."""
        constants, known = self._plant.model.constants, estimate.parameters
        stiffness = np.where(constants.motor >= 0, constants.joint_stiffness, 1.0)
        ones = np.ones((len(arms), self.joints))
        payload = known["payload_mass"][arms] if "payload_mass" in known else constants.payload_mass[0] * ones[:, 0]
        joints = known["joint_stiffness"][arms] / stiffness if "joint_stiffness" in known else ones
        links = known["link_stiffness"][arms] if "link_stiffness" in known else ones
        return np.concatenate([payload[:, None], joints, links], axis=1)

    def _deviations(self, arms: IntArray) -> Array:
        """Standard deviations of these, (r, 1 + 2 n), 0 of what is known, as of joints that are rigid."""
        constants, said = self._plant.model.constants, self._base.estimates
        result, n = np.zeros((len(arms), 1 + 2 * self.joints)), self.joints
        if "payload_mass_deviation" in said:
            result[:, 0] = said["payload_mass_deviation"][arms]
        if "joint_stiffness_deviation" in said:
            flexible = constants.motor >= 0
            part = said["joint_stiffness_deviation"][arms] / constants.joint_stiffness[flexible]
            result[:, 1 : 1 + n][:, flexible] = part
        if "link_stiffness_deviation" in said:
            result[:, 1 + n :] = said["link_stiffness_deviation"][arms]
        return result

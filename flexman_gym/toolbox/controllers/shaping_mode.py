"""Action mode of reference shaping: an agent changes the reference of its base controller."""

from collections.abc import Mapping

import numpy as np

from flexman_gym.agent.action_modes import MAX_OBSERVATION
from flexman_gym.agent.controller import Controller, EpisodeInfo, Plant, Readings
from flexman_gym.common.arrays import Array, BoolArray, IntArray
from flexman_gym.common.checks import non_negative
from flexman_gym.common.errors import value_error
from flexman_gym.model.linearization import LinearMeasurements
from flexman_gym.toolbox.controllers.observers.observer import Estimate
from flexman_gym.toolbox.controllers.output_feedback import OutputFeedback
from flexman_gym.toolbox.controllers.reference_shaping import ReferenceShaping, ShapingLimits
from flexman_gym.toolbox.controllers.replanned_tracking import ReplannedTracking

DEVIATION_SCALE = 1.0 / 30.0  # fraction of a range; deviation from the reference with an arcsinh of 0.88
ANGLE_SCALE = 0.01  # rad; error of a motor angle with an arcsinh of 0.88


class ReferenceShapingMode:
    """Action mode of reference shaping: time scaling and joint offsets of the base reference, and added torques.

    The mode adds to the observation: measured quantities of the estimated state, arcsinh of their deviations from the
    reference, errors of motor angles, the reference with its clock and its shaping, the last torques and actions, and
    the estimates of payload and stiffness with their standard deviations.

    Args:
        plant: plant model.
        base: OutputFeedback with an observer and a tracking law.
        **authority: "pace", "offset", "torque" and "fading", see `ShapingLimits`.
    """

    def __init__(self, plant: Plant, base: Controller | None, **authority: object) -> None:
        if not isinstance(base, OutputFeedback) or isinstance(base.law, ReplannedTracking):
            allowed = "torque, or shaping with a base that estimates and tracks: adaptive-lqr, lqg or privileged-lqr"
            raise value_error("actions", "shaping", allowed)
        self._base, self._law, self._plant = base, base.law, plant
        limits = ShapingLimits(**{name: non_negative(f"actions.{name}", value) for name, value in authority.items()})
        self.strength = limits.torque if limits.fading == 0.0 else None
        n = self.joints = len(plant.torque_limit)
        self._shaping = self._law.shaping = self._make_shaping(limits)
        names = ("pace", *(f"{part}_{joint + 1}" for part in ("offset", "torque") for joint in range(n)))
        self._columns = np.flatnonzero(np.repeat([limits.pace, limits.offset, limits.torque], [1, n, n]) > 0.0)
        self.names = tuple(names[column] for column in self._columns)
        self.sensors: tuple[object, ...] = tuple(base.sensors)
        self._quantities = LinearMeasurements(plant.model)
        self._ranges = np.concatenate([plant.measured()[name][0] for name in self._quantities.columns])
        self.observation_sizes = self._sizes()
        self._observed = np.zeros((0, sum(self.observation_sizes.values())))

    def _make_shaping(self, limits: ShapingLimits) -> ReferenceShaping:
        """Return the reference shaping with which the slews of the base run."""
        return ReferenceShaping(self._law.slews, self._law.limits, self._plant.period, limits)

    def _sizes(self) -> Mapping[str, int]:
        """Return the numbers of observed quantities by name; the names are stored in files of policies."""
        n = self.joints
        sizes = {"estimate": 8 * n, "departures": 8 * n, "angle_errors": 2 * n, "reference": 2 * n, "way": 3 * n}
        sizes |= {"clock": 6, "offsets": 2 * n, "applied": n, "action": len(self.names)}
        return sizes | {"parameters": 1 + 2 * n, "deviations": 1 + 2 * n}

    def reset(self, arms: IntArray, episode: EpisodeInfo, count: int) -> None:
        """Start new episodes; arguments as in `Controller.reset`.

        Raises:
            ValueError: for a moving goal.
        """
        if episode.reference is not None:
            raise value_error("actions", "shaping", "torque: the goal of this task moves, and only slews can be shaped")
        self._shaping.reset(arms, count)
        self._base.reset(arms, episode, count)

    def act(self, actions: Array, readings: Readings, applied: Array, active: BoolArray) -> Array:
        """Return the commanded torques (b, n) as fractions of the torque limits."""
        arms = np.flatnonzero(active)
        self._shaping.action[arms[:, None], self._columns] = actions[arms]
        return self._base.act(readings, applied, active)

    def prepare(self, applied: Array, active: BoolArray) -> None:
        """Prepare the next estimate of the base controller, see `Controller`."""
        self._base.prepare(applied, active)

    def observe(self, readings: Readings, applied: Array, active: BoolArray) -> Array:
        """Return the observed quantities of all arms (b, size), updated for the active arms (b,)."""
        if len(self._observed) < len(active):
            self._observed = np.zeros((len(active), self._observed.shape[1]))
        if active.any():
            estimate, arms = self._base.update_estimate(readings, applied, active), np.flatnonzero(active)
            self._law.plan(estimate, active)
            observed = np.concatenate(list(self._parts(estimate, applied, arms).values()), axis=1)
            self._observed[arms] = np.clip(np.nan_to_num(observed), -MAX_OBSERVATION, MAX_OBSERVATION)
        return self._observed

    def _parts(self, estimate: Estimate, applied: Array, arms: IntArray) -> dict[str, Array]:
        """Return the observed quantities of the arms (r,), by name."""
        law, slews, model, d = self._law, self._law.slews, self._plant.model, self._plant.model.n_dof
        states, reference, times = estimate.states[arms], law.reference(estimate, arms), law.clock(estimate, arms)
        motors, (progress, speed, acceleration) = model.motor_columns, slews.at(times, arms)
        displacement, end_time = slews.displacement[arms], slews.start_time[arms] + slews.duration[arms]
        errors = slews.start[arms] + displacement + slews.shift[arms] - states[:, motors]
        deviations = np.arcsinh(self._read(states - reference) / (DEVIATION_SCALE * self._ranges))
        path = [displacement * each[:, None] for each in (1.0 - progress, speed, acceleration)]
        remaining = np.maximum(end_time - times, 0.0)
        clock = [progress, speed, acceleration, remaining, slews.time_scaling[arms], end_time]
        return {
            "estimate": self._read(states),
            "departures": deviations,
            "angle_errors": np.concatenate([errors, np.arcsinh(errors / ANGLE_SCALE)], axis=1),
            "reference": np.concatenate([reference[:, motors], reference[:, d + motors]], axis=1),
            "way": np.concatenate(path, axis=1),
            "clock": np.stack(clock, axis=1),
            "offsets": self._shaping.offsets[arms].reshape(len(arms), 2 * self.joints),
            "applied": applied[arms],
            "action": self._shaping.action[arms][:, self._columns],
            "parameters": self._parameters(estimate, arms),
            "deviations": self._deviations(arms),
        }

    def _read(self, states: Array) -> Array:
        """Return the measured quantities (r, 8 n) of states (r, 2 d), see `LinearMeasurements`."""
        named = self._quantities.measure(states)
        return np.concatenate([named[name] for name in self._quantities.columns], axis=1)

    def _parameters(self, estimate: Estimate, arms: IntArray) -> Array:
        """Return payload (kg) and stiffness factors of joints and links, (r, 1 + 2 n)."""
        constants, estimated = self._plant.model.constants, estimate.parameters
        stiffness = np.where(constants.motor >= 0, constants.joint_stiffness, 1.0)
        ones = np.ones((len(arms), self.joints))
        payload = self._law.slews.payloads(estimated, arms)
        joints = estimated["joint_stiffness"][arms] / stiffness if "joint_stiffness" in estimated else ones
        links = estimated["link_stiffness_factor"][arms] if "link_stiffness_factor" in estimated else ones
        return np.concatenate([payload[:, None], joints, links], axis=1)

    def _deviations(self, arms: IntArray) -> Array:
        """Return the standard deviations (r, 1 + 2 n) of payload (kg) and stiffness factors; 0 for known parameters."""
        constants, estimates = self._plant.model.constants, self._base.estimates
        result, n = np.zeros((len(arms), 1 + 2 * self.joints)), self.joints
        if "payload_mass_deviation" in estimates:
            result[:, 0] = estimates["payload_mass_deviation"][arms]
        if "joint_stiffness_deviation" in estimates:
            flexible = constants.motor >= 0
            relative = estimates["joint_stiffness_deviation"][arms] / constants.joint_stiffness[flexible]
            result[:, 1 : 1 + n][:, flexible] = relative  # rigid joints keep 0
        if "link_stiffness_factor_deviation" in estimates:
            result[:, 1 + n :] = estimates["link_stiffness_factor_deviation"][arms]
        return result

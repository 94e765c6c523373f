"""PD controller of the motors with joint-torque feedback along a minimum-jerk reference, designed from data sheets."""

from typing import NamedTuple

import numpy as np

from flexman_gym.agent.base_controllers import ControllerEntry
from flexman_gym.agent.controller import EpisodeInfo, Plant, Readings, saturated
from flexman_gym.common.arrays import Array, BoolArray, IntArray, pad_rows
from flexman_gym.model.dynamics import mass_matrix
from flexman_gym.model.friction import friction_coefficients, mean_friction_derivatives, mean_friction_torques
from flexman_gym.model.statics import holding_torques
from flexman_gym.simulation.physical_parameters import varied_model
from flexman_gym.toolbox.controllers.references.trajectories import QUINTIC, TIMINGS


class _Tuning(NamedTuple):
    """Dimensionless gains, common to all joints.

    Attributes:
        damping: largest derivative gain x control period / inertia of the motor.
        feedback: joint-torque feedback gain / joint stiffness; below 1.
        stiffness: proportional gain x time scale / derivative gain.
        inertia: acceleration feed-forward / inertia of the stretched arm that remains with torque feedback.
        duration: time scale / shortest time scale within the torque limits.
    """

    damping: float
    feedback: float
    stiffness: float
    inertia: float
    duration: float


# Delay of the torques (control periods) -> gains, found by random search on FlexRRR-v0 with the conditions nominal and
# payload, delay, and random-delay, on seeds from 5100; the gains of the longest delay serve all longer delays.
TUNINGS = {
    0: _Tuning(1.18, 0.729, 1.17, 0.575, 1.175),
    1: _Tuning(0.849, 0.739, 1.24, 0.584, 1.33),
    2: _Tuning(0.502, 0.837, 1.23, 0.665, 1.33),
}
# Rate at which the damping stops the rigid arm x time scale, beyond which motors no longer absorb vibration: that of
# the tuned gains, rounded up. Without this bound a short control period makes the motors of a quick arm too stiff.
RIGID_RATE = 4.0
SMALL_ANGLE = 0.05  # rad; added to the largest rotation, so that short slews are not abrupt
PAYLOAD_CLASSES = 4  # number of payload classes that a scale distinguishes within the range of payloads


class TorqueFeedbackPD:
    """PD controller with joint-torque feedback, acceleration feed-forward and friction compensation.

    The torque is K (q_ref - q) + D (dq_ref - dq) + M ddq_ref + G twist + friction, with the motor angles q and the
    twists of the joint springs from encoders on both sides. The feedback G of the joint torque divides inertia and
    stiffness by 1 - G / k (Albu-Schaeffer, Ott and Hirzinger, Int. J. Robotics Research 26, 2007, 23), so that the
    motors absorb the vibration of the links. The reference is a minimum-jerk slew whose duration increases with the
    square roots of rotation and inertia, or a moving goal.

    The design requires data sheets only: inertia of motors and stretched arm, stiffness of joint springs, friction of
    the motors, torque limits and delay. A scale determines the class of the payload before a slew.

    Args:
        plant: plant model.
    """

    sensors: tuple[str, ...] = ("servo", "joint_encoders")
    state_fields = ("_ages",)

    def __init__(self, plant: Plant) -> None:
        model, self._period, self._limits = plant.model, plant.period, np.array(plant.torque_limit)
        tuning, n = TUNINGS[min(plant.delay[1], max(TUNINGS))], model.n_joints
        low, high = plant.unknown.get("payload_mass", (model.constants.payload_mass[0],) * 2)
        edges = np.linspace(low, high, PAYLOAD_CLASSES + 1)
        self._edges = edges[1:-1]
        models = [varied_model(model, payload_mass=mass) for mass in 0.5 * (edges[1:] + edges[:-1])]
        masses = [mass_matrix(each, np.zeros(2 * model.n_dof)) for each in models]
        inertia = np.array([np.diag(each)[:n] for each in masses])  # (classes, n), kg m^2; links of the stretched arm
        scales = tuning.duration * np.sqrt((inertia / self._limits).max(axis=1))  # s/sqrt(rad)
        self._motor_inertia = 1.0 / np.diag(np.linalg.inv(masses[0]))[model.motor_columns]
        self._spring = np.where(model.constants.motor >= 0, model.constants.joint_stiffness, 0.0)
        self._holding_factor = np.where(self._spring > 0.0, 1.0 - tuning.feedback, 1.0)
        # (classes,) inertia that the motor of the slowest joint turns with torque feedback / inertia of this motor
        carried = 1.0 + (self._holding_factor * inertia / self._motor_inertia).max(axis=1)
        largest = RIGID_RATE * (carried / scales).max() * self._motor_inertia
        self._damping = np.minimum(tuning.damping * self._motor_inertia / self._period, largest)
        self._stiffness = tuning.stiffness * self._damping / scales[:, None]
        self._feedback = tuning.feedback * self._spring
        self._inertia, self._scales = tuning.inertia * (1.0 - tuning.feedback) * inertia, scales
        self._models = models if model.constants.gravity.any() else None
        self._friction = friction_coefficients(model)
        self._width = model.constants.coulomb_rate
        self._ages, self._classes = np.zeros(0, dtype=np.int64), np.zeros(0, dtype=np.int64)
        self._rotation, self._holding = np.zeros((0, n)), np.zeros((0, n))

    def reset(self, arms: IntArray, episode: EpisodeInfo, count: int) -> None:
        """Start the slews of the arms (r,) of `count` in all; the classes of their payloads are known."""
        for name in ("_ages", "_classes", "_rotation", "_holding"):
            setattr(self, name, pad_rows(getattr(self, name), count))
        self._ages[arms], self._classes[arms] = 0, 0
        if "payload_mass" in episode.drawn:
            self._classes[arms] = np.searchsorted(self._edges, episode.drawn["payload_mass"])
        self._rotation[arms] = episode.goal - episode.start
        if self._models is not None:
            for arm, goal in zip(arms.tolist(), episode.goal, strict=True):
                weight = holding_torques(self._models[self._classes[arm]], goal)
                self._holding[arm] = self._holding_factor * weight

    def act(self, readings: Readings, applied: Array, active: BoolArray) -> Array:
        """Return the actions (b, n), fractions of the torque limits."""
        torques, rates, after = self._torques(readings)
        if self._friction.any():
            torques += mean_friction_torques(self._friction, rates, after, self._width)
        self._ages += active
        return np.clip(torques / self._limits, -1.0, 1.0)

    def skip(self, active: BoolArray) -> None:
        """Advance the references of the active arms by a control period without readings, see `Controller`."""
        self._ages += active

    def derivatives(self, readings: Readings, changes: Readings) -> tuple[Array, Array]:
        """Return the actions (1, n) of an arm and their derivatives (p, n), see `Controller`."""
        torques, rates, after = self._torques(readings)
        turning, twisting = changes["motor_rates"], changes["joint_twists"]
        change = self._stiffness[self._classes] * changes["angle_errors"] - self._damping * turning
        change += self._feedback * twisting
        if self._friction.any():
            inside = np.where(np.abs(torques) < self._limits, change, 0.0)
            later = turning + self._period / self._motor_inertia * (inside - self._spring * twisting)
            change += mean_friction_derivatives(self._friction, (rates, turning), (after, later), self._width)
            torques += mean_friction_torques(self._friction, rates, after, self._width)
        return saturated(torques / self._limits, change / self._limits)

    def _torques(self, readings: Readings) -> tuple[Array, Array, Array]:
        """Return the torques without friction, N m, and the motor rates at both ends of the period, rad/s, (b, n)."""
        rates, twists = np.asarray(readings["motor_rates"], dtype=float), readings["joint_twists"]
        durations = self._scales[self._classes] * np.sqrt(np.abs(self._rotation).max(axis=1) + SMALL_ANGLE)
        timing = TIMINGS[QUINTIC].at(self._ages * self._period / durations)
        progress, speed, acceleration = (each[:, None] for each in timing)
        speed, acceleration = speed / durations[:, None], acceleration / durations[:, None] ** 2
        errors = readings["angle_errors"] - (1.0 - progress) * self._rotation
        lag = speed * self._rotation + readings.get("goal_rates", 0.0) - rates
        torques = self._stiffness[self._classes] * errors + self._damping * lag + self._feedback * twists
        torques += self._inertia[self._classes] * acceleration * self._rotation + self._holding
        spring = self._spring * twists
        change = self._period / self._motor_inertia * (np.clip(torques, -self._limits, self._limits) - spring)
        return torques, rates, rates + change


ENTRY = ControllerEntry(
    TorqueFeedbackPD,
    ("data sheets", "payload class"),
    (),
    "a PD of the motors with joint-torque feedback along a minimum-jerk slew, designed from data sheets",
    "by random search of five numbers for all arms, about a minute of computing time for each delay, on the seeds "
    "5100 to 5115 of `FlexRRR-v0`",
)

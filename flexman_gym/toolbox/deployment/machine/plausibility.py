"""Tests of the values of readings: innovations of observers of the arm, values that stand still, and torques."""

from collections import deque
from collections.abc import Mapping, Sequence

import numpy as np

from flexman_gym.agent.controller import Plant
from flexman_gym.common.arrays import Array, BoolArray
from flexman_gym.envs.config.configuration import Configuration
from flexman_gym.kernels.layout import OK
from flexman_gym.model.dynamics import frequencies
from flexman_gym.model.linearization import MEASUREMENT_UNITS, measurement_rows
from flexman_gym.model.state_space import first_order_lag
from flexman_gym.model.statics import holding_torques, rest_state
from flexman_gym.simulation.batch import Batch
from flexman_gym.toolbox.controllers.internal_model import DiscreteJacobians
from flexman_gym.toolbox.controllers.observers.kalman_filter import (
    FORCE_NOISE,
    MISMATCH_FORCE_NOISE,
    TORQUE_NOISE,
    measurement_update,
    time_update,
)
from flexman_gym.toolbox.controllers.observers.observer import MIN_DEVIATION
from flexman_gym.toolbox.controllers.observers.perturbed_models import UncertainParameters, uncertain_ranges

TORQUE_ERROR = 0.2  # fraction of the torque limits; error of the torques of a machine and of their readings
DEVIATIONS = 4.0  # standard deviations of an innovation of a correct model
SECOND_ORDER = 2.5  # factor on the sum of the effects of single parameters: their products, and errors beyond ranges
SPAN, EXCESSES = 5, 3  # readings in a row, and number of innovations of one value beyond their bound among them
REPEATS = 4  # equal readings in a row after which a value stands still; a sensor may lose single samples
UPDATES = 300  # control periods of the Riccati recursion of the observer gain


def with_disturbances(plant: Plant, configuration: Configuration) -> Plant:
    """Return a plant whose `tip_force` contains all disturbances of the motion in an environment.

    An impulse is a force during a control period; base motion and initial vibration are the forces that cause them.
    """
    drawn = configuration.disturbances.ranges if configuration.disturbances else {}
    size = {name: float(drawn.get(name, (0.0, 0.0))[1]) for name in ("tip_impulse", "base_sway", "initial_vibration")}
    arm, first = plant.model.arm, frequencies(plant.model, lock_joints=True)[:1]
    mass = sum(link.mass for link in arm.links) + (arm.payload.mass if arm.payload else 0.0)
    acceleration = size["base_sway"] + size["initial_vibration"] * float((2.0 * np.pi * first.sum()) ** 2)
    return plant._replace(tip_force=plant.tip_force + size["tip_impulse"] / plant.period + mass * acceleration)


class InnovationTest:
    """Test of readings against what the commands must do, by observers of the same arm with different parameters.

    All observers have the same gain L: x = f(x, torques) + L (y - C x). It is that of a Kalman filter at the start with
    the encoders of the motors alone, so that the links of a wrong model are not excited. The first observer has the
    mean of each uncertain parameter, each of the others one parameter at the end of its range, another delay of the
    torques, or torques that are too small. The innovation of a correct arm is therefore, to first order, at most the
    sum of the differences of their predictions, and a number of standard deviations of the noise. Readings beyond this
    bound do not correct the observers, and neither do values that are repeated, as by a sensor that has lost a sample.
    Readings of the torques are compared with the commands.

    Args:
        plant: plant model with the uncertain parameters, delay, and noise of the instruments.
        readings: successive readings of the arm at rest, name -> values, whose mean and deviation are used.

    Attributes:
        names: measured quantities that are tested.
    """

    def __init__(self, plant: Plant, readings: Sequence[Mapping[str, Array]]) -> None:
        model, self._plant = plant.model, plant
        rows, errors = measurement_rows(model), plant.measured()
        self.names = tuple(name for name in MEASUREMENT_UNITS if name in readings[0])
        self._labels = [f"{name}[{i}]" for name in self.names for i in range(len(rows[name]))]
        self._matrix = np.vstack([rows[name] for name in self.names])
        at_rest = np.array([self._values(each) for each in readings])
        error = np.hstack([errors[name] for name in self.names])
        self._deviations = np.maximum(np.maximum(error[1], at_rest.std(axis=0)), MIN_DEVIATION * error[0])
        self._raise_to_resolution(model.n_joints)
        self._gain_errors, size = error[3], len(self._labels)
        self._past: deque[Array] = deque([np.zeros(model.n_joints)] * (plant.delay[1] + 2), plant.delay[1] + 2)
        self._lag = None if plant.bandwidth is None else first_order_lag(plant.period, plant.bandwidth)
        self._reached = np.zeros(model.n_joints)
        self._make_observers(at_rest.mean(axis=0))
        self._gain, self._spread = self._observer_gain(at_rest.mean(axis=0)[: model.n_joints])
        self._excesses: deque[BoolArray] = deque([np.zeros(size, dtype=bool)] * SPAN, SPAN)
        self._torque_error = TORQUE_ERROR * np.array(plant.torque_limit)
        self._torque_excesses: deque[BoolArray] = deque([self._torque_error < 0.0] * SPAN, SPAN)
        self._last, self._repeats = at_rest[-1], np.zeros(size, dtype=np.int64)
        self._resolution = np.full(size, np.inf)  # smallest change of a value
        self._since = self._predictions()

    def _values(self, readings: Mapping[str, Array]) -> Array:
        return np.concatenate([readings[name] for name in self.names])

    def _raise_to_resolution(self, n: int) -> None:
        """Take the resolution of the encoders of the motors into account, if it is known."""
        motors = [joint.motor for joint in self._plant.model.arm.joints]
        steps = np.array([(motor.joint_resolution or 0.0) if motor else 0.0 for motor in motors])
        self._deviations[:n] = np.maximum(self._deviations[:n], steps)
        if "motor_rates" in self.names:
            rates = slice(n, 2 * n)
            self._deviations[rates] = np.maximum(self._deviations[rates], steps / self._plant.period)

    def _make_observers(self, at_rest: Array) -> None:
        """Create the observers at rest, with the measurements (m,) there."""
        plant, model = self._plant, self._plant.model
        uncertain = UncertainParameters(model, uncertain_ranges(plant))
        p, (low, high) = len(uncertain.names), plant.delay
        usual = (low + high + 1) // 2
        delays = [each for each in range(low, high + 2) if each != usual]
        theta = np.tile(uncertain.mean, (2 + p + len(delays), 1))
        theta[1 + np.arange(p), np.arange(p)] = uncertain.ranges[:, 0]
        self._parameters = p
        self._delays = np.array([usual] * (1 + p) + delays + [usual])
        self._shares = np.ones(len(theta))
        self._shares[-1] = 1.0 - TORQUE_ERROR
        self._batch, self._every = (
            Batch(model, *plant.integration, plant.period, arms=len(theta)),
            np.arange(len(theta)),
        )
        self._drives = np.zeros((len(theta), model.n_joints + 6))
        angles = at_rest[None, : model.n_joints]
        self._mean_model = uncertain.varied_model(model, uncertain.mean) if p else model
        if p:
            self._batch.vary(self._every, **uncertain.values(model, theta))
            models = [uncertain.varied_model(model, each) for each in theta]
        else:
            models = [model] * len(theta)
        self._states = np.vstack([rest_state(each, angles) for each in models])
        self._offsets = at_rest - self._states @ self._matrix.T

    def _observer_gain(self, angles: Array) -> tuple[Array, Array]:
        """Return the gain (2 d, m) of a Kalman filter at rest, and the standard deviations (m,) of its innovations."""
        plant, n = self._plant._replace(model=self._mean_model), len(angles)
        jacobians, size = DiscreteJacobians(plant), self._states.shape[1]
        holding = holding_torques(self._mean_model, angles)
        slopes = jacobians(rest_state(self._mean_model, angles[None]), holding[None])[0][0]
        noise = np.repeat((TORQUE_NOISE, MISMATCH_FORCE_NOISE if plant.unknown else FORCE_NOISE), (n, 3))
        forces = (noise * jacobians.scales) ** 2
        forces[n:] += plant.tip_force**2
        transition, inputs, variances = slopes[:, :size], slopes[:, size:], self._deviations**2
        process = (inputs * forces) @ inputs.T
        covariance, encoders = process.copy(), sum(label.startswith("motor_") for label in self._labels)
        seen = self._matrix[:encoders], variances[:encoders]
        for _ in range(UPDATES):
            covariance = time_update(measurement_update(covariance, *seen)[1], transition, process)
        gain = np.zeros((size, len(variances)))
        gain[:, :encoders] = measurement_update(covariance, *seen)[0]
        return gain, np.sqrt(np.diag(self._matrix @ covariance @ self._matrix.T) + variances)

    def _predictions(self) -> Array:
        """Return the predicted measurements (observers, m)."""
        return self._states @ self._matrix.T + self._offsets

    def advance(self, torques: Array) -> None:
        """Predict a control period under commanded torques (n,), N m."""
        if self._lag is not None:
            missing = self._reached - torques
            self._reached, torques = torques + self._lag[0] * missing, torques + self._lag[1] * missing
        self._past.appendleft(torques)
        past = np.array(self._past)
        self._drives[:, : len(torques)] = past[self._delays] * self._shares[:, None]
        self._batch.place(self._every, self._states)
        self._batch.step(self._drives)
        self._states = self._batch.state.copy()

    def check(self, readings: Mapping[str, Array]) -> str:
        """Return what contradicts the prediction in readings, name -> values; "" for nothing."""
        now, predictions = self._values(readings), self._predictions()
        if not (self._batch.status == OK).all():
            return "the model of the arm does not follow its readings: its simulation diverges"
        differences, p = np.abs(predictions[1:] - predictions[0]), self._parameters
        effects = differences[:p].sum(axis=0) + differences[p:-1].max(axis=0) + differences[-1]
        bound = SECOND_ORDER * effects + self._gain_errors * np.abs(predictions[0]) + DEVIATIONS * self._spread
        innovation, equal = now - predictions[0], now == self._last
        return (
            self._still(now, equal, predictions)
            or self._beyond(now, equal, innovation, bound)
            or self._other_torques(readings.get("torques"))
        )

    def _other_torques(self, torques: Array | None) -> str:
        """Return a text for readings of the torques that are not those that were commanded, of any possible delay."""
        if torques is None:
            return ""
        possible = np.array(self._past)[self._plant.delay[0] :]
        low, high = possible.min(axis=0) - self._torque_error, possible.max(axis=0) + self._torque_error
        self._torque_excesses.append((torques < low) | (torques > high))
        wrong = np.flatnonzero(np.sum(self._torque_excesses, axis=0) >= EXCESSES)
        if not len(wrong):
            return ""
        i = wrong[0]
        return f"reading torques[{i}] is {torques[i]:.4g} N m, but the commands are {low[i]:.4g} to {high[i]:.4g} N m"

    def _still(self, now: Array, equal: BoolArray, predictions: Array) -> str:
        """Return a text for a value that repeats itself while all observers predict a change beyond its deviation."""
        step = np.abs(now - self._last)
        self._resolution = np.where(equal, self._resolution, np.minimum(self._resolution, step))
        self._repeats = np.where(equal, self._repeats + 1, 0)
        self._since[:, ~equal], self._last = predictions[:, ~equal], now
        visible = self._deviations + np.where(np.isfinite(self._resolution), 2.0 * self._resolution, 0.0)
        moved = np.abs(predictions - self._since).min(axis=0)
        still = np.flatnonzero((self._repeats >= REPEATS) & (moved > visible))
        if not len(still):
            return ""
        return f"reading {self._labels[still[0]]} stands still at {now[still[0]]:.4g} while the commands move the arm"

    def _beyond(self, now: Array, equal: BoolArray, innovation: Array, bound: Array) -> str:
        """Correct the observers, and return a text for a value with several innovations beyond their bound."""
        lost = equal & (self._repeats <= REPEATS)
        excess = (np.abs(innovation) > bound) & ~lost
        self._excesses.append(excess)
        self._states += np.where(lost | excess, 0.0, now - self._predictions()) @ self._gain.T
        wrong = np.flatnonzero(np.sum(self._excesses, axis=0) >= EXCESSES)
        if not len(wrong):
            return ""
        i = wrong[0]
        predicted = f"{now[i] - innovation[i]:.4g} +- {bound[i]:.2g} by the model"
        return f"reading {self._labels[i]} is {now[i]:.4g}, but {predicted}"

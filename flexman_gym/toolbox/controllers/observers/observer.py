"""Observer protocol, its estimate, and the linear measurement model of the instruments."""

from collections.abc import Mapping, Sequence
from typing import NamedTuple, Protocol

import numpy as np

from flexman_gym.agent.controller import EpisodeInfo, Plant, Readings
from flexman_gym.common.arrays import Array, BoolArray, IntArray
from flexman_gym.common.errors import value_error
from flexman_gym.model.linearization import LINEAR_SENSORS, LINK_SENSOR, LinearMeasurements


class Estimate(NamedTuple):
    """Estimate of the states and parameters of b arms for a control period.

    Attributes:
        states: (b, 2 d) states predicted for the time at which torques commanded now take effect.
        lead: (b,) control periods from now to this time, whole numbers.
        parameters: name -> (b, ...) estimated physical parameters in their units; a missing name stands for the value
            of the model.
        disturbance: (b, n) estimated constant disturbance torques on the motors, N m.
    """

    states: Array
    lead: IntArray
    parameters: Mapping[str, Array]
    disturbance: Array | float = 0.0


class UncertainStates(NamedTuple):
    """Present states of k models of each of r arms: the most probable model, p deviations of it, and other delays.

    Attributes:
        states: (r, k, 2 d) present states; the first is that of the most probable model.
        parameters: name -> (r, k, ...) physical parameters in their units, see `Batch.vary`.
        delays: (r, k) delays of the torques, control periods.
        deviations: p, number of models after the first that deviate by one parameter each; k - 1 - p have other delays.
    """

    states: Array
    parameters: Mapping[str, Array]
    delays: IntArray
    deviations: int


class Observer(Protocol):
    """Protocol of observers of b arms. The estimate of an arm must not depend on the other arms, to the last bit.

    Optional members are `state_fields`, as in `Controller`; `estimates`, name -> (b, ...), added to `info`; and
    `inconsistent`, (b,) flags of arms whose readings no model of the observer explains.

    Attributes:
        sensors: names of the sensors that the observer reads.
    """

    @property
    def sensors(self) -> tuple[str, ...]:
        """Names of the sensors that the observer reads."""
        ...

    def reset(self, arms: IntArray, episode: EpisodeInfo, count: int) -> None:
        """Start new episodes; arguments as in `Controller.reset`."""
        ...

    def estimate(self, readings: Readings, applied: Array, active: BoolArray) -> Estimate:
        """Return the estimate of this control period; arguments as in `Controller.act`.

        An observer is called once per control period.
        """
        ...


MAX_BIAS = 0.005  # fraction of the range; largest bias of a measurement
MAX_LOST = 3  # largest number of successive repetitions of a sample that count as lost samples
MIN_DEVIATION = 1e-4  # fraction of the range; smallest standard deviation of a measurement, due to model errors


def default_sensors(plant: Plant, usual: tuple[str, ...]) -> tuple[str, ...]:
    """Return the sensors of output feedback whose sensors are not named: link encoders where the plant has them."""
    return tuple(LINK_SENSOR) if plant.link_encoders else usual


class MeasurementModel:
    """Linear measurement model of the instruments: y = matrix x + noise, with m measurements y and the state x.

    Args:
        plant: plant model with the range, the noise, the bias and the gain error of each instrument; standard
            deviations are at least 1e-4 of the range.
        sensors: names in `model.linearization.LINEAR_SENSORS`, including "motor_encoders", which determine the posture
            at the start; or "link_encoders", which determine it for an arm without gravity.

    Attributes:
        names: names of the measured quantities in their order.
        places: name -> slice of the measurement vector (m,).
        posture: slice (n,) of the angles that determine the posture at the start.
        matrix: (m, 2 d) measurement matrix.
        ranges: (m,) largest magnitude of each measurement.
        deviations: (m,) standard deviation of the noise of each measurement.
        biases: (m,) largest magnitude of the bias of each measurement.
        gain_errors: (m,) largest relative gain error of each measurement.

    Raises:
        ValueError: for a sensor whose readings are nonlinear in the state, and without encoders of the posture.
    """

    def __init__(self, plant: Plant, sensors: Sequence[str]) -> None:
        names = () if isinstance(sensors, str) else sensors
        linear, model = LINEAR_SENSORS | LINK_SENSOR, plant.model
        known = all(isinstance(each, str) and each in linear for each in names)
        if not known or ("motor_encoders" not in names and "link_encoders" not in names):
            optional = ", ".join([*list(LINEAR_SENSORS)[1:], *LINK_SENSOR])
            allowed = f"motor_encoders, and any of {optional}: other sensors are not linear in the state"
            raise value_error("sensors", sensors, allowed)
        if "motor_encoders" not in names and model.constants.gravity.any():
            raise value_error(
                "sensors", sensors, "motor_encoders with them: under gravity the springs are bent at rest"
            )
        self.names = tuple(name for each in dict.fromkeys(sensors) for name in linear[each])
        states = np.eye(2 * model.n_dof)
        columns = LinearMeasurements(model).measure(states) | {"joint_angles": states[:, : model.n_joints]}
        measured = plant.measured()
        ends = np.cumsum([0, *(columns[name].shape[1] for name in self.names)]).tolist()
        self.places = {name: slice(*both) for name, *both in zip(self.names, ends, ends[1:], strict=False)}
        self.posture = self.places.get("motor_angles") or self.places["joint_angles"]
        self.matrix: Array = np.hstack([columns[name] for name in self.names]).T.copy()
        errors = np.hstack([measured[name] for name in self.names])
        self.ranges, deviations = errors[:2]
        self.biases, self.gain_errors = errors[2:] if len(errors) > 2 else np.zeros((2, len(self.ranges)))
        self.deviations: Array = np.maximum(deviations, MIN_DEVIATION * self.ranges)
        sizes = [sum(columns[name].shape[1] for name in linear[each]) for each in dict.fromkeys(sensors)]
        self._sensors = np.repeat(np.arange(len(sizes)), sizes)  # index of the sensor of each measurement
        self._firsts = np.cumsum([0, *sizes])[:-1]  # index of the first measurement of each sensor

    def read(self, readings: Readings) -> Array:
        """Return the measurements (b, m) of b arms, concatenated in the order of `names`."""
        return np.concatenate([readings[name] for name in self.names], axis=1).astype(float)

    def lost(self, now: Array, previous: Array, change: Array, repeats: IntArray) -> tuple[BoolArray, IntArray]:
        """Recognise lost samples, in whose place a sensor repeats all numbers of its previous sample.

        A quantised sensor of an arm at rest repeats its numbers, too. A repeated sample therefore counts as lost only
        while the arm moves according to its model, by more than a standard deviation of one of the measurements, and
        only up to MAX_LOST times in succession.

        Args:
            now: (r, m) measurements.
            previous: (r, m) measurements of the previous control period.
            change: (r, m) predicted changes of the measurements since the last sample that was not lost.
            repeats: (r, m) number of previous repetitions in succession.

        Returns:
            Flags (r, m) of lost measurements and updated numbers of repetitions (r, m).
        """
        equal = np.logical_and.reduceat(now == previous, self._firsts, axis=1)[:, self._sensors]
        moved = np.logical_or.reduceat(np.abs(change) > self.deviations, self._firsts, axis=1)[:, self._sensors]
        repeats = np.where(equal, repeats + 1, 0)
        return equal & moved & (repeats <= MAX_LOST), repeats

"""Observer protocol, its estimate, and the linear measurement model of the instruments."""

from collections.abc import Mapping, Sequence
from typing import NamedTuple, Protocol

import numpy as np

from flexman_gym.common.arrays import Array, BoolArray, IntArray
from flexman_gym.common.checks import value_error
from flexman_gym.control.controller import EpisodeInfo, Plant, Readings
from flexman_gym.model.linearization import LINEAR_SENSORS, LinearMeasurements


class Estimate(NamedTuple):
    """What is known of b arms when a controller has to act.

    Attributes:
        states: (b, 2 d) of the moment at which torques that are asked for now begin to act.
        lead: (b,) whole control periods from now to that moment.
        parameters: name -> (b, ...) physical parameters as they are estimated, in their units; those that are not in it
            are the model's.
        disturbance: (b, n) constant torques on the motors beside those that are asked for, N m.
    """

    states: Array
    lead: IntArray
    parameters: Mapping[str, Array]
    disturbance: Array | float = 0.0


class Observer(Protocol):
    """The protocol of an observer of b arms. Its estimate of an arm must not depend on the others, to the last bit.

    An optional member is `state_fields`, as of a Controller.

    Attributes:
        sensors: names of the sensors that it reads.
    """

    @property
    def sensors(self) -> tuple[str, ...]:
        """Names of the sensors that it reads."""
        ...

    def reset(self, arms: IntArray, episode: EpisodeInfo, count: int) -> None:
        """Starts new episodes of the arms (r,)."""
        ...

    def estimate(self, readings: Readings, applied: Array, active: BoolArray) -> Estimate:
        """Gives what is known now; arguments are those of `Controller.act`, and it is asked once a control period."""
        ...


MAX_BIAS = 0.005  # of a range, up to which a biased reading is off
MIN_DEVIATION = 1e-4  # of a range, least deviation of a reading: no model is truer


class MeasurementModel:
    """Linear measurement model of instruments: m measured quantities y = matrix x + noise.

    Args:
        plant: plant model with the range and the noise of each instrument; standard deviations are at least 1e-4 of
            the range.
        sensors: names in `model.linearization.LINEAR_SENSORS`, among them "motor_encoders", which define the pose of an
            arm at the start.

    Attributes:
        names: measured quantities, in their order.
        places: name -> slice of the m numbers.
        matrix: (m, 2 d) of the quantities with respect to the state.
        ranges: (m,) largest magnitude of each number.
        deviations: (m,) standard deviation of its noise.

    Raises:
        ValueError: for a sensor whose readings are nonlinear in the state, and without motor encoders.
    """

    def __init__(self, plant: Plant, sensors: Sequence[str]) -> None:
        if isinstance(sensors, str) or not set(sensors) <= set(LINEAR_SENSORS) or "motor_encoders" not in sensors:
            optional = ", ".join(list(LINEAR_SENSORS)[1:])
            allowed = f"motor_encoders, and any of {optional}: other sensors are not linear in the state"
            raise value_error("sensors", sensors, allowed)
        self.names = tuple(name for each in dict.fromkeys(sensors) for name in LINEAR_SENSORS[each])
        columns, measured = LinearMeasurements(plant.model).named(np.eye(2 * plant.model.n_dof)), plant.measured()
        ends = np.cumsum([0, *(columns[name].shape[1] for name in self.names)]).tolist()
        self.places = {name: slice(*both) for name, *both in zip(self.names, ends, ends[1:], strict=False)}
        self.matrix: Array = np.hstack([columns[name] for name in self.names]).T.copy()
        self.ranges, deviations = np.hstack([measured[name] for name in self.names])
        self.deviations: Array = np.maximum(deviations, MIN_DEVIATION * self.ranges)

    def read(self, readings: Readings) -> Array:
        """Return the measured quantities (b, m) of b arms, one after another."""
        return np.concatenate([readings[name] for name in self.names], axis=1).astype(float)

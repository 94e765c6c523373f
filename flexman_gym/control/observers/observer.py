"""Observer protocol, its estimate, and the linear measurement model of the instruments."""

from collections.abc import Mapping, Sequence
from typing import NamedTuple, Protocol

import numpy as np

from flexman_gym.common.arrays import Array, BoolArray, IntArray
from flexman_gym.common.checks import value_error
from flexman_gym.control.controller import EpisodeInfo, Plant, Readings
from flexman_gym.model.linearization import LINEAR_SENSORS
from flexman_gym.model.linearization import LinearMeasurements as Linear


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

    def estimate(self, readings: Readings, applied: Array, playing: BoolArray) -> Estimate:
        """Gives what is known now; arguments are those of `Controller.act`, and it is asked once a control period."""
        ...


MAX_BIAS = 0.005  # of a range, up to which a biased reading is off
MIN_DEVIATION = 1e-4  # of a range, least deviation of a reading: no model is truer


class MeasurementModel(NamedTuple):
    """Readings side by side, m numbers of each arm.

    Attributes:
        names: of the readings, in their order.
        places: name -> slice of the m numbers.
        matrix: (m, 2 d) of the readings by the state.
        ranges, deviations: (m,) largest magnitude, and standard deviation of the noise.
    """

    names: tuple[str, ...]
    places: dict[str, slice]
    matrix: Array
    ranges: Array
    deviations: Array

    def read(self, readings: Readings) -> Array:
        """Gives the numbers (b, m) of b arms."""
        return np.concatenate([readings[name] for name in self.names], axis=1).astype(float)


def make_measurement_model(plant: Plant, sensors: Sequence[str]) -> MeasurementModel:
    """Gives the instruments that some sensors are.

    Args:
        plant: says how exact they are; the least deviation is 1e-4 of the range.
        sensors: names in `model.linearization.LINEAR_SENSORS`.

    Raises:
        ValueError: for any other, whose readings are not linear in the state, and without encoders of the motors, which
            tell where an arm is at its start.
    """
    if isinstance(sensors, str) or not set(sensors) <= set(LINEAR_SENSORS) or "motor_encoders" not in sensors:
        allowed = f"motor_encoders, beside which may stand {', '.join(list(LINEAR_SENSORS)[1:])}: what else there is "
        raise value_error("sensors", sensors, f"{allowed}does not follow the state linearly")
    names = tuple(name for each in dict.fromkeys(sensors) for name in LINEAR_SENSORS[each])
    unit, measured = Linear(plant.model).measure(np.eye(2 * plant.model.n_dof)), plant.measured()
    ends = np.cumsum([0, *(unit[name].shape[1] for name in names)]).tolist()
    places = {name: slice(*both) for name, *both in zip(names, ends, ends[1:], strict=False)}
    ranges, deviations = np.hstack([measured[name] for name in names])
    matrix = np.hstack([unit[name] for name in names]).T.copy()
    return MeasurementModel(names, places, matrix, ranges, np.maximum(deviations, MIN_DEVIATION * ranges))

"""Instruments: what an observer reads of an arm, as a linear map of its state, and how exact that is."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from flexman_gym.arrays import Array
from flexman_gym.checks import refusal
from flexman_gym.control.controller import Readings
from flexman_gym.control.plant import Plant
from flexman_gym.simulation.readings import INSTRUMENTS
from flexman_gym.simulation.readings import Readings as Linear

BIAS = 0.005  # of a range, up to which a biased reading is off
FLOOR = 1e-4  # of a range, least deviation of a reading: no model is truer


class Instruments(NamedTuple):
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


def make_instruments(plant: Plant, sensors: Sequence[str]) -> Instruments:
    """Gives the instruments that some sensors are.

    Args:
        plant: says how exact they are; the least deviation is 1e-4 of the range.
        sensors: names in `simulation.readings.INSTRUMENTS`.

    Raises:
        ValueError: for any other, whose readings are not linear in the state, and without encoders of the motors, which
            tell where an arm is at its start.
    """
    if isinstance(sensors, str) or not set(sensors) <= set(INSTRUMENTS) or "motor_encoders" not in sensors:
        allowed = f"motor_encoders, beside which may stand {', '.join(list(INSTRUMENTS)[1:])}: what else there is "
        raise refusal("sensors", sensors, f"{allowed}does not follow the state linearly")
    names = tuple(name for each in dict.fromkeys(sensors) for name in INSTRUMENTS[each])
    unit, measured = Linear(plant.model).named(np.eye(2 * plant.model.n_dof)), plant.measured()
    ends = np.cumsum([0, *(unit[name].shape[1] for name in names)]).tolist()
    places = {name: slice(*both) for name, *both in zip(names, ends, ends[1:], strict=False)}
    ranges, deviations = np.hstack([measured[name] for name in names])
    matrix = np.hstack([unit[name] for name in names]).T.copy()
    return Instruments(names, places, matrix, ranges, np.maximum(deviations, FLOOR * ranges))

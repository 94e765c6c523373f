"""Readings: the mechanical quantities that are linear in a state, by name and unit."""

import numpy as np

from flexman_gym.common.arrays import Array, IntArray
from flexman_gym.kernels.control_period import linear_readings
from flexman_gym.model.linearization import UNITS, measurement_rows
from flexman_gym.model.model import Model

INSTRUMENTS = {  # name of a sensor whose readings are linear in the state -> what it measures
    "motor_encoders": ("motor_angles", "motor_rates"),
    "joint_encoders": ("joint_twists", "joint_twist_rates"),  # on both sides of a spring
    "strain": ("root_strains",),
}


class LinearReadings:
    """How a model of n links is read.

    Attributes:
        motion: what gives motor_angles, motor_rates, joint_twists, joint_twist_rates, (n,) each, link_deflections and
            link_deflection_rates, (2 n,) each, side by side.
        places: name -> slice of these 8 n numbers.
        strains: what gives root_strains, (3 n,), see `model.deformation.root_gauges`.
    """

    def __init__(self, model: Model) -> None:
        *parts, strains = measurement_rows(model).values()
        ends = np.cumsum([0, *map(len, parts)]).tolist()
        self.places = {name: slice(*both) for name, *both in zip(UNITS, ends, ends[1:], strict=False)}
        self.motion = _entries(np.vstack(parts))
        self.strains = _entries(strains)

    def named(self, states: Array) -> dict[str, Array]:
        """Gives all readings (T, ...) of states (T, 2 d) by name."""
        motion = np.zeros((len(states), max(place.stop for place in self.places.values())))
        strains = np.zeros((len(states), len(self.strains[0]) - 1))
        rows = np.ascontiguousarray(states)
        linear_readings(rows, *self.motion, motion)
        linear_readings(rows, *self.strains, strains)
        return {name: motion[:, place] for name, place in self.places.items()} | {"root_strains": strains}


def _entries(rows: Array) -> tuple[IntArray, IntArray, Array]:
    """The rows (m, 2 d) of a linear reading without their zeros, most of it, as `linear_readings` takes them."""
    start: IntArray = np.append(0, np.cumsum(np.count_nonzero(rows, axis=1)))
    source: IntArray = np.nonzero(rows)[1]
    return start, source, rows[rows != 0.0]

"""Unknowns: the physical parameters that an observer estimates, side by side, with what is known of them beforehand."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from flexman_gym.arrays import Array, IntArray
from flexman_gym.checks import mapping, number_array, refusal
from flexman_gym.model.model import Model
from flexman_gym.simulation.parameters import ARM, PARAMETERS

STEP = 0.0003  # of a range, by which an unknown is changed to see what follows; 0.03 shifts a phase by a radian in 2 s
BEYOND = 0.08  # of a range, by which an estimate may leave it
SURE = 1e-3  # of a number that is known, or of 1 where it is 0: the range in which it is


@dataclass(frozen=True, eq=False)
class Unknowns:
    """p unknown numbers of an arm: entries of its physical parameters.

    Attributes:
        names: (p,) of the parameters, once for each of their entries.
        joints: (p,) of which joint or link an entry is; 0 of an arm.
        scales: (p,) values of an entry where its number is 1: nominal ones where the number is a factor.
        mean, deviation: (p,) of what is known beforehand: of numbers spread evenly over their range.
        step: (p,) by which a number is changed to see what follows.
        low, high: (p,) between which an estimate stays.
    """

    names: tuple[str, ...]
    joints: IntArray
    scales: Array
    mean: Array
    deviation: Array
    step: Array
    low: Array
    high: Array

    def values(self, model: Model, numbers: Array) -> dict[str, Array]:
        """Gives the parameters, name -> (r, ...) in their units, of numbers (r, p)."""
        result = {}
        for name in dict.fromkeys(self.names):
            row, columns = PARAMETERS[name], np.flatnonzero(np.array(self.names) == name)
            values = numbers[:, columns] * self.scales[columns]
            if row.shape(model.n_joints):
                whole = np.repeat(np.asarray(row.nominal(model))[None], len(numbers), axis=0)
                whole[:, self.joints[columns]] = values
                result[name] = whole
            else:
                result[name] = values[:, 0]
        return result

    def deviations(self, numbers: Array) -> dict[str, Array]:
        """Gives the deviations, name_deviation -> (r,) or (r, entries), of the deviations (r, p or more) of numbers."""
        result = {}
        for name in dict.fromkeys(self.names):
            columns = np.flatnonzero(np.array(self.names) == name)
            values = numbers[:, columns] * self.scales[columns]
            result[f"{name}_deviation"] = values[:, 0] if PARAMETERS[name].of == ARM else values
        return result


def make_unknowns(model: Model, ranges: Mapping[str, tuple[float, float]]) -> Unknowns:
    """Gives the unknowns of an arm.

    Args:
        model: of the arm.
        ranges: name -> (low, high) of physical parameters in `simulation.parameters.PARAMETERS`; parts of the
            nominal value where the table there says factor, one for each joint or link.

    Raises:
        ValueError: one line with field, value and what is allowed.
    """
    names, joints, scales, spans = [], [], [], []
    for name, span in mapping("unknown", ranges, tuple(PARAMETERS)).items():
        low, high = number_array(f"unknown.{name}", span, (2,), "a range (low, high)")
        if not 0.0 <= low <= high:
            raise refusal(f"unknown.{name}", span, "a range (low, high) with 0 <= low <= high")
        row = PARAMETERS[name]
        nominal = np.atleast_1d(row.nominal(model))
        free = ~row.fixed(model) if row.shape(model.n_joints) else np.ones(1, dtype=bool)
        for joint in np.flatnonzero(free & (nominal > 0.0 if row.factor else free)):
            names.append(name)
            joints.append(int(joint))
            scales.append(float(nominal[joint]) if row.factor else 1.0)
            spans.append((low, high))
    low, high = np.array(spans).reshape(-1, 2).T
    wide = np.where(high > low, high - low, SURE * np.where(high > 0.0, high, 1.0))
    return Unknowns(
        tuple(names), np.array(joints, dtype=np.int64), np.array(scales), 0.5 * (low + high), wide / np.sqrt(12.0),
        STEP * wide, np.maximum(low - BEYOND * wide, 0.0), high + BEYOND * wide,
    )  # fmt: skip

"""State of an arm from the readings of a machine, which measure only parts of it."""

from collections.abc import Mapping

import numpy as np

from flexman_gym.common.arrays import Array
from flexman_gym.model.dynamics import stiffness_matrix
from flexman_gym.model.linearization import measurement_rows
from flexman_gym.model.model import Model

POSITIONS = {  # measured quantity -> quantity that measures its rate; "" for none
    "motor_angles": "motor_rates", "joint_twists": "joint_twist_rates", "link_deflections": "link_deflection_rates",
    "root_strains": "",
}  # fmt: skip


class StateEstimate:
    """Linear estimate of the state: motor angles as measured, elastic coordinates of the least strain energy.

    The elastic coordinates minimise the strain energy under the condition that the measured twists, deflections and
    strains are those of the readings; the sag under gravity is seen only by such readings. Rates are estimated by the
    same matrix from the measured rates, and from differences of successive readings without a measured rate.

    Args:
        model: model of the arm.
        names: names of the measured quantities.
        period: control period, s.

    Attributes:
        complete: True if the readings show the deflections of all elastic joints and links, or the whole state.
    """

    def __init__(self, model: Model, names: Mapping[str, int], period: float) -> None:
        self._names, self._period = [name for name in POSITIONS if name in names], period
        d, motors, rows = model.n_dof, model.motor_columns, measurement_rows(model)
        elastic = np.setdiff1d(np.arange(d), motors)
        rigid = model.at_rest(np.eye(model.n_joints))[:, :d]  # (n, d) coordinates per unit motor angle
        measured = np.vstack([rows[name][:, :d] for name in self._names])
        compliance = np.linalg.inv(stiffness_matrix(model)[np.ix_(elastic, elastic)])
        seen = measured[:, elastic]
        n = model.n_joints
        angles = np.eye(n, len(measured))  # the motor angles are the first readings
        bent = np.zeros((d, len(measured)))
        bent[elastic] = compliance @ seen.T @ np.linalg.pinv(seen @ compliance @ seen.T, rcond=1e-10, hermitian=True)
        stiff = rigid.T @ angles
        self._matrix = stiff + bent @ (np.eye(len(measured)) - measured @ stiff)
        self._last: Array | None = None
        constants = model.constants
        springs = "joint_twists" in names or not (constants.motor >= 0).any()
        links = {"link_deflections", "root_strains"} & set(names) or not len(elastic) > (constants.motor >= 0).sum()
        self.complete = "state" in names or bool(springs and links)

    def state(self, readings: Mapping[str, Array]) -> Array:
        """Return the state (2 d,) of readings, name -> values; a given state is returned."""
        if "state" in readings:
            return readings["state"]
        now = np.concatenate([readings[name] for name in self._names])
        rates = (now - (now if self._last is None else self._last)) / self._period
        first = 0
        for name in self._names:
            last = first + len(readings[name])
            if POSITIONS[name] in readings:
                rates[first:last] = readings[POSITIONS[name]]
            first = last
        self._last = now
        return np.concatenate([self._matrix @ now, self._matrix @ rates])

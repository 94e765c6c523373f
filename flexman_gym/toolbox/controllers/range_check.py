"""Range check of readings: a controller of one arm that refuses control periods with a bad reading."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from flexman_gym.agent.controller import Controller, EpisodeInfo, Readings, checked_controller
from flexman_gym.agent.pd import torque_limits
from flexman_gym.common.arrays import Array, BoolArray, IntArray
from flexman_gym.common.errors import value_error
from flexman_gym.model.model import Model
from flexman_gym.model.statics import rigid_holding_torques

GOOD, OUT_OF_RANGE, NOT_FINITE = range(3)  # status of a control period, by its worst reading; as in exported C
# fraction of the reach; free fall within the time of the holding torques: they do not follow the arm, and torques that
# are wrong by the whole weight displace the tip by about this much
HOLDING_FALL = 0.05


def holding_periods(model: Model | None, period: float) -> int:
    """Return the largest number of consecutive control periods with holding torques and without readings.

    Within them a body falls freely by `HOLDING_FALL` of the reach of the arm. At least one; 0 without gravity.

    Args:
        model: model of the arm; None for a controller without gravity compensation.
        period: control period, s.
    """
    gravity = 0.0 if model is None else float(np.linalg.norm(model.constants.gravity))
    if model is None or gravity == 0.0:
        return 0
    return max(int(np.sqrt(2.0 * HOLDING_FALL * model.constants.length.sum() / gravity) / period), 1)


def compensated_model(controller: object) -> Model | None:
    """Return the model whose weight a controller compensates, its attribute `gravity_model`; None without gravity."""
    model: Model | None = getattr(controller, "gravity_model", None)
    return model if model is not None and model.constants.gravity.any() else None


class RangeCheckedController:
    """Controller of one arm that refuses control periods with a bad reading, for loops with real sensors.

    A reading is bad if it is not finite, or if its magnitude exceeds its range. The inner controller does not receive
    the readings of such a period:

    - its filters, histories, moving averages, held commands and the phase of its action repeat remain unchanged, and
      the next good period gets the torques applied after the last good period;
    - references that are functions of time (slews, paths, shaped commands) go on by a period, since a moving goal and
      other machines go on, too, see `Controller`;
    - the action is that of holding torques of the rigid arm at the last good posture, in at most `holding_periods`
      consecutive periods, then zero. It is zero before the first good period, without a gravity model, and without one
      of the readings motor_angles, state and angle_errors, from which the posture follows.

    An environment never refuses a period, since its readings are within their ranges. The functions written by
    `flexman export c` have the same behaviour.

    Args:
        inner: any Controller, such as an Agent with a law.
        ranges: name of a reading -> largest magnitude of its values, a number or (size,), for all readings.
        torque_limit: torque limit of all joints, or of each joint (n,), N m.
        gravity_model: model whose weight is held in refused periods; None for no holding torques.

    Attributes:
        status: of the last period: GOOD (0), OUT_OF_RANGE (1) or NOT_FINITE (2).
        refused: number of consecutive refused periods.

    Examples:
        >>> import numpy as np
        >>> from flexman_gym.control import PD, EpisodeInfo, RangeCheckedController
        >>> pd = PD(stiffness=[40.0], damping=[9.0], torque_limit=10.0)
        >>> checked = RangeCheckedController(pd, {"angle_errors": 8.0, "motor_rates": 10.0}, torque_limit=10.0)
        >>> checked.reset(np.array([0]), EpisodeInfo(np.zeros((1, 1)), np.full((1, 1), 0.1), period=0.01), count=1)
        >>> none, running = np.zeros((1, 1)), np.array([True])
        >>> for rate in (0.0, np.nan, 0.0):
        ...     readings = {"angle_errors": np.array([[0.1]]), "motor_rates": np.array([[rate]])}
        ...     print(checked.act(readings, none, running).round(2).tolist(), checked.status)
        [[0.4]] 0
        [[0.0]] 2
        [[0.4]] 0
    """

    state_fields = ("inner", "status", "refused", "_started", "_period", "_posture", "_applied")

    def __init__(
        self,
        inner: Controller,
        ranges: Mapping[str, float | Array],
        torque_limit: float | Array,
        gravity_model: Model | None = None,
    ) -> None:
        self.inner = checked_controller("RangeCheckedController.inner", inner)
        self.sensors = inner.sensors
        self._ranges = dict(ranges)
        for name, values in self._ranges.items():
            if not (np.asarray(values) >= 0.0).all():
                raise value_error(f"RangeCheckedController.ranges[{name}]", values, "numbers >= 0")
        self._torque_limit, self._model = torque_limit, gravity_model
        self.status, self.refused, self._started, self._period, self._holding_periods = GOOD, 0, False, 0, 0
        self._limits, self._posture = np.zeros(0), np.zeros(0)
        self._goals = self._applied = np.zeros((1, 0))

    def __getattr__(self, name: str) -> Any:
        if name in ("estimates", "gain_units", "derivatives"):  # optional members; environments have good readings
            return getattr(self.__dict__["inner"], name)
        raise AttributeError(f"{type(self).__name__} has no attribute {name}")

    def reset(self, arms: IntArray, episode: EpisodeInfo, count: int) -> None:
        """Start a new episode; arguments as in `Controller.reset`.

        Raises:
            ValueError: for several arms.
        """
        if count != 1:
            raise value_error("RangeCheckedController", f"{count} arms", "one arm")
        n = episode.goal.shape[1]
        self._limits = np.array(torque_limits("RangeCheckedController.torque_limit", self._torque_limit, n))
        self._goals = episode.goal if episode.reference is None else episode.reference[0]
        self.status, self.refused, self._started, self._period = GOOD, 0, False, 0
        self._posture, self._applied = np.zeros(n), np.zeros((1, n))
        self._holding_periods = holding_periods(self._model, episode.period)
        self.inner.reset(arms, episode, count)

    def prepare(self, applied: Array, active: BoolArray) -> None:
        """Prepare the next action of the inner controller, see `Controller`."""
        if hasattr(self.inner, "prepare"):
            self.inner.prepare(self._applied if self.refused else applied, active)

    def act(self, readings: Readings, applied: Array, active: BoolArray) -> NDArray[Any]:
        """Return the action (1, n) of the inner controller, or of a refused period; arguments as in `Controller.act`.

        Raises:
            ValueError: for a reading without a range.
        """
        self.status = self._worst(readings)
        if self.status != GOOD:
            if not self.refused:
                self._applied = np.array(applied)
            self.refused += 1
            self.skip(active)
            return self._holding()
        if self.refused:
            applied, self.refused = self._applied, 0
        if self._holding_periods:
            self._started, self._posture = self._find_posture(readings)
        self._period += 1
        return np.array(self.inner.act(readings, applied, active))

    def skip(self, active: BoolArray) -> None:
        """Advance the references of the inner controller by a control period without readings, see `Controller`."""
        self._period += 1
        if hasattr(self.inner, "skip"):
            self.inner.skip(active)

    def _worst(self, readings: Readings) -> int:
        """Return the largest status of all readings."""
        worst = GOOD
        for name, values in readings.items():
            if name not in self._ranges:
                raise value_error("RangeCheckedController.ranges", list(self._ranges), f"the range of {name}, too")
            if not (np.abs(values) <= self._ranges[name]).all() or not np.isfinite(values).all():
                worst = max(worst, OUT_OF_RANGE if np.isfinite(values).all() else NOT_FINITE)
        return worst

    def _find_posture(self, readings: Readings) -> tuple[bool, Array]:
        """Return True and the motor angles (n,), rad, or False and zeros if no reading contains them."""
        if "motor_angles" in readings:
            return True, np.array(readings["motor_angles"][0], dtype=float)
        if "state" in readings and self._model is not None:
            return True, np.array(readings["state"][0, self._model.motor_columns], dtype=float)
        if "angle_errors" in readings:
            goal = self._goals[min(self._period, len(self._goals) - 1)]
            return True, goal - np.asarray(readings["angle_errors"][0], dtype=float)
        return False, self._posture

    def _holding(self) -> Array:
        """Return the action (1, n) of a refused period."""
        if self._model is None or not self._started or self.refused > self._holding_periods:
            return np.zeros((1, len(self._limits)))
        torques = rigid_holding_torques(self._model, self._posture) * (1 - self._model.constants.passive)
        return np.clip(torques / self._limits, -1.0, 1.0)[None]

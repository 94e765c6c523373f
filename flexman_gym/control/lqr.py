"""LQR: linear-quadratic control of the whole state, at the goal or along a slew to it."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from flexman_gym.arrays import Array, IntArray
from flexman_gym.checks import positive
from flexman_gym.control.discrete import Weights, optimal_gain
from flexman_gym.control.pd import torque_limits
from flexman_gym.control.reference import plan_slew
from flexman_gym.model.linear import linearize
from flexman_gym.model.model import Model, checked_model
from flexman_gym.model.statics import holding_torques, rest_state

TIP, TIP_SPEED, MOTOR = 0.2 / 8.5, 1.0 / 8.5, 0.5  # of the reach, reaches a second, rad: stiffer ones saturate and fail
SHARE = 0.95  # of the torque limits, for the feed-forward
GAINS = 3  # postures along a slew for which gains are designed


class LQR:
    """Linear-quadratic regulator at the goal: holding torques - K (state - rest at the goal), saturated.

    It knows the true state, and its model is the arm: the yardstick of what control can do, not something to build.

    Args:
        model: of the arm, with as many coordinates as the one that is controlled.
        torque_limit: N m, one number or one for each joint.
        period: of control, s.
        weights: of the cost; None takes 20 cm of tip, 1 m/s and 0.5 rad for 8.5 m of reach, and parts of other reaches.

    Raises:
        ValueError: one line with field, value and what is allowed.
    """

    sensors: tuple[str, ...] = ("state",)

    def __init__(
        self, model: Model, torque_limit: float | Sequence[float], period: float, weights: Weights | None = None
    ) -> None:
        checked_model(model)
        n, d, reach = model.n_joints, model.n_dof, float(model.constants.length.sum())
        self.model, self.period = model, positive("period", period, "s")
        self.limits = np.array(torque_limits("torque_limit", torque_limit, n))
        self.weights = weights or Weights(TIP * reach, TIP_SPEED * reach, MOTOR)
        self._gains, self._rest, self._held = np.zeros((0, n, 2 * d)), np.zeros((0, 2 * d)), np.zeros((0, n))

    def gain(self, posture: Array) -> Array:
        """Designs K (n, 2 d) for a posture (n,) rad of the motors."""
        state, held = rest_state(self.model, posture), holding_torques(self.model, posture)
        linear = linearize(self.model, state=state, torque=held)
        return optimal_gain(linear, self.model.motor_columns, self.limits, self.weights, self.period)

    def reset(self, arms: IntArray, start: Array, posture: Array) -> None:
        """Designs for new episodes of the arms (r,) with goal postures (r, n) rad."""
        self._gains, self._rest, self._held = (
            _grown(values, int(arms.max(initial=-1)) + 1) for values in (self._gains, self._rest, self._held)
        )
        for arm, angles in zip(arms, posture, strict=True):
            self._gains[arm] = self.gain(angles)
            self._rest[arm], self._held[arm] = rest_state(self.model, angles), holding_torques(self.model, angles)

    def act(self, readings: Mapping[str, NDArray[np.floating]]) -> NDArray[np.floating]:
        """Gives actions (b, n), or (n,), for the state."""
        state = readings["state"]
        alone = state.ndim == 1
        states = np.asarray(state, dtype=np.float64)
        torques = self.torques(states[None] if alone else states)
        actions = np.clip(torques / self.limits, -1.0, 1.0)
        return actions[0] if alone else actions

    def torques(self, states: Array) -> Array:
        """Gives torques (b, n) N m for states (b, 2 d), product by product of one arm."""
        return self._held - np.vecdot(self._gains, (states - self._rest)[:, None])


class TrackingLQR(LQR):
    """LQR about a minimum-jerk slew within the torque limits, with feed-forward and gains scheduled along the way.

    Arguments and errors are those of `LQR`.
    """

    kept = ("_now",)

    def __init__(
        self, model: Model, torque_limit: float | Sequence[float], period: float, weights: Weights | None = None
    ) -> None:
        super().__init__(model, torque_limit, period, weights)
        self._plans: list[tuple[Array, Array, Array]] = []  # states, torques and gains of each period
        self._now = np.zeros(0, dtype=np.int64)

    def reset(self, arms: IntArray, start: Array, posture: Array) -> None:
        """Plans slews of the arms (r,) from joint angles to goal postures (r, n) rad."""
        count = int(arms.max(initial=-1)) + 1
        self._now = _grown(self._now, count)
        self._plans += [(np.zeros(0),) * 3] * (count - len(self._plans))
        for arm, first, last in zip(arms, start, posture, strict=True):
            slew = plan_slew(self.model, first, last, self.limits, SHARE, self.period)
            held = holding_torques(self.model, last)
            ways = np.linspace(0.0, 1.0, GAINS)
            gains = np.array([self.gain(first + way * (last - first)) for way in ways])
            self._plans[arm] = slew.states, np.vstack([slew.torques, held]), gains
            self._now[arm] = 0

    def torques(self, states: Array) -> Array:
        """Gives torques (b, n) N m for states (b, 2 d), and moves on by a period."""
        found = np.zeros((len(states), self.model.n_joints))
        for arm, state in enumerate(states):
            wanted, torques, gains = self._plans[arm]
            row = min(self._now[arm], len(wanted) - 1)
            moved = wanted[row, self.model.motor_columns] - wanted[0, self.model.motor_columns]
            way = wanted[-1, self.model.motor_columns] - wanted[0, self.model.motor_columns]
            place = (len(gains) - 1) * float(moved @ way / max(way @ way, 1e-12))
            lower = min(max(int(place), 0), len(gains) - 2)
            gain = gains[lower] + min(max(place - lower, 0.0), 1.0) * (gains[lower + 1] - gains[lower])
            found[arm] = torques[row] - np.vecdot(gain, state - wanted[row])
        self._now += 1
        return found


def _grown(values: NDArray[Any], count: int) -> NDArray[Any]:
    """The values with as many rows as arms, new ones zero."""
    more = max(0, count - len(values))
    return np.concatenate([values, np.zeros((more, *values.shape[1:]), dtype=values.dtype)])

"""LQR: linear-quadratic control of the whole state, at the goal or along a slew to it."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from flexman_gym.arrays import Array, Flags, IntArray, Vector, grown, row_dots
from flexman_gym.checks import one_of, positive
from flexman_gym.control.controller import Episode, Readings
from flexman_gym.control.discrete import Weights, optimal_gain
from flexman_gym.control.pd import torque_limits
from flexman_gym.control.reference import plan_path, plan_slew
from flexman_gym.control.timing import LAWS
from flexman_gym.model.linear import linearize
from flexman_gym.model.model import Model, checked_model
from flexman_gym.model.statics import holding_torques, rest_state

TIP, TIP_SPEED, MOTOR = 0.2 / 8.5, 1.0 / 8.5, 0.5  # of the reach, reaches a second, rad: stiffer ones saturate and fail
HOLDING = 0.25  # of the weight of the tip, where an arm starts at its goal
SHARE = 0.95  # of the torque limits, for the feed-forward
GAINS, PATH_GAINS = 3, 25  # postures along a slew, and along a path, for which gains are designed


def usual_weights(model: Model) -> Weights:
    """Gives 20 cm of tip, 1 m/s and 0.5 rad for 8.5 m of reach, and as large parts of other reaches."""
    reach = float(model.constants.length.sum())
    return Weights(TIP * reach, TIP_SPEED * reach, MOTOR)


class LQR:
    """Linear-quadratic regulator at the goal: holding torques - K (state - rest at the goal), saturated.

    It knows the true state, and its model is the arm: the yardstick of what control can do, not something to build.

    Args:
        model: of the arm, with as many coordinates as the one that is controlled.
        torque_limit: N m, one number or one for each joint.
        period: of control, s.
        weights: of the cost; None takes `usual_weights`.

    Raises:
        ValueError: one line with field, value and what is allowed.
    """

    sensors: tuple[str, ...] = ("state",)

    def __init__(
        self, model: Model, torque_limit: float | Vector, period: float, weights: Weights | None = None
    ) -> None:
        checked_model(model)
        n, d = model.n_joints, model.n_dof
        self.model, self.period = model, positive("period", period, "s")
        self.limits = np.array(torque_limits("torque_limit", torque_limit, n))
        self.weights = weights or usual_weights(model)
        self._gains, self._rest, self._held = np.zeros((0, n, 2 * d)), np.zeros((0, 2 * d)), np.zeros((0, n))

    def gain(self, posture: Array, weights: Weights | None = None) -> Array:
        """Designs K (n, 2 d) for a posture (n,) rad of the motors; weights of None are its own."""
        state, held = rest_state(self.model, posture), holding_torques(self.model, posture)
        linear = linearize(self.model, state=state, torque=held)
        return optimal_gain(linear, self.model.motor_columns, self.limits, weights or self.weights, self.period)

    def reset(self, arms: IntArray, episode: Episode) -> None:
        """Designs for new episodes of the arms (r,)."""
        self._gains, self._rest, self._held = (
            grown(values, int(arms.max(initial=-1)) + 1) for values in (self._gains, self._rest, self._held)
        )
        for arm, angles in zip(arms, episode.goal, strict=True):
            self._gains[arm] = self.gain(angles)
            self._rest[arm], self._held[arm] = rest_state(self.model, angles), holding_torques(self.model, angles)

    def act(
        self, readings: Readings, applied: Array | None = None, playing: Flags | None = None
    ) -> NDArray[np.floating]:
        """Gives actions (b, n), or (n,), for the state."""
        state = readings["state"]
        alone = state.ndim == 1
        states = np.asarray(state, dtype=np.float64)
        torques = self.torques(states[None] if alone else states)
        actions = np.clip(torques / self.limits, -1.0, 1.0)
        return actions[0] if alone else actions

    def torques(self, states: Array) -> Array:
        """Gives torques (b, n) N m for states (b, 2 d), product by product of one arm."""
        return self._held - row_dots(self._gains, (states - self._rest)[:, None])


class GainSchedule(NamedTuple):
    """What a tracking LQR follows, period by period.

    Attributes:
        states: (T + 1, 2 d).
        torques: (T + 1, n) N m.
        gains: (g, n, 2 d) for some places along the way.
        places: (T + 1,) where each period is among them, from 0 to g - 1.
    """

    states: Array
    torques: Array
    gains: Array
    places: Array


class TrackingLQR(LQR):
    """LQR about a slew within the torque limits, with feed-forward and gains scheduled along the way.

    An arm that starts at its goal is held there more tightly. Of a task whose goal moves it follows the path of the
    goal instead. Other arguments and errors are those of `LQR`.

    Args:
        law: of the slew, "minimum-jerk", "trapezoid" or "double-s".
    """

    kept = ("_now",)

    def __init__(
        self,
        model: Model,
        torque_limit: float | Vector,
        period: float,
        weights: Weights | None = None,
        law: str = "minimum-jerk",
    ) -> None:
        super().__init__(model, torque_limit, period, weights)
        self.law = one_of("law", law, LAWS)
        self._plans: list[GainSchedule] = []
        self._now = np.zeros(0, dtype=np.int64)

    def reset(self, arms: IntArray, episode: Episode) -> None:
        """Plans how the arms (r,) slew to their goals, or follow those that move."""
        if episode.reference is not None:
            self._follow(arms, episode.reference)
            return
        motors = self.model.motor_columns
        for arm, first, last in zip(arms, episode.start, episode.goal, strict=True):
            if np.array_equal(first, last):
                self._keep(int(arm), self._holding(last))
                continue
            slew = plan_slew(self.model, first, last, self.limits, SHARE, self.period, self.law)
            gains = np.array([self.gain(first + way * (last - first)) for way in np.linspace(0.0, 1.0, GAINS)])
            moved = slew.states[:, motors] - slew.states[0, motors]
            way = row_dots(moved, moved[-1]) / max(moved[-1] @ moved[-1], 1e-12)
            torques = np.vstack([slew.torques, holding_torques(self.model, last)])
            self._keep(int(arm), GainSchedule(slew.states, torques, gains, (GAINS - 1) * np.clip(way, 0.0, 1.0)))

    def _holding(self, posture: Array) -> GainSchedule:
        """Stays at a posture; nothing has to be saved for a slew, so that the tip weighs more."""
        tight = self.weights._replace(tip=HOLDING * self.weights.tip)
        held = holding_torques(self.model, posture)[None]
        return GainSchedule(rest_state(self.model, posture)[None], held, self.gain(posture, tight)[None], np.zeros(1))

    def _follow(self, arms: IntArray, postures: Array) -> None:
        """Plans how the arms (r,) follow goal postures (r, T + 1, n) rad, one for each control period."""
        for arm, path in zip(arms, postures, strict=True):
            slew = plan_path(self.model, path, self.period)
            rows = np.linspace(0, len(path) - 1, min(PATH_GAINS, len(path))).round().astype(int)
            gains = np.array([self.gain(path[row]) for row in rows])
            places = np.interp(np.arange(len(path)), rows, np.arange(len(rows)))
            self._keep(int(arm), GainSchedule(slew.states, np.vstack([slew.torques, slew.torques[-1:]]), gains, places))

    def _keep(self, arm: int, plan: GainSchedule) -> None:
        """Begins a plan of an arm."""
        empty = GainSchedule(*(np.zeros(0),) * 4)
        self._plans += [empty] * (arm + 1 - len(self._plans))
        self._now = grown(self._now, arm + 1)
        self._plans[arm], self._now[arm] = plan, 0

    def torques(self, states: Array) -> Array:
        """Gives torques (b, n) N m for states (b, 2 d), and moves on by a period."""
        result = np.zeros((len(states), self.model.n_joints))
        for arm, state in enumerate(states):
            plan = self._plans[arm]
            row = min(self._now[arm], len(plan.states) - 1)
            lower = min(int(plan.places[row]), max(len(plan.gains) - 2, 0))
            upper, part = min(lower + 1, len(plan.gains) - 1), plan.places[row] - lower
            gain = plan.gains[lower] + part * (plan.gains[upper] - plan.gains[lower])
            result[arm] = plan.torques[row] - row_dots(gain, state - plan.states[row])
        self._now += 1
        return result

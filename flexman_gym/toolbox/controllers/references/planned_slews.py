"""Slews optimised in an episode: shooting from a predicted slew, and LQR about the simulated states of the plan."""

from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from flexman_gym.agent.base_controllers import ControllerEntry
from flexman_gym.agent.controller import EpisodeInfo, Plant
from flexman_gym.common.arrays import Array, IntArray, pad_rows
from flexman_gym.common.checks import flag, non_negative, text
from flexman_gym.metrics.signals import BAND
from flexman_gym.model.model import Model
from flexman_gym.model.statics import holding_torques, rest_state
from flexman_gym.toolbox.controllers.arm_scales import NAMED_SLEW, ArmScales
from flexman_gym.toolbox.controllers.cost_weights import parse_weights
from flexman_gym.toolbox.controllers.internal_model import InternalModels
from flexman_gym.toolbox.controllers.lqr import FEEDFORWARD_FRACTION, GainSchedule, TrackingLQR
from flexman_gym.toolbox.controllers.references.optimised_slews import SlewTable
from flexman_gym.toolbox.controllers.references.single_shooting import (
    SingleShooting,
    SlewTorques,
    interpolate_torques,
)
from flexman_gym.toolbox.controllers.references.slew_regression import SlewRegression
from flexman_gym.toolbox.controllers.references.trajectories import QUINTIC, plan_slew

LEARNED_TABLE = Path(__file__).parent / "tables" / "FlexRRR-v0-learned.npz"
# Times of the computer, which do not scale with the arm: a Jacobian with its steps, for the arm of FlexRRR-v0
JACOBIAN_TIME = 0.15  # s; declared computing time
THINKING, MOVING_TIME = 1.95, 0.45  # s; largest planning time before a slew, and planning time while the arm moves
GAIN_POSTURES = 5  # number of postures along a plan at which gains are designed
PLANNED, PREDICTED, TRACKED = range(3)  # status of a plan: optimised; predicted and not optimised; slew of the LQR


class PlannedLQR(TrackingLQR):
    """LQR about the simulated states of a slew that is optimised at the start of each episode.

    The torques begin as those of similar slews by regression, or of a planned slew without a table of the arm. Single
    shooting brings the tip into the band in the shortest time that a fixed number of Jacobians finds. The number
    follows from the declared planning time, so that results do not depend on the computer. Plans of arms and episodes
    are independent of each other. If no slew settles, the arm tracks the slew of `TrackingLQR`.

    With `moving` the first torques of the prediction are applied during the planning time, and the remaining ones are
    optimised from the state at its end. If that fails, the prediction is applied to its end.

    Args:
        plant: plant model.
        regression: predicted slews of the arm; None for none.
        thinking: largest planning time, s; 0 applies the prediction; None for THINKING, or MOVING_TIME.
        moving: True to move during the planning time.
        given: weights and scales, see `LQR`.

    Attributes:
        status: (b,) PLANNED, PREDICTED or TRACKED.
        arrivals: (b,) planned time from which the tip stays within the band, s; infinite without a plan.
        jacobians: (b,) number of Jacobians of the plan.
    """

    def __init__(
        self,
        plant: Plant,
        regression: SlewRegression | None = None,
        thinking: object = None,
        moving: bool = False,
        **given: Any,
    ) -> None:
        super().__init__(plant.model, plant.torque_scales, plant.period, timing=QUINTIC, **given)
        self._regression, self._moving = regression, moving
        usual = MOVING_TIME if moving else THINKING
        self.thinking = non_negative("base.thinking", usual if thinking is None else thinking, "s")
        self._budget = round(self.thinking / JACOBIAN_TIME)
        self._models, self._rate_limit = InternalModels(plant), plant.rate_limit
        self._band = BAND * float(plant.model.constants.length.sum())
        self.status, self.arrivals, self.jacobians = np.zeros(0, dtype=np.int64), np.zeros(0), np.zeros(0, np.int64)

    @property
    def estimates(self) -> dict[str, Array]:
        """Status, planned arrival (s) and declared planning time (s) of the plans, (b,) each, for `info`."""
        time = JACOBIAN_TIME * self.jacobians
        return {"plan_status": self.status.astype(float), "plan_arrival": self.arrivals, "planning_time": time}

    def reset(self, arms: IntArray, episode: EpisodeInfo, count: int) -> None:
        """Plan the slews of new episodes; moving goals and arms at their goal are tracked as by `TrackingLQR`."""
        for name in ("status", "arrivals", "jacobians"):
            setattr(self, name, pad_rows(getattr(self, name), count))
        self.status[arms], self.arrivals[arms], self.jacobians[arms] = TRACKED, np.inf, 0
        if episode.reference is None:
            for arm, start, goal in zip(arms.tolist(), episode.start, episode.goal, strict=True):
                if not np.array_equal(start, goal):
                    self._plan(arm, start, goal)
        left = self.status[arms] == TRACKED
        if left.any():
            super().reset(arms[left], replace(episode, start=episode.start[left], goal=episode.goal[left]), count)

    def _plan(self, arm: int, start: Array, goal: Array) -> None:
        """Plan the slew of an arm between motor angles (n,) rad, and start it if a plan or a prediction exists."""
        guess = self._guess(start, goal)
        applied = self._applied_meanwhile(guess, len(start))
        state = self._roll(rest_state(self.model, start), applied)[-1] if len(applied) else start
        found = None
        if self._budget:
            found, self.jacobians[arm] = self._optimise(guess, (state, goal), len(applied))
        if found is not None:
            torques = np.vstack([applied, interpolate_torques(found.knots, found.periods)])
            self.status[arm], self.arrivals[arm] = PLANNED, (len(applied) + found.arrival) * self.period
        elif guess is not None and self._regression is not None:
            torques = interpolate_torques(guess.knots, guess.periods)
            self.status[arm] = PREDICTED
        else:
            return
        self._start(arm, self._plan_schedule(start, goal, torques))

    def _applied_meanwhile(self, guess: SlewTorques | None, joints: int) -> Array:
        """Return the torques (T, n), N m, of a guess that the arm applies during the planning time."""
        if guess is None or not (self._moving and self._budget):
            return np.zeros((0, joints))
        count = min(round(self.thinking / self.period), guess.arrival // 2)
        return interpolate_torques(guess.knots, guess.periods)[:count]

    def _guess(self, start: Array, goal: Array) -> SlewTorques | None:
        """Return the first guess of a slew between motor angles (n,) rad; None to begin with the search of shooting."""
        if self._regression is not None:
            return self._regression.predict(start, goal)
        if not self._moving:
            return None
        bounds = self.scales.bounds(self.limits, FEEDFORWARD_FRACTION)
        torques = plan_slew(self.model, start, goal, bounds, self.period).torques
        return SlewTorques(torques, len(torques), len(torques))

    def _optimise(
        self, guess: SlewTorques | None, ends: tuple[Array, Array], first: int
    ) -> tuple[SlewTorques | None, int]:
        """Return the slew optimised from a guess, of which the first periods are over, and the number of Jacobians.

        The slew is None if none settles. The ends are those of `SingleShooting`.
        """
        slowness = self.scales.slew / NAMED_SLEW
        shooting = SingleShooting(
            self, lambda count: self._models("plans", count), self._band, self._rate_limit, ends,
            self._budget, slowness,
        )  # fmt: skip
        if guess is None:
            return shooting.search(), shooting.jacobians
        if first:
            knots = interpolate_torques(guess.knots, guess.periods)[first:]
            guess = SlewTorques(knots, len(knots), guess.arrival - first)
        return shooting.first(guess), shooting.jacobians

    def _roll(self, state: Array, torques: Array) -> Array:
        """Return the states (T + 1, 2 d) from a state (2 d,) under torques (T, n), N m."""
        batch, drives = self._models("plan", 1), np.zeros((1, len(torques), len(self.limits) + 6))
        drives[0, :, : len(self.limits)] = np.clip(torques / self.limits, -1.0, 1.0) * self.limits
        batch.reset(np.zeros(1, dtype=np.int64), state[None])
        return np.vstack([state, batch.roll(drives)[0][0]]) if len(torques) else state[None]

    def _plan_schedule(self, start: Array, goal: Array, torques: Array) -> GainSchedule:
        """Return the schedule of a plan: simulated states, torques (T, n), and gains at postures along its motion."""
        states = self._roll(rest_state(self.model, start), torques)
        states[-1] = rest_state(self.model, goal)
        rows = np.linspace(0, len(torques), GAIN_POSTURES).round().astype(int)
        gains = np.array([self.gain(states[row, self.model.motor_columns]) for row in rows])
        positions = np.interp(np.arange(len(states)), rows, np.arange(len(rows)))
        return GainSchedule(states, np.vstack([torques, holding_torques(self.model, goal)]), gains, positions)


@lru_cache(maxsize=4)
def _regression(
    path: Path, written: float, plant: tuple[Model, tuple[float, ...], float], own: bool
) -> SlewRegression | None:
    """Return the regression of a table, whose fit takes seconds; None for a shipped table of another arm.

    Args:
        path: path of the table.
        written: time at which the file was written, s.
        plant: model, torque limits (n,) N m, and control period, s.
        own: True for a table of the user.

    Raises:
        ValueError: for a table of the user for another arm.
    """
    (model, given, period), slews = plant, SlewTable.load(path)
    limits = np.array(given)
    arm = SlewTable.fingerprint(model, limits, period)
    if own:
        slews.check_arm(arm)
    return SlewRegression.of_model(slews, model, limits) if slews.is_of(arm) else None


def _make(
    plant: Plant, table: object = None, thinking: object = None, moving: object = False, **given: Any
) -> PlannedLQR:
    scales = ArmScales.of_plant(plant, given.pop("design", None))
    path = LEARNED_TABLE if table is None else Path(text("base.table", table))
    written = path.stat().st_mtime if path.exists() else 0.0
    regression = _regression(path, written, (plant.model, plant.torque_limit, plant.period), table is not None)
    weights = parse_weights(given.pop("weights", None), scales)
    return PlannedLQR(plant, regression, thinking, flag("base.moving", moving), weights=weights, scales=scales, **given)


ENTRY = ControllerEntry(
    _make,
    ("model", "true state"),
    ("table", "thinking", "moving", "weights", "design"),
    "a slew optimised at the start of each episode, and a linear-quadratic regulator about its simulated states",
)

"""Slews optimised in an episode: shooting from a predicted slew, and LQR about the simulated states of the plan."""

from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from flexman_gym.agent.base_controllers import ControllerEntry
from flexman_gym.agent.controller import EpisodeInfo, Plant
from flexman_gym.common.arrays import Array, IntArray, pad_rows
from flexman_gym.common.checks import non_negative, text
from flexman_gym.metrics.signals import BAND
from flexman_gym.model.model import Model
from flexman_gym.model.statics import holding_torques, rest_state
from flexman_gym.toolbox.controllers.arm_scales import NAMED_SLEW, ArmScales
from flexman_gym.toolbox.controllers.cost_weights import parse_weights
from flexman_gym.toolbox.controllers.internal_model import InternalModels
from flexman_gym.toolbox.controllers.lqr import GainSchedule, TrackingLQR
from flexman_gym.toolbox.controllers.references.optimised_slews import SlewTable
from flexman_gym.toolbox.controllers.references.single_shooting import (
    SingleShooting,
    SlewTorques,
    interpolate_torques,
    simulate_torques,
)
from flexman_gym.toolbox.controllers.references.slew_regression import SlewRegression
from flexman_gym.toolbox.controllers.references.trajectories import QUINTIC

LEARNED_TABLE = Path(__file__).parent / "tables" / "FlexRRR-v0-learned.npz"
# Times of the computer, which do not scale with the arm: a Jacobian with its steps, for the arm of FlexRRR-v0
JACOBIAN_TIME = 0.15  # s; declared computing time
THINKING = 1.95  # s; largest planning time before a slew
GAIN_POSTURES = 5  # number of postures along a plan at which gains are designed
PLANNED, PREDICTED, TRACKED = range(3)  # status of a plan: optimised; predicted and not optimised; slew of the LQR


class PlannedLQR(TrackingLQR):
    """LQR about the simulated states of a slew that is optimised at the start of each episode.

    The torques begin as those of similar slews by regression, or of a planned slew without a table of the arm. Single
    shooting brings the tip into the band in the shortest time that a fixed number of Jacobians finds. The number
    follows from the declared planning time, so that results do not depend on the computer. Plans of arms and episodes
    are independent of each other. If no slew settles, the arm tracks the slew of `TrackingLQR`.

    Args:
        plant: plant model.
        regression: predicted slews of the arm; None for none.
        thinking: largest planning time, s; 0 applies the prediction.
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
        thinking: float = THINKING,
        **given: Any,
    ) -> None:
        super().__init__(plant.model, plant.torque_scales, plant.period, timing=QUINTIC, **given)
        self._regression, self.thinking = regression, thinking
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
        found, self.jacobians[arm] = self.find(start, goal)
        if found is not None:
            self.status[arm], self.arrivals[arm] = PLANNED, found.arrival * self.period
        elif self._regression is not None:
            found, self.status[arm] = self._regression.predict(start, goal), PREDICTED
        else:
            return
        self._start(arm, self._plan_schedule(start, goal, interpolate_torques(found.knots, found.periods)))

    def find(self, start: Array, goal: Array) -> tuple[SlewTorques | None, int]:
        """Return the slew optimised between motor angles (n,) rad, and the number of Jacobians.

        Without a table of the arm the search of `SingleShooting` begins with a planned slew.

        Returns:
            Slew, None if none settles; number of Jacobians.
        """
        if not self._budget:
            return None, 0
        shooting = SingleShooting(
            self, lambda count: self._models("plans", count), self._band, self._rate_limit, (start, goal),
            self._budget, self.scales.slew / NAMED_SLEW,
        )  # fmt: skip
        found = shooting.search() if self._regression is None else shooting.first(self._regression.predict(start, goal))
        return found, shooting.jacobians

    def motion(self, start: Array, goal: Array) -> tuple[tuple[Array, Array] | None, int]:
        """Return simulated states (T + 1, 2 d) and torques (T, n), N m, of the slew of `find`, and its Jacobians."""
        found, jacobians = self.find(start, goal)
        if found is None:
            return None, jacobians
        torques = interpolate_torques(found.knots, found.periods)
        return (self._states(start, goal, torques), torques), jacobians

    def roll(self, state: Array, torques: Array) -> Array:
        """Return the states (T + 1, 2 d) from a state (2 d,) under torques (T, n), N m."""
        applied = np.clip(torques / self.limits, -1.0, 1.0) * self.limits
        return simulate_torques(self._models("plan", 1), state, applied)

    def _states(self, start: Array, goal: Array, torques: Array) -> Array:
        """Return the states (T + 1, 2 d) under torques (T, n), N m, between equilibria at motor angles (n,) rad."""
        result = self.roll(rest_state(self.model, start), torques)
        result[-1] = rest_state(self.model, goal)
        return result

    def _plan_schedule(self, start: Array, goal: Array, torques: Array) -> GainSchedule:
        """Return the schedule of a plan: simulated states, torques (T, n), and gains at postures along its motion."""
        states = self._states(start, goal, torques)
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


def make_planned(plant: Plant, table: object = None, thinking: object = THINKING, **given: Any) -> PlannedLQR:
    """Return the controller of the entry "planned" for a plant, see `PlannedLQR`."""
    scales = ArmScales.of_plant(plant, given.pop("design", None))
    path = LEARNED_TABLE if table is None else Path(text("base.table", table))
    written = path.stat().st_mtime if path.exists() else 0.0
    regression = _regression(path, written, (plant.model, plant.torque_limit, plant.period), table is not None)
    weights = parse_weights(given.pop("weights", None), scales)
    thinking = non_negative("base.thinking", thinking, "s")
    return PlannedLQR(plant, regression, thinking, weights=weights, scales=scales, **given)


ENTRY = ControllerEntry(
    make_planned,
    ("model", "true state"),
    ("table", "thinking", "weights", "design"),
    "a slew optimised at the start of each episode, and a linear-quadratic regulator about its simulated states",
)

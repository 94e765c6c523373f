"""Episodes of many arms: action space, motors, limits and rewards, the core of both environments."""

from collections.abc import Callable, Mapping, Sequence
from copy import copy
from functools import partial
from typing import Any

import numpy as np
from gymnasium import spaces

from flexman_gym.common.arrays import Array, BoolArray, IntArray
from flexman_gym.common.checks import number_array, one_of, value_error
from flexman_gym.common.snapshot import get_state, set_state
from flexman_gym.control.actions import ActionMode, make_action_mode
from flexman_gym.control.agent import Agent
from flexman_gym.control.controller import Controller, EpisodeInfo
from flexman_gym.envs.active_effects import ActiveEffects
from flexman_gym.envs.config.configuration import Configuration
from flexman_gym.envs.config.reset_options import parse_reset_options, replace_tip_positions
from flexman_gym.envs.config.specification import make_base_controller, make_plant
from flexman_gym.envs.effects import EffectContext
from flexman_gym.envs.limits import limit_violation
from flexman_gym.envs.measurements import Measurements
from flexman_gym.envs.sensors import SensorArray, find_sensors, measured_names
from flexman_gym.envs.sensors.sensor import MeasuredView
from flexman_gym.envs.tasks.rewards import reward_terms, sum_terms
from flexman_gym.envs.tasks.task import goal_path
from flexman_gym.envs.view import Number, View
from flexman_gym.kernels import layout
from flexman_gym.kernels.control_period import all_within, apply_actions, count_episode_periods, flag_violations
from flexman_gym.model.model import Model
from flexman_gym.simulation.batch import Batch
from flexman_gym.simulation.trajectory import energy_alarm

ROUNDING = 1e-6  # of float32 and of what is computed in it, on numbers near 1


def action_space(size: int) -> spaces.Space[Any]:
    """The space of actions of one arm, of so many numbers."""
    return spaces.Box(-1.0, 1.0, (size,), dtype=np.float32)


def make_base_and_mode(setup: Configuration, model: Model) -> tuple[Controller | None, ActionMode]:
    """Return base controller and action mode of the agent of an environment, designed for a model of its arm."""
    base = make_base_controller(setup, model)
    return base, make_action_mode(setup.actions, make_plant(setup, model), base)


def validate_actions(name: str, value: object, shape: tuple[int, ...], allowed: str) -> Array:
    """The actions as a new array of floats; raises ValueError for another shape and for numbers outside -1 to 1.

    Numbers beyond by what float32 may round, less than 1e-6, count as -1 or 1.
    """
    if isinstance(value, np.ndarray) and value.shape == shape and value.dtype.kind == "f":
        actions = value.astype(np.float64, order="C")
    else:
        actions = number_array(name, value, shape, allowed).astype(np.float64, order="C")
    if all_within(actions.ravel(), 1.0):
        return actions
    if np.count_nonzero(np.abs(actions) < 1.0 + ROUNDING) == actions.size:
        return np.clip(actions, -1.0, 1.0)
    raise value_error(name, value, allowed)


class _Motors:
    """The motors of b arms of n joints, and what else drives the arms.

    Attributes:
        limits: (b, n) N m, the torque limits, which effects may change.
        drive: (b, n + 6) of `Batch.step`, of which the following are views.
        torques: (b, n) N m, of the last control period.
        forces: (b, 3) N, on the tips in the base frame.
        accelerations: (b, 3) m/s^2, of the bases in the base frame.
        reached: (b, n) where drives with a bandwidth are, parts of the limits; they start at 0.
    """

    state_fields = ("limits", "forces", "accelerations", "reached")

    def __init__(self, limits: Sequence[float], arms: int, lag: tuple[float, float] | None = None) -> None:
        joints = len(limits)
        self.limits, self._lag = np.tile(limits, (arms, 1)), lag
        self.reached = np.zeros((arms, joints if lag else 0))
        self.drive = np.zeros((arms, joints + 6))
        self.torques, self.forces = self.drive[:, :joints], self.drive[:, joints : joints + 3]
        self.accelerations = self.drive[:, joints + 3 :]

    def followed(self, actions: Array) -> Array:
        """What torques (b, n) are in the mean of a period for arriving actions (b, n), parts of the limits.

        Drives that lag follow them late; see `control.margins.first_order_lag`.
        """
        if self._lag is None:
            return actions
        missing = self.reached - actions
        self.reached[:] = actions + self._lag[0] * missing
        return actions + self._lag[1] * missing


class Episodes:
    """b arms with a task, sensors and limits. What it does to an arm depends on no other arm, bit for bit.

    Attributes:
        batch, view: the arms, and what they do in words.
        task, measurements: what they are for, and what is measured of them.
        agent: observation, history, action repeat, action mode and base; the environment asks it once a control period.
        effects: of the randomisation and of the task, None without any.
        failures: of the last step, arm -> what happened.
        over, truncated: (b,) whether an arm's episode is over, by a failure or because it has lasted `longest` control
            periods; and whether by the latter.
        watch: called after every control period, also those within an action that is kept; None for nothing.
    """

    state_fields = ("batch", "motors", "effects", "view", "measurements", "over", "truncated", "_ages", "_failed")

    def __init__(self, setup: Configuration, batch: Batch) -> None:
        self.batch, self.task, self.view = batch, setup.task, View(batch)
        self._reward_terms = reward_terms(setup.task, setup.reward)
        self._terms: dict[str, Number] | None = None  # of the present state, once they are needed
        self._present: View | None = None
        arms = len(batch.rows)
        self._limits = np.concatenate(list(setup.limits.bounds(self.view).values()))
        self.motors = _Motors(setup.torque_limit, arms, setup.lag)
        base, mode = make_base_and_mode(setup, batch.model)
        observed, inner = [*setup.sensors, *setup.task.sensors], find_sensors(mode.sensors)
        self.effects = self._effects(setup, [*observed, *inner])
        self.measurements = Measurements(self.view, setup.limits, observed, inner, self.effects)
        size = len(self.measurements.sensors.bound)
        self.agent = Agent(observed, size, mode, base, setup.history, setup.action_repeat)
        self.agent.allocate(arms, setup.control_period)
        self._energy_alarm, self._told = setup.energy_alarm, setup.tell
        for name in setup.tell:
            one_of("tell", name, (*self.view.units, "action"))
        self.longest = self._path = setup.longest
        self.watch: Callable[[], None] | None = None
        self.failures: dict[int, str] = {}
        self.over, self.truncated = np.ones(arms, dtype=bool), np.zeros(arms, dtype=bool)
        self._unseen, self._unbounded = np.zeros((arms, 0)), np.zeros(0)
        self._ages, self._beyond = np.zeros(arms, dtype=np.int64), np.zeros(arms, dtype=bool)
        self._all = np.ones(arms, dtype=bool)

    def _effects(self, setup: Configuration, sensors: Sequence[object]) -> ActiveEffects | None:
        """What disturbs the arms, of the randomisation and of the task."""
        randomisation = setup.disturbed
        if randomisation is None:
            return None
        bound = MeasuredView(self.view, setup.limits, measured_names(sensors)).bound
        nominal = np.array(setup.torque_limit)
        stage = EffectContext(self.batch, setup.limits, bound, self.motors.limits, nominal, randomisation.impulse_gap)
        return ActiveEffects(randomisation, stage)

    @property
    def base(self) -> Controller | None:
        """The controller that acts beside the agent, None without one."""
        return self.agent.base

    @property
    def sensors(self) -> SensorArray:
        """What is seen of the arms."""
        return self.measurements.sensors

    def set_state(self, data: object, agent: object, randoms: Sequence[np.random.Generator | None]) -> None:
        """Puts all arms, and what acts on them, where they were when `snapshot.get_state` read the data of both.

        Args:
            data: what was taken of the arms.
            agent: what was taken of the agent.
            randoms: the generators of the arms, given back already.

        Raises:
            ValueError: one line, for data of other arms; all episodes are then over.
        """
        view = self.view
        if self.effects is not None:
            self.effects.drawn = get_state(self.effects.drawn)  # the present one may be in somebody's hands
        self.over[:] = True
        set_state("state.episodes", self, data)
        if view.plan:  # a base makes again what it does not remember
            posture = self.task.goal(view.plan, np.zeros(len(self.over)), view).angles
            self._begin_agent(np.arange(len(self.over)), view.plan, posture)
        set_state("state.agent", self.agent, agent)
        if self.effects is not None:
            self.effects.follow(randoms)
        view.renew()
        self.forget()
        self.measurements.renew(randoms)

    @property
    def _failed(self) -> dict[str, str]:
        """What happened to the arms of `failures`, by their number as a text."""
        return {str(arm): text for arm, text in self.failures.items()}

    @_failed.setter
    def _failed(self, texts: dict[str, str]) -> None:
        self.failures = {int(arm): str(text) for arm, text in texts.items()}

    def reset(
        self, arms: IntArray, randoms: Sequence[np.random.Generator], options: Mapping[str, Any] | None = None
    ) -> None:
        """Starts new episodes of the arms with the indices (r,), each drawn from its own generator.

        Options may set what the task draws, such as "start" and "goal_angles", for all arms or with a leading axis b,
        both also by places of the tip, "start_tip" and "goal_tip" (3,) m, see `replace_tip_positions`; and
        "parameters" of the arms from this episode on: a dict of what `Batch.vary` takes.

        Raises:
            ValueError: one line with field, value and what is allowed; the episodes of these arms are then over.
        """
        self.over[arms] = True
        drawn = [self.task.draw(random, self.view) for random in randoms]
        for each in drawn:
            self._check_plan(each)
        plan = {name: np.array([each[name] for each in drawn]) for name in drawn[0]} if drawn else {}
        given = parse_reset_options(options, plan, (len(self.over), self.batch.model.n_joints))
        parameters = {name: values[arms] for name, values in given.pop("parameters", {}).items()}
        if self.effects is not None:
            parameters = self.effects.draw(arms, randoms, parameters)
        if parameters:
            self.batch.vary(arms, **parameters)
        plan = replace_tip_positions(plan | {name: values[arms] for name, values in given.items()}, self.view)
        self._set_goal(arms, plan)
        start = self.view.rest_states(plan["start"])
        if self.effects is not None:
            self.effects.change_start(arms, start)
        self.batch.reset(arms, start)
        self.motors.reached[arms] = 0.0
        self.view.effort[arms], self.view.failed[arms], self.view.action[arms] = 0.0, False, 0.0
        self._ages[arms], self.truncated[arms] = 0, False
        self.view.read()
        self.forget()
        self.measurements.begin(arms, randoms)
        self._check_start(arms, options)
        self._begin_agent(arms, plan, self.view.goal_angles[arms])
        self.failures = {arm: text for arm, text in self.failures.items() if arm not in arms}
        self._observe(np.isin(np.arange(len(self.over)), arms))
        self.over[arms] = False

    def _check_plan(self, plan: object) -> None:
        """Refuses what a task draws without a start that has an angle for each joint."""
        n = self.batch.model.n_joints
        if not isinstance(plan, dict) or np.shape(plan.get("start", ())) != (n,):
            raise value_error("task.draw", plan, f'a dict with "start", {n} joint angles (rad)')

    def _set_goal(self, arms: IntArray, plan: Mapping[str, Array]) -> None:
        """Keeps the plans of new episodes and sets their goals."""
        view = self.view
        for name, values in plan.items():
            if name not in view.plan:
                view.plan[name] = np.zeros((len(self.over), *values.shape[1:]), dtype=values.dtype)
            view.plan[name][arms] = values
        view.target[arms], view.goal_angles[arms] = self.task.goal(plan, np.zeros(len(arms)), view)
        view.target_velocity[arms] = view.goal_rates[arms] = 0.0

    def _begin_agent(self, arms: IntArray, plan: Mapping[str, Array], posture: Array) -> None:
        """Start new episodes of the arms (r,) of the agent, with plans (r, ...) and first goals (r, n) rad."""
        task, view = self.task, self.view
        path = partial(goal_path, task, plan, self._path, view) if task.moves else None
        drawn = {name: values[arms] for name, values in self.effects.drawn.items()} if self.effects else {}
        self.agent.reset(arms, EpisodeInfo(plan["start"], posture, view.control_period, path, drawn), len(self.over))

    def _check_start(self, arms: IntArray, options: object) -> None:
        """Refuses a start beyond the limits of arms that have just been reset and read."""
        for arm in arms:
            if failure := self._broken(arm):
                field, value = ("options", options) if options else ("task", self.task)
                raise value_error(field, value, f"a start and a goal within the limits ({failure})")

    def step(self, commands: Array) -> Array:
        """Move all arms under commands (b, k) until the next ones are due, and return the rewards (b,).

        A reward is the mean of the control periods in which an arm moved. An arm whose episode ends on the way stays
        as it was then. One whose episode was over has no outcome worth reading before it is reset.
        """
        self.agent.command = commands
        if self.agent.action_repeat == 1:
            self._period(self._all)
            self._judge(self._all, last=True)
            self._observe(~self.view.failed if np.count_nonzero(self.view.failed) else self._all)
            return self.rewards()
        begun = playing = ~self.over
        rewards, count, due = np.zeros(len(commands)), np.zeros(len(commands)), False
        while not due:
            moving = self._all if playing.all() else playing
            self._period(moving)
            due = bool(self.agent.due(moving).any())
            self._judge(moving, due)
            rows = slice(None) if moving is self._all else moving
            rewards[rows] += self.rewards()[rows]
            count[rows] += 1.0
            playing = ~self.over
            due |= not np.count_nonzero(playing)
        self._observe(begun & ~self.view.failed)
        return rewards / np.maximum(count, 1.0)

    def _period(self, playing: BoolArray) -> None:
        """Moves the arms that are playing by one control period."""
        view, motors, everyone = self.view, self.motors, playing is self._all
        actions = np.ascontiguousarray(self.agent.act(self._readings(), view.action.copy(), ~self.over))
        arriving = actions
        if self.effects is not None:
            arriving = np.ascontiguousarray(self.effects.motor_actions(actions))
            self.effects.disturb(motors.forces, motors.accelerations, self.over)
        arriving = motors.followed(arriving)
        apply_actions(actions, arriving, motors.limits, playing, motors.drive, view.action, view.effort)
        self.batch.step(motors.drive, None if everyone else playing)
        if self.task.moves:
            self._move_goals(playing)
        view.read()
        self.forget()
        self.measurements.sample(None if everyone else np.flatnonzero(playing))

    def _judge(self, playing: BoolArray, last: bool) -> None:
        """Ends the episodes of arms that are playing and have left their limits or lasted long enough.

        After the last period of an action it reads the sensors too, whose numbers have bounds of their own.
        """
        view = self.view
        if playing is self._all and np.count_nonzero(view.failed):
            self.failures, view.failed = {}, np.zeros_like(view.failed)
        observations, bound = self._unseen, self._unbounded
        if last:
            observations, bound = self.measurements.read(), self.sensors.bound
        if flag_violations(view.motion, self._limits, observations, bound, self.batch.status, self._beyond):
            self._fail(np.flatnonzero(self._beyond & playing))
        if count_episode_periods(self._ages, playing, self.longest, self.truncated):
            self.over |= self.truncated
        if self.watch is not None:
            self.watch()

    def _move_goals(self, playing: BoolArray) -> None:
        """Sets the goals of this moment, and how fast the targets have come there, of the arms that are playing."""
        view, arms = self.view, slice(None) if playing is self._all else playing
        goal = self.task.goal(view.plan, self.batch.time, view)
        view.target_velocity[arms] = (goal.target[arms] - view.target[arms]) / view.control_period
        view.goal_rates[arms] = (goal.angles[arms] - view.goal_angles[arms]) / view.control_period
        view.target[arms], view.goal_angles[arms] = goal.target[arms], goal.angles[arms]

    def _readings(self) -> dict[str, Array]:
        """Return the readings of the agent's mode, name -> (b, size)."""
        return self.measurements.readings if self.agent.mode.sensors else {}

    def _observe(self, arms: BoolArray) -> None:
        """Update the observations of the arms (b,)."""
        observed = self.measurements.read()
        self.agent.observe(observed, self._readings() if self.agent.shows else {}, self.view.action.copy(), arms)

    def _fail(self, arms: IntArray) -> None:
        for arm in arms[~self.over[arms]].tolist():
            status = self.batch.status[arm]
            self.failures[arm] = f"the simulation {layout.STATUS[status]}" if status else self._broken(arm)
        self.view.failed = self.view.failed.copy()
        self.view.failed[arms] = self.over[arms] = True

    def _broken(self, arm: int) -> str:
        """What of an arm is beyond its limits, or beyond what its sensors can say; "" where nothing is."""
        view, sensors = self.view, self.sensors
        failure = limit_violation(view.motion[arm], self._limits, view.places, view.units)
        return failure or limit_violation(sensors.observations[arm], sensors.bound, sensors.slices, sensors.units)

    @property
    def present(self) -> View:
        """View of all arms, or of the only one, whose numbers take less time than arrays of one."""
        if self._present is None:
            self._present = self.view if len(self.over) > 1 else self.view.alone()
        return self._present

    @property
    def terms(self) -> dict[str, Number]:
        """Reward terms of the control period just over, name -> (b,), or a number for one arm."""
        if self._terms is None:
            self._terms = self._reward_terms(self.present)
        return self._terms

    def forget(self) -> None:
        """Forget what was derived from the state before."""
        self._terms = self._present = None

    def rewards(self) -> Array:
        """Return the rewards (b,) of the control period just over."""
        result = sum_terms(self.terms)
        return result if isinstance(result, np.ndarray) and result.ndim else np.array([result] * len(self.over))

    def info(self) -> dict[str, Any]:
        """Return the numbers of the info, with an axis for the arms unless there is only one."""
        view = self.present
        residual = view.energy_residual
        return {
            "tip_error": view.tip_error,
            "tip_vibration": view.tip_vibration,
            "elastic_energy": view.elastic_energy,
            "energy_residual": residual,
            "energy_alarm": energy_alarm(residual, view.energy_turnover, self._energy_alarm),
            "reward_terms": dict(self.terms),
            **{name: copy(value) for name, value in self.task.info(view).items()},  # what a view has goes on
            **{name: copy(getattr(view, name)) for name in self._told},
        }

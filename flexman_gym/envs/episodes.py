"""Episodes of b arms: actions, motors, limits and rewards, used by `FlexManEnv` (b = 1) and `FlexManVectorEnv`."""

from collections.abc import Callable, Mapping, Sequence
from copy import copy
from functools import partial, reduce
from operator import add
from typing import Any

import numpy as np
from gymnasium import spaces

from flexman_gym.agent.agent import Agent
from flexman_gym.agent.controller import Controller, EpisodeInfo
from flexman_gym.common.arrays import Array, BoolArray, IntArray
from flexman_gym.common.checks import number_array, one_of, sample_count
from flexman_gym.common.errors import value_error
from flexman_gym.common.snapshot import get_state, set_state
from flexman_gym.envs.active_effects import ActiveEffects
from flexman_gym.envs.compiled_period import CompiledPeriod
from flexman_gym.envs.config.base_and_mode import make_base_and_mode, make_safe
from flexman_gym.envs.config.configuration import Configuration
from flexman_gym.envs.config.reset_options import parse_reset_options, replace_tip_positions
from flexman_gym.envs.effects import EffectContext
from flexman_gym.envs.measurements import Measurements
from flexman_gym.envs.motors import Motors
from flexman_gym.envs.period import advance
from flexman_gym.envs.sensors import find_sensors
from flexman_gym.envs.sensors.sensor import MeasuredView
from flexman_gym.envs.sensors.sensor_array import SensorArray, measured_names
from flexman_gym.envs.tasks import Task
from flexman_gym.envs.tasks.rewards import make_reward_terms
from flexman_gym.envs.view import Number, View
from flexman_gym.kernels import control_period as kernels
from flexman_gym.kernels import layout
from flexman_gym.simulation.batch import Batch
from flexman_gym.simulation.physical_parameters import UNMODELLED

MAX_DRAWS = 1000  # draws of a task for an episode whose start and goal are in the workspace
ROUNDING = 1e-6  # largest rounding error of float32 actions near 1
ALLOWED_COMMANDS = "a number from -1 to 1 for each motor of each arm"


def validate_actions(name: str, value: object, shape: tuple[int, ...], allowed: str, clip: bool) -> Array:
    """Return actions as a new array of float64, after a check of their shape and of the range -1 to 1.

    Args:
        name: name of the argument, for the error message.
        value: the actions.
        shape: required shape.
        allowed: allowed values, for the error message.
        clip: True to clip finite values beyond the range. If it is False, only values beyond the range by less than
            1e-6, the rounding of float32, are clipped.

    Raises:
        ValueError: for any other value.
    """
    if isinstance(value, np.ndarray) and value.shape == shape and value.dtype.kind == "f":
        actions = value.astype(np.float64, order="C")
    else:
        actions = number_array(name, value, shape, allowed).astype(np.float64, order="C")
    if kernels.all_within(actions.ravel(), 1.0):
        return actions
    if not np.isfinite(actions).all():
        raise value_error(name, value, allowed)
    if clip or np.abs(actions).max() < 1.0 + ROUNDING:
        return np.clip(actions, -1.0, 1.0)
    raise value_error(name, value, f"{allowed}, or gym.make(..., clip_actions=True), which clips actions")


class Episodes:
    """Episodes of b arms with a task, an agent, sensors and limits.

    The motion of an arm does not depend on the other arms, bit for bit.

    Args:
        configuration: configuration of the environment.
        batch: simulated arms.

    Attributes:
        batch: simulated arms.
        view: named quantities of the arms.
        task: task of all arms.
        foundation: foundations of the arms, see `envs.foundation`; None for fixed bases.
        measurements: sensors of the agent and its action mode.
        agent: observations, history, action repeat, action mode and base controller.
        effects: disturbances and parameter draws enabled by the randomisation and by the task; None without any.
        failures: index of an arm -> cause of its failure in the last step.
        over: (b,) True for an arm whose episode has ended, or has not begun.
        truncated: (b,) True for an episode that ended after `max_periods` control periods.
        max_periods: control periods after which an episode is truncated.
        callback: function called after every control period; None for no function.
        limits: limits of the arms.
        cost: (b,) control periods of the last step with a violation, see `Limits`.
        every: (b,) True; the mask of all arms, recognised by its identity.
        ages: (b,) control periods of the episode.
        motion_limits: (m,) limits of the entries of `view.motion`.
        violated: (b,) True for an arm beyond its limits at the end of the last control period.
        excess: (b,) largest excess at the end of the last control period, see `Limits.excess`; 0 if not recorded.
    """

    state_fields: tuple[str, ...] = (
        "batch", "motors", "effects", "view", "measurements", "over", "truncated", "ages", "_failed",
    )  # fmt: skip

    def __init__(self, configuration: Configuration, batch: Batch) -> None:
        self.batch, self.task, self.view = batch, configuration.task, View(batch, configuration.slew_time)
        self.foundation: Any = None
        if configuration.foundation is not None:
            self.foundation = configuration.foundation.make(batch)
            self.state_fields = (*self.state_fields, "foundation")
        self.view.foundation = self.foundation
        self._compute_reward_terms = make_reward_terms(configuration.task, configuration.reward)
        self._reward_terms: dict[str, Number] | None = None  # reward terms of the current state; None until needed
        self._current_view: View | None = None
        arms = len(batch.rows)
        self.limits, self.cost, self.excess = configuration.limits, np.zeros(arms), np.zeros(arms)
        self.motion_limits = np.concatenate(list(self.limits.bounds(self.view).values()))
        self.motors = Motors(configuration.torque_limit, arms, configuration.lag)
        base, mode = make_base_and_mode(configuration, batch.model)
        mode = make_safe(configuration, batch.model, base, mode)
        own_sensors, mode_sensors = [*configuration.sensors, *configuration.task.sensors], find_sensors(mode.sensors)
        self.effects = self._make_effects(configuration, [*own_sensors, *mode_sensors])
        self.measurements = Measurements(self.view, configuration.limits, own_sensors, mode_sensors, self.effects)
        size = len(self.measurements.sensors.bound)
        self.agent = Agent(own_sensors, size, mode, base, configuration.history, configuration.action_repeat)
        self.agent.allocate(arms, configuration.control_period)
        self._energy_alarm, self._info_keys = configuration.energy_alarm, configuration.info_keys
        self._clips_actions = configuration.clip_actions
        for name in configuration.info_keys:
            one_of("info_keys", name, (*self.view.units, "action"))
        self.max_periods = self._path_periods = configuration.max_periods
        self.callback: Callable[[], None] | None = None
        self.failures: dict[int, str] = {}
        self.over, self.truncated = np.ones(arms, dtype=bool), np.zeros(arms, dtype=bool)
        self.ages, self.violated = np.zeros(arms, dtype=np.int64), np.zeros(arms, dtype=bool)
        self.every = np.ones(arms, dtype=bool)
        self._compiled = self._compile_period(configuration, own_sensors)

    def _compile_period(self, configuration: Configuration, sensors: list[object]) -> CompiledPeriod | None:
        """Return the compiled control period of a single arm; None where a control period needs Python code."""
        acts = self.effects is not None and self.effects.acts
        if len(self.over) > 1 or acts or not CompiledPeriod.supports(configuration, sensors, self.agent.mode):
            return None
        motors, ends = (self.motors.limits, self.motors.drive), (self.motion_limits, self.violated, self.ages)
        result = CompiledPeriod(configuration, self.batch, self.view, self.sensors, self.agent, motors, ends)
        return result if result.arguments else None

    def _make_effects(self, configuration: Configuration, sensors: Sequence[object]) -> ActiveEffects | None:
        """Return the disturbances and draws enabled by the randomisation and by the task; None without any."""
        randomisation = configuration.disturbances
        if randomisation is None:
            return None
        measured = MeasuredView(self.view, configuration.limits, measured_names(sensors))
        indices, strains = measured.instruments(sensors), measured.columns("root_strains")
        motors = self.motors.limits, np.array(configuration.torque_limit), randomisation.impulse_gap
        context = EffectContext(self.batch, configuration.limits, measured.bound, *motors, indices, strains)
        return ActiveEffects(randomisation, context)

    def make_spaces(self) -> tuple[spaces.Space[Any], spaces.Space[Any]]:
        """Return the observation space and the action space of one arm."""
        bound, size = self.agent.bound(self.sensors.bound).astype(np.float32), len(self.agent.mode.names)
        return spaces.Box(-bound, bound, dtype=np.float32), spaces.Box(-1.0, 1.0, (size,), dtype=np.float32)

    @property
    def base(self) -> Controller | None:
        """Base controller that acts together with the agent; None if there is no base controller."""
        return self.agent.base

    @property
    def safety(self) -> Any:
        """Safety filter of the agent; None without."""
        return getattr(self.agent.mode, "filter", None)

    @property
    def sensors(self) -> SensorArray:
        """Sensors of the agent."""
        return self.measurements.sensors

    def set_state(self, data: object, agent: object, randoms: Sequence[np.random.Generator | None]) -> None:
        """Set the state of all arms and of the agent from results of `get_state`.

        Args:
            data: state of the arms.
            agent: state of the agent.
            randoms: restored random generators of the arms.

        Raises:
            ValueError: for the state of different arms; all episodes are then over.
        """
        view = self.view
        if self.effects is not None:
            self.effects.drawn = get_state(self.effects.drawn)  # a copy: an earlier `info` may hold the old dict
        self.over[:] = True
        set_state("state.episodes", self, data)
        if view.episode_parameters:  # a base controller computes its trajectory again, which is not in the state
            posture = self.task.goal(view.episode_parameters, np.zeros(len(self.over)), view).angles
            self._begin_agent(np.arange(len(self.over)), view.episode_parameters, posture)
        set_state("state.agent", self.agent, agent)
        if self.effects is not None:
            self.effects.set_generators(randoms)
        view.refresh()
        self.clear_cache()
        self.measurements.refresh(randoms)

    @property
    def _failed(self) -> dict[str, str]:
        """Causes of the failures by the index of the arm, as a string."""
        return {str(arm): text for arm, text in self.failures.items()}

    @_failed.setter
    def _failed(self, texts: dict[str, str]) -> None:
        self.failures = {int(arm): str(text) for arm, text in texts.items()}

    def reset(
        self, arms: IntArray, randoms: Sequence[np.random.Generator], options: Mapping[str, Any] | None = None
    ) -> None:
        """Start new episodes of arms.

        Args:
            arms: (r,) indices of the arms.
            randoms: random generator of each of these arms.
            options: values by name, for all arms or with a leading axis b. Names of parameters drawn by the task, such
                as "start" and "goal_angles", replace the drawn values. "start_tip" and "goal_tip", tip positions (3,),
                m, replace "start" and "goal_angles". "parameters" are physical parameters of the arms from this episode
                on, see `Batch.vary`.

        Raises:
            ValueError: for options or a start that are not allowed; the episodes of these arms are then over.
        """
        self.over[arms] = True
        drawn = [self._draw(random) for random in randoms]
        parameters = {name: np.array([each[name] for each in drawn]) for name in drawn[0]} if drawn else {}
        given = parse_reset_options(options, parameters, (len(self.over), self.batch.model.n_joints))
        physical = {name: values[arms] for name, values in given.pop("parameters", {}).items()}
        if self.effects is not None:
            physical = self.effects.draw(arms, randoms, physical)
        if physical:
            self.batch.vary(arms, **physical)
        parameters = replace_tip_positions(
            parameters | {name: values[arms] for name, values in given.items()}, self.view
        )
        for name in ("start", "goal_angles"):
            if name in parameters:
                parameters[name] = self.view.hanging(parameters[name])
        self._set_goal(arms, parameters)
        start = self.view.rest_states(parameters["start"])
        if self.effects is not None:
            self.effects.change_start(arms, start)
        self.batch.reset(arms, start)
        self.motors.reached[arms] = 0.0
        self.view.effort[arms], self.view.failed[arms], self.view.action[arms] = 0.0, False, 0.0
        self.ages[arms], self.truncated[arms], self.cost[arms] = 0, False, 0.0
        self.view.refresh()
        self.clear_cache()
        self.measurements.begin(arms, randoms)
        self._check_start(arms, options)
        self._begin_agent(arms, parameters, self.view.goal_angles[arms])
        self.failures = {arm: text for arm, text in self.failures.items() if arm not in arms}
        self._observe(np.isin(np.arange(len(self.over)), arms))
        self.over[arms] = False

    def _draw(self, random: np.random.Generator) -> dict[str, Array]:
        """Return the parameters drawn by the task for one episode, with start and goal in the workspace."""
        n, view, limits = self.batch.model.n_joints, self.view, self.limits
        for _ in range(MAX_DRAWS):
            drawn = self.task.draw(random, view)
            if not isinstance(drawn, dict) or np.shape(drawn.get("start", ())) != (n,):
                raise value_error("task.draw", drawn, f'a dict with "start", {n} motor angles (rad)')
            if self.foundation is not None:
                drawn = drawn | self.foundation.draw(random)
            if limits.workspace is None:
                return drawn
            goal = self.task.goal({name: np.array([each]) for name, each in drawn.items()}, np.zeros(1), view).target
            if limits.contains(np.concatenate([goal, view.rest_tips(np.array([drawn["start"]]))])):
                return drawn
        raise value_error("limits.workspace", limits.workspace, f"one with start and goal in some of {MAX_DRAWS} draws")

    def _set_goal(self, arms: IntArray, parameters: Mapping[str, Array]) -> None:
        """Store the parameters (r, ...) of new episodes of the arms (r,) and set their goals."""
        view = self.view
        for name, values in parameters.items():
            if name not in view.episode_parameters:
                view.episode_parameters[name] = np.zeros((len(self.over), *values.shape[1:]), dtype=values.dtype)
            view.episode_parameters[name][arms] = values
        view.target[arms], view.goal_angles[arms] = self.task.goal(parameters, np.zeros(len(arms)), view)
        if self.foundation is not None:
            self.foundation.begin(arms, parameters)
            self.foundation.aim(view, arms)
        view.target_velocity[arms] = view.goal_rates[arms] = 0.0

    def _begin_agent(self, arms: IntArray, parameters: Mapping[str, Array], posture: Array) -> None:
        """Start episodes of the agent for the arms (r,), with parameters (r, ...) and initial goal postures (r, n)."""
        task, view = self.task, self.view
        path = partial(goal_path, task, parameters, self._path_periods, view) if task.moves else None
        if self.foundation is not None and self.foundation.moves_goals:
            path = partial(self.foundation.path, parameters, self._path_periods, view)
        drawn = self.effects.drawn if self.effects else {}
        drawn = {name: values[arms] for name, values in drawn.items() if name not in UNMODELLED}
        travel = None
        if self.foundation is not None:
            travel = self.foundation.ends(parameters)
        info = EpisodeInfo(parameters["start"], posture, view.control_period, path, drawn, travel)
        self.agent.reset(arms, info, len(self.over))

    def _check_start(self, arms: IntArray, options: object) -> None:
        """Check that arms are within their limits after a reset, and goals that options set within the angle limit."""
        for arm in arms:
            failure = self._violation(arm)
            far = np.flatnonzero(np.abs(self.view.goal_angles[arm]) > self.limits.angle)
            if options and not failure and len(far):
                angle = self.view.goal_angles[arm, far[0]]
                failure = f"goal of motor_angles {angle:.4g} rad beyond limits.angle, {self.limits.angle:g}"
            if failure:
                field, value = ("options", options) if options else ("task", self.task)
                raise value_error(field, value, f"a start and a goal within the limits ({failure})")

    def push(self, forces: Array) -> None:
        """Set forces (b, 3) at the tips in the base frame, N, which act until the next call; effects add theirs."""
        self.motors.pushes[:] = self.motors.forces[:] = forces

    def step(self, commands: Array | None = None) -> Array:
        """Simulate the arms for `action_repeat` control periods with commands (b, k); return rewards (b,).

        The commands are those of a trainer; None for those of the law of the agent.

        The reward is the mean over the control periods in which the arm moved. An arm whose episode ends earlier keeps
        its last state. The result of an arm without a running episode is undefined.
        """
        agent = self.agent
        if commands is None:
            shape, clips = agent.command.shape, self._clips_actions
            commands = validate_actions("actions", agent.decide(), shape, ALLOWED_COMMANDS, clips)
        agent.command = commands
        self.cost[:] = 0.0
        if agent.action_repeat == 1:
            advance(self, self.every)
            self._observe(~self.view.failed if np.count_nonzero(self.view.failed) else self.every)
            return self.rewards()
        begun = moving = ~self.over
        rewards, count, due = np.zeros(len(commands)), np.zeros(len(commands)), False
        while not due:
            moving = self.every if moving.all() else moving
            due = advance(self, moving)
            rows = slice(None) if moving is self.every else moving
            rewards[rows] += self.rewards()[rows]
            count[rows] += 1.0
            moving = ~self.over
            due |= not np.count_nonzero(moving)
        self._observe(begun & ~self.view.failed)
        return rewards / np.maximum(count, 1.0)

    def step_single(self, action: object) -> float | None:
        """Apply the action of the only arm in one call of a kernel, if a control period needs no Python code.

        Returns:
            The reward, equal to the reward of `step` to the bit; None if nothing was done and `step` must be called.
        """
        period = self._compiled
        if period is None or self.callback is not None or not period.set_action(action):
            return None
        result = self.batch.step_period(period.arguments)
        if result == kernels.NOT_DONE:
            return None
        self.agent.command = period.command
        self.clear_cache()
        if result == kernels.FAILED:
            self.fail(np.flatnonzero(self.violated))
        else:
            self._reward_terms = period.terms()
        if self.ages[0] >= self.max_periods:
            self.truncated[:] = self.over[:] = True
        return float(self._total_reward())

    @property
    def readings(self) -> dict[str, Array]:
        """Readings of the agent's action mode, name -> (b, size)."""
        return self.measurements.readings if self.agent.mode.sensors else {}

    def _observe(self, arms: BoolArray) -> None:
        """Update the observations of the arms selected by a mask (b,)."""
        observed, readings = self.measurements.read(), self.readings if self.agent.mode_observes else {}
        self.agent.observe(observed, readings, self.view.action.copy(), arms)

    def fail(self, arms: IntArray) -> None:
        """End the episodes of the arms (r,) after a violation or a divergence, with its cause."""
        for arm in arms[~self.over[arms]].tolist():
            status = self.batch.status[arm]
            self.failures[arm] = f"the simulation {layout.STATUS[status]}" if status else self._violation(arm)
        self.view.failed = self.view.failed.copy()
        self.view.failed[arms] = self.over[arms] = True

    def _violation(self, arm: int) -> str:
        """Describe the first limit or sensor bound exceeded by an arm; "" if it is within all of them."""
        view, sensors = self.view, self.sensors
        failure = self.limits.describe(view.motion[arm], self.motion_limits, view.slices, view.units)
        failure = failure or self.limits.violation(view, arm)
        return failure or self.limits.describe(sensors.observations[arm], sensors.bound, sensors.slices, sensors.units)

    @property
    def current_view(self) -> View:
        """View of the arms; of a single arm the view without the axis of the arms, which is faster."""
        if self._current_view is None:
            self._current_view = self.view if len(self.over) > 1 else self.view.single()
        return self._current_view

    @property
    def reward_terms(self) -> dict[str, Number]:
        """Reward terms of the last control period, name -> (b,), or a number for one arm."""
        if self._reward_terms is None:
            self._reward_terms = self._compute_reward_terms(self.current_view)
        return self._reward_terms

    def clear_cache(self) -> None:
        """Discard quantities derived from the previous state."""
        self._reward_terms = self._current_view = None

    def _total_reward(self) -> Number:
        """Return the sum of the reward terms, (b,) or a number for one arm.

        The built-in `sum` compensates rounding errors of floats, but not of arrays. The reward of a single arm would
        then differ in the last bit from its reward in a batch.
        """
        return reduce(add, self.reward_terms.values(), 0.0)

    def rewards(self) -> Array:
        """Return the rewards (b,) of the last control period."""
        result = self._total_reward()
        return result if isinstance(result, np.ndarray) and result.ndim else np.array([result] * len(self.over))

    def info(self) -> dict[str, Any]:
        """Return the numbers of the info by name, with an axis for the arms unless there is a single arm."""
        view = self.current_view
        residual = view.energy_residual
        info = {
            "tip_error": view.tip_error,
            "tip_vibration": view.tip_vibration,
            "elastic_energy": view.elastic_energy,
            "energy_residual": residual,
            "energy_alarm": abs(residual) > self._energy_alarm * view.energy_turnover,
            "reward_terms": dict(self.reward_terms),
        }
        if self.limits.recorded:
            info |= {"limits": self.limits.distances(view), "cost": self.cost.copy()}
            if len(self.over) == 1:
                info["cost"] = self.cost.item()
        if hasattr(self.agent.mode, "info"):
            own = self.agent.mode.info()
            info |= {name: each[0] for name, each in own.items()} if len(self.over) == 1 else own
        for name, value in self.task.info(view).items():
            info[name] = copy(value)  # as the arrays of a view change
        for name in self._info_keys:
            info[name] = copy(getattr(view, name))
        return info


def goal_path(task: Task, parameters: Mapping[str, Array], periods: int, view: View) -> Array:
    """Return goal postures (r, T + 1, n), rad, over T control periods of r episodes with parameters (r, ...)."""
    sample_count("control_period", view.control_period, periods * view.control_period)
    count, times = len(next(iter(parameters.values()))), view.control_period * np.arange(periods + 1.0)
    repeated = [{name: np.repeat(values[i : i + 1], len(times), 0) for name, values in parameters.items()}
                for i in range(count)]  # fmt: skip
    return np.array([task.goal(each, times, view).angles for each in repeated])

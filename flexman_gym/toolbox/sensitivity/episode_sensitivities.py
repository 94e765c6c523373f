"""Sensitivities of an episode: exact derivatives of a rollout with the agent in the loop.

The episode is simulated as in `rollout`. After each control period, the derivatives of the state follow from those at
its start by `PeriodMap`, and those of readings, commands and rewards by the chain rule.
"""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from flexman_gym.agent.agent import History
from flexman_gym.agent.controller import Controller, Readings
from flexman_gym.agent.mode_wrapper import ModeWrapper
from flexman_gym.common.arrays import Array, BoolArray
from flexman_gym.common.checks import one_of
from flexman_gym.common.errors import value_error
from flexman_gym.envs.config.configuration import Configuration
from flexman_gym.envs.episodes import Episodes
from flexman_gym.envs.foundation import check_fixed
from flexman_gym.envs.limits import Limits
from flexman_gym.envs.measurements import Measurements
from flexman_gym.envs.sensors import (
    FineScale,
    FullState,
    GoalCommand,
    Instrument,
    LastAction,
    ModelState,
    Quantities,
    ServoErrors,
    find_sensors,
)
from flexman_gym.envs.sensors.ideal import NEARNESS_LENGTH
from flexman_gym.envs.sensors.sensor import MeasuredView
from flexman_gym.envs.sensors.sensor_array import measured_names
from flexman_gym.envs.tasks import Hold, Slew, Track
from flexman_gym.envs.tasks.rewards import REWARDS
from flexman_gym.envs.view import View
from flexman_gym.evaluation.agent_spec import AgentSpec
from flexman_gym.evaluation.agents import find_agent
from flexman_gym.evaluation.rollouts import TEST_SEEDS, Rollout, rollout
from flexman_gym.kernels import layout
from flexman_gym.scene.arm import Arm
from flexman_gym.scene.scene import Scene
from flexman_gym.simulation.batch import Batch
from flexman_gym.simulation.period_map import PeriodMap
from flexman_gym.simulation.physical_parameters import PARAMETERS, ScalarParameter, select_parts
from flexman_gym.toolbox.sensitivity import differentiation
from flexman_gym.toolbox.sensitivity.differentiation import (
    INPUTS,
    OUTPUTS,
    Sensitivities,
    checked_names,
    constant_derivatives,
    count_kinks,
    find_directions,
    motion_output,
    unit_changes,
)

EPISODE_OUTPUTS = ("tip_error", "tip_vibration", "readings", "actions", "torques", "reward_terms", "reward", "return")
DIFFERENTIATED = (
    "zero, pd, pd-shaped, pd-torque, lqr, lqr-tracking, or a policy whose actions are torques, currents or references "
    "of servos"
)
LINEAR_SENSORS = (ModelState, GoalCommand, LastAction, ServoErrors, Quantities, FullState, FineScale)
SCALE = 2.0**-300  # factor on derivatives in sensors: below every range, within the linear part of every scale


def sensitivities(
    scene: Scene | str | Configuration,
    of: str | Sequence[str] = ("tip",),
    to: str | Sequence[str] = ("payload_mass",),
    agent: object = None,
    seed: int = TEST_SEEDS[0],
    **simulation: Any,
) -> Sensitivities:
    """Simulate a scene, or an episode of an agent, together with the derivatives of its outputs.

    Seven derivatives of a scene cost two to three simulations; those of an episode by the six gains of a PD cost three
    to four episodes. The values have the bits of `simulate` with the same step, or of `rollout`. The component modes of
    the model do not change with a parameter, as in `Batch.vary`; the derivative is exact for the model with these
    modes. Torques that begin or end at a time act as they do in the scene.

    In an episode the parameters of the arm change, while agent, goal, noise and disturbances stay those of the rollout.
    A torque at its limit has the derivative 0. Rounding to float32 and quantisation have the derivative 1. An episode
    that ends by a failure has the derivatives until then.

    Args:
        scene: a scene; or an environment: id, id and condition, path of a file, or Configuration.
        of: names of outputs: those of `linearize` without "tip_acceleration", "kinetic_energy", "elastic_energy" and
            "gravitational_energy". Of an episode also "tip_error", "tip_vibration", "readings" (of the agent's
            sensors), and at the end of each control period "actions" (commanded torques as fractions of the limits),
            "torques" (applied torques), "reward_terms", "reward" and "return" (sum of the rewards), 0 at the start.
        to: names of parameters, for all joints or links or, as in "joint_stiffness[0]", for one: those of `Batch.vary`,
            "initial_joint_angles" and "initial_joint_rates" (of joint and motor together), and a constant added to an
            input where its signal acts: "motor_torques", "tip_force" or "base_acceleration" (components x, y and z). Of
            a scene also dimensions in `differentiation.DIMENSIONS`, such as "link_length[0]", for which other kernels
            are compiled. Of an episode also gains of a controller, "stiffness" and "damping", and actions of the agent:
            "torque_1[3]" is its fourth action for the first motor, "position_1[3]" with the setting actions="position".
        agent: as in `rollout`, for an environment.
        seed: seed of the episode.
        **simulation: of a scene, `model`, `method` and `step` as in `simulate`: a model of its arm, a method of fixed
            steps, and the integration step (s), by default the longest step up to that of an environment. Of a method
            that iterates until it converges, the last iterations are differentiated; the result tends to the derivative
            of the converged solution as the tolerance of the method falls.

    Returns:
        Values and derivatives.

    Raises:
        ValueError: for an unknown output or parameter, a parameter that the arm lacks, a method without fixed steps,
            and an agent, sensor or reward without derivatives.

    Examples:
        >>> scene = fm.catalog.paper_scene("rr")
        >>> found = fm.sensitivities(scene, of="tip", to=("payload_mass", "viscous_friction[0]"))
        >>> found.jacobian.shape, found.parameters
        ((201, 3, 2), ('payload_mass (kg)', 'viscous_friction[0] (N m s/rad)'))
        >>> found = fm.sensitivities("FlexOne-v0", of="return", to=("stiffness", "damping"), agent="pd")
        >>> found.jacobian[-1, 0].shape
        (2,)
    """
    if isinstance(scene, Scene):
        if agent is not None:
            raise value_error("agent", agent, "None: a scene has no agent")
        return differentiation.sensitivities(scene, of, to, **simulation)
    if simulation:
        name, value = next(iter(simulation.items()))
        raise value_error(name, value, "none for an environment, whose settings contain model, method and step")
    if isinstance(scene, Arm):
        raise value_error("scene", type(scene).__name__, "a Scene, or an environment")
    if agent is None:
        raise value_error("agent", agent, f"an agent for an environment: {DIFFERENTIATED}")
    environment, spec = Configuration.find(scene), find_agent(agent)
    if environment.safety:
        raise value_error("safety", True, "False: the safety filter has no derivatives")
    check_fixed(environment.foundation, "the commands of a foundation have no derivatives")
    derivatives = _Derivatives(spec, environment, (checked_names("of", of), checked_names("to", to)))
    return derivatives.result(rollout(spec, environment, [seed], derivatives))


class _Derivatives(ModeWrapper):
    """Derivatives of an episode of one arm with respect to p parameters.

    As the callback of a rollout it follows the episode; as the action mode of its agent it precedes each action.

    Args:
        spec: agent.
        environment: environment without the settings of the agent.
        names: names of outputs and of parameters.
    """

    def __init__(self, spec: AgentSpec, environment: Configuration, names: tuple[list[str], list[str]]) -> None:
        self._spec, self._environment, (self._of, self._to) = spec, environment, names
        for name in self._of:
            one_of("of", name, [*OUTPUTS, *EPISODE_OUTPUTS])
        rewarded = environment.reward is None or isinstance(environment.reward, dict)
        rewarded &= type(environment.task) in (Slew, Hold, Track)
        if not rewarded and any(name.startswith("reward") or name == "return" for name in self._of):
            raise value_error("reward", environment.reward or environment.task, "a reward of a task of this library")
        self._mode: Any = None
        self._agent: Any = None
        self._records: dict[str, list[Array]] = {}
        self._diverged = False

    def __call__(self, episodes: Episodes) -> None:
        """Begin after the reset, and continue after each control period."""
        if self._mode is None:
            self._episodes, self._agent, self._mode = episodes, episodes.agent, episodes.agent.mode
            self._begin(episodes)
        elif not self._diverged:
            self._advance(episodes)
        if not self._diverged:
            self._record(episodes)
        self._row = episodes.batch.rows[0].copy()

    def _begin(self, episodes: Episodes) -> None:
        """Prepare the derivatives at the start, and take the place of the action mode."""
        agent, batch, model, law = self._agent, episodes.batch, episodes.batch.model, self._agent.law
        able = hasattr(agent.mode, "derivatives") and _differentiable(agent.base)
        if not able or not (law is None or hasattr(law, "derivatives")):
            raise value_error("agent", self._spec.name, f"one with derivatives: {DIFFERENTIATED}")
        self._directions = [each for text in self._to for each in self._find(text, episodes)]
        count, n = len(self._directions), model.n_joints
        drawn = {name: values[0] for name, values in episodes.effects.drawn.items()} if episodes.effects else {}
        self._delayed = [np.zeros((count, n))] * int(drawn.get("delay", 0))
        given = {name: np.asarray(value) for name, value in drawn.items() if name in PARAMETERS}
        changes = [constant_derivatives(model, each, given) if each.name in PARAMETERS else {}
                   for each in self._directions]  # fmt: skip
        period = batch.control_period, batch.substeps
        self._map = PeriodMap(model, batch.method, period, changes, batch.integrator(0).constants)
        self._rows, self._inputs = unit_changes(self._directions, model)
        self._outputs = self._map.outputs(batch.rows[0], self._rows)
        self._drives, self._actions = np.zeros((count, n + 6)), np.zeros((count, n))
        self._command, self._reached = np.zeros((count, len(self.names))), np.zeros((count, n))
        self._return = np.zeros((1 + count, 1))
        self._gains = {name: np.zeros((count, n)) for name in agent.mode.gain_units}
        for number, (name, part) in enumerate(self._directions):
            if name in self._gains:
                self._gains[name][number, part] = 1.0
        self._sensing = _Sensing(episodes, self._environment.limits, count)
        self._sensing.begin(self._rows, self._outputs)
        size = episodes.measurements.sensors.observations.shape[1]
        self._history = History(agent.history, agent.action_repeat * batch.control_period, count, size)
        self._periods, agent.mode = 0, self

    def _find(self, text: str, episodes: Episodes) -> list[ScalarParameter]:
        """Return the parameters of a name such as "stiffness" or "torque_1[3]"."""
        name, mode = text.partition("[")[0], self._mode
        if name in mode.gain_units:
            count = mode.joints
        elif name in mode.names:
            count = -(-episodes.max_periods // episodes.agent.action_repeat)
        else:
            one_of("to", name, [*INPUTS, *mode.gain_units, *mode.names])
            return find_directions(text, episodes.batch.model, ())
        return [ScalarParameter(name, part) for part in select_parts("to", text, range(count), count)]

    def act(self, actions: Array, readings: Readings, applied: Array, active: BoolArray) -> Array:
        """Compute the derivatives of the torques of this control period, and return the torques (1, n)."""
        agent, sensing, law = self._agent, self._sensing, self._agent.law
        if self._periods % agent.action_repeat == 0:
            step = self._periods // agent.action_repeat
            self._command = np.zeros_like(self._command)
            if law is not None:
                update = self._history.add if step else self._history.begin
                observed = update(sensing.observation(self._episodes), np.arange(len(self._rows)))
                self._command = law.derivatives(agent.observations, observed)
            for number, (name, part) in enumerate(self._directions):
                if part == step and name in self.names:
                    self._command[number, self.names.index(name)] += 1.0
        changes = sensing.readings(readings) | self._gains | {"actions": self._command}
        self._actions = self._mode.derivatives(actions, readings, changes)
        return np.asarray(self._mode.act(actions, readings, applied, active))

    def _advance(self, episodes: Episodes) -> None:
        """Advance the derivatives over the last control period."""
        self._periods += 1
        n, lag = self.joints, self._environment.lag
        self._delayed.append(self._actions)
        arriving = self._delayed.pop(0)
        if lag is not None:
            missing = self._reached - arriving
            self._reached, arriving = arriving + lag[0] * missing, arriving + lag[1] * missing
        self._drives = self._inputs.copy()
        self._drives[:, :n] += arriving * episodes.motors.limits[0]
        end = self._map.advance(self._row, episodes.motors.drive[0], self._rows, self._drives)
        self._diverged = end.diverged
        self._rows, self._outputs = end.rows, end.derivatives
        self._sensing.sample(self._rows, self._outputs, self._actions)

    def _record(self, episodes: Episodes) -> None:
        """Record values and derivatives (1 + p, ...) of the outputs."""
        view, outputs, begun = episodes.view, self._outputs, self._periods > 0
        changes = {
            "tip_error": -_norm_changes(view.target_error[0], outputs[:, layout.TIP]),
            "tip_vibration": _norm_changes(view.deflection_rate[0], outputs[:, layout.DEFLECTION_RATE]),
            "effort": 2.0 / self.joints * self._actions @ view.action[0],
            "tip_velocity": outputs[:, layout.TIP_VELOCITY],
        }
        values: dict[str, tuple[Any, Array]] = {
            "rows": (episodes.batch.rows[0], self._rows), "outputs": (episodes.batch.outputs[0], outputs),
            "tip_error": (view.tip_error, changes["tip_error"][:, None]),
            "tip_vibration": (view.tip_vibration, changes["tip_vibration"][:, None]),
            "actions": (begun * view.action[0], self._actions),
            "torques": (begun * episodes.motors.torques[0], self._drives[:, : self.joints]),
        }  # fmt: skip
        if "readings" in self._of:
            values["readings"] = episodes.measurements.read()[0], self._sensing.observation(episodes)
        if not {"reward", "reward_terms", "return"}.isdisjoint(self._of):
            values |= self._rewards(episodes, changes)
        for name, (value, change) in values.items():
            self._records.setdefault(name, []).append(np.vstack([value, change]))

    def _rewards(self, episodes: Episodes, changes: Mapping[str, Array]) -> dict[str, tuple[Any, Array]]:
        """Return reward terms, reward and return with their derivatives; 0 at the start."""
        task, begun, view = self._environment.task, self._periods > 0, episodes.view
        reward = REWARDS[getattr(task, "reward", "distance")]
        derivatives = reward.derivatives(view, view.tip_velocity - view.target_velocity, changes)
        terms, weights = episodes.reward_terms, self._environment.reward or {}
        self._terms = tuple(f"reward_{name} (1)" for name in terms)
        none = np.zeros(len(self._rows))
        change = begun * np.transpose([weights.get(name, 1.0) * derivatives.get(name, none) for name in terms])
        total = np.vstack([begun * episodes.rewards()[:, None], change.sum(axis=1, keepdims=True)])
        self._return = self._return + total
        value = begun * np.array([np.ravel(each)[0] for each in terms.values()])
        return {
            "reward_terms": (value, change), "reward": (total[:1], total[1:]),
            "return": (self._return[:1], self._return[1:]),
        }  # fmt: skip

    def result(self, record: Rollout) -> Sensitivities:
        """Return values and derivatives."""
        model, n = self._episodes.batch.model, self.joints
        every = {name: np.array(values).swapaxes(0, 1) for name, values in self._records.items()}
        sensors = self._episodes.sensors
        labels = {
            "tip_error": ("tip_error (m)",), "tip_vibration": ("tip_vibration (m/s)",),
            "readings": tuple(f"{name}_{i + 1} ({sensors.units[name]})" for name, part in sensors.slices.items()
                              for i in range(part.stop - part.start)),
            "actions": tuple(f"action_{i + 1} (1)" for i in range(n)),
            "torques": tuple(f"torque_{i + 1} (N m)" for i in range(n)),
            "reward_terms": getattr(self, "_terms", ()), "reward": ("reward (1)",), "return": ("return (1)",),
        }  # fmt: skip
        found = [(every[name], labels[name]) if name in labels
                 else motion_output(name, model, every["rows"], every["outputs"]) for name in self._of]  # fmt: skip
        together = np.concatenate([each for each, _ in found], axis=2)
        units = INPUTS | dict(self._mode.gain_units) | dict.fromkeys(self.names, "1")
        at_limit = np.abs(record.actions[0, : len(together[0]) - 1]) >= 1.0
        kinks = {f"torque_limit[{i}]": int(np.diff(at_limit[:, i]).sum()) for i in range(n)}
        return Sensitivities(
            time=record.period * np.arange(together.shape[1], dtype=np.float64),
            values=together[0], jacobian=np.moveaxis(together[1:], 0, 2),
            outputs=tuple(label for _, each in found for label in each),
            parameters=tuple(f"{each} ({units[each.name]})" for each in self._directions),
            status=record.failures[0] or "ok", kinks=count_kinks(model, every["rows"][0]) | kinks,
        )  # fmt: skip


def _differentiable(controller: Controller | None) -> bool:
    """Return True for no controller, and for a controller with derivatives, as its inner controller, if any."""
    return controller is None or (
        hasattr(controller, "derivatives") and _differentiable(getattr(controller, "inner", None))
    )


def _norm_changes(vector: Array, changes: Array) -> Array:
    """Return the derivatives (p,) of the length of a vector (3,) with derivatives (p, 3); 0 for a zero vector."""
    length = np.sqrt(vector @ vector)
    result: Array = changes @ vector / (length or 1.0)
    return result


class _Sensing:
    """Derivatives of readings: the sensors of an episode without noise act on p derivatives, scaled by SCALE.

    Sampling, delay and errors relative to goals are linear. Two readings are not: FineScale and the target nearness.

    Args:
        episodes: episode of one arm.
        limits: limits of the arm.
        count: number of derivatives p.
    """

    def __init__(self, episodes: Episodes, limits: Limits, count: int) -> None:
        agent, effects, model = episodes.agent, episodes.effects, episodes.batch.model
        self._batch = Batch(model, control_period=episodes.batch.control_period, arms=max(count, 1))
        self._view, self._nearness = View(self._batch), NEARNESS_LENGTH * episodes.view.reach
        own, mode = agent.sensors[: len(agent.sensors) - len(agent.mode.sensors)], find_sensors(agent.mode.sensors)
        goals = len(own) - len(episodes.task.sensors)
        parts = [*map(_without_noise, own[:goals]), *map(_Goal, own[goals:])]
        of_mode = [_without_noise(each) for each in mode]
        gains: Any = None
        if effects is not None and effects.measures:
            if "dropped_samples" in effects.drawn:
                raise value_error("randomisation.dropped_samples", "a range", "None: lost samples have no derivatives")
            measured = MeasuredView(self._view, limits, measured_names([*parts, *of_mode]))
            gains = _GaugeGains(measured, effects.drawn.get("gauge_gain"))
        self._measurements = Measurements(self._view, limits, parts, of_mode, gains)

    def begin(self, rows: Array, outputs: Array) -> None:
        """Sample the derivatives of state (p, 2 d + 2) and outputs (p, OUTPUTS) at the start of the episode."""
        self._set(rows, outputs)
        arms = np.arange(len(self._batch.rows))
        self._measurements.begin(arms, [np.random.default_rng(0)] * len(arms))

    def sample(self, rows: Array, outputs: Array, actions: Array) -> None:
        """Sample the derivatives after a control period with derivatives (p, n) of the commanded torques."""
        self._view.action[: len(actions)] = SCALE * actions
        self._set(rows, outputs)
        self._measurements.sample(None)

    def _set(self, rows: Array, outputs: Array) -> None:
        self._batch.rows[: len(rows)], self._batch.outputs[: len(rows)] = SCALE * rows, SCALE * outputs
        self._view.read()

    def observation(self, episodes: Episodes) -> Array:
        """Return the derivatives (p, size) of the observation of an episode."""
        actual = episodes.measurements
        actual.read()
        self._measurements.read()
        bound = {name: actual.sensors.bound[part] for name, part in actual.sensors.slices.items()}
        changes = self._actual(self._measurements.sensors.readings, actual.sensors.readings)
        clipped = [np.where(np.abs(actual.sensors.readings[name]) < bound[name], each, 0.0)
                   for name, each in changes.items()]  # fmt: skip
        return np.concatenate([np.zeros((len(self._batch.rows), 0)), *clipped], axis=1)

    def readings(self, actual: Readings) -> dict[str, Array]:
        """Return the derivatives (p, ...) of readings for the action mode, by name."""
        return self._actual(self._measurements.readings, actual) if actual else {}

    def _actual(self, scaled: Mapping[str, Array], actual: Readings) -> dict[str, Array]:
        """Return derivatives from scaled ones, for the actual readings, name -> (1, size)."""
        result = {name: each / SCALE for name, each in scaled.items()}
        for name, value in actual.items():
            if name.startswith("fine_"):
                result[name] /= np.cosh(value)
            elif name == "target_nearness":
                error, change = actual["target_error"][0], result["target_error"]
                divisor = self._nearness + np.sqrt(error @ error)
                result[name] = change / divisor - np.outer(_norm_changes(error, change), error) / divisor**2
        return result


def _without_noise(sensor: Any) -> Any:
    """Return a sensor, or an instrument without noise, bias and quantisation; raise ValueError for others."""
    ideal = sensor.sensor if isinstance(sensor, Instrument) else sensor
    names = measured_names([ideal])
    if type(ideal) not in LINEAR_SENSORS or "tip_acceleration" in names or "specific_force" in names:
        raise value_error("sensors", ideal, "sensors of this library without accelerations")
    if not isinstance(sensor, Instrument):
        return sensor
    if sensor.flaws.dropped:
        raise value_error("sensors.dropped", sensor.flaws.dropped, "0: lost samples have no derivatives")
    return Instrument(ideal, delay=sensor.flaws.delay, every=sensor.flaws.every)


class _Goal:
    """Sensor of a goal, which does not change with a parameter."""

    measures = ()

    def __init__(self, sensor: Any) -> None:
        self.entries = sensor.entries

    def read(self, view: View, out: Array) -> None:
        """Write zeros."""
        out[:] = 0.0


class _GaugeGains:
    """Gain errors of strain gauges, the only effect on measurements with a derivative.

    Args:
        measured: measured quantities.
        gains: (1, 3 n) factors; None for 1.
    """

    measures = True

    def __init__(self, measured: MeasuredView, gains: Array | None) -> None:
        columns = measured.columns("root_strains")
        self._factors = np.ones(len(measured.bound))
        if gains is not None and len(columns):
            self._factors[columns] = gains[0]

    def measure(self, values: Array, arms: Any) -> Array:
        """Return the measured values (p, size)."""
        return values * self._factors

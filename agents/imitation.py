"""Imitation learning by DAgger: the student acts, and the teacher labels the states that it visits."""

import sys
from collections.abc import Callable, Mapping
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch.optim.swa_utils import AveragedModel, get_ema_multi_avg_fn

from flexman_agents.callbacks import STEPS_COLUMN, Hook, Interrupted, TrainingReport, open_logger, stop_on_interrupt
from flexman_agents.sb3 import ACTIVATION_LAYERS
from flexman_agents.settings import DEFAULT_HYPERPARAMETERS, Settings
from flexman_gym.agent.action_modes import ActionMode
from flexman_gym.agent.agent import history_length
from flexman_gym.agent.base_controllers import make_base
from flexman_gym.agent.controller import Controller, EpisodeInfo, Readings
from flexman_gym.agent.mode_wrapper import ModeWrapper
from flexman_gym.agent.network import MAX_INPUT, VARIANCE_OFFSET, Network
from flexman_gym.common.arrays import Array, BoolArray, IntArray
from flexman_gym.common.checks import one_of
from flexman_gym.common.errors import value_error
from flexman_gym.common.run_folder import NEWEST, write_npz
from flexman_gym.envs.config.base_and_mode import make_base_and_mode
from flexman_gym.envs.config.fidelity import resolve_fidelity
from flexman_gym.envs.config.plant import make_plant
from flexman_gym.envs.foundation import check_fixed
from flexman_gym.evaluation.agent_spec import AgentSpec, split_interface
from flexman_gym.evaluation.rollouts import Rollout, rollout, training_seed
from flexman_gym.evaluation.trained_agents import observation_layout

BETA = (1.0, 0.5, 0.25)  # dimensionless; share of the arms controlled by the teacher in iterations 0, 1 and 2; later 0
ACTION_SCALE = 10.0  # dimensionless; factor of the labels of the network, because most actions are much smaller than 1
WEIGHT_FLOOR = 0.15  # dimensionless; added to the mean magnitude of scaled labels; the weight of a sample is 1 / sum^2
MAX_WEIGHT = 10.0  # dimensionless; largest weight of a sample relative to the mean weight
EMA_DECAY = 0.995  # dimensionless; decay per gradient step of the averaged network parameters, which form the policy
MAX_GRADIENT_NORM = 5.0  # dimensionless; norm to which a gradient is clipped


class _StudentMode(ModeWrapper):
    """Action mode of a student, with a teacher that labels the visited states.

    The agent of the environment reads the sensors, keeps the history and repeats actions; `law` is the policy of the
    student.

    Args:
        network: network of the student.
        mode: action mode that adds torques to the torques of its base controller.
        strength: torque of an action of 1 as a fraction of the torque limit, for all joints or for each joint (n,).
        teacher: controller designed for the same arm.

    Attributes:
        teacher_acts: (b,) True for arms controlled by the teacher.
        samples: for each action, the observations (b, size), the labels (b, n) and the flags of active arms (b,); a
            label is the action with which the motors would get the torques of the teacher.
    """

    withheld = ("derivatives",)  # the teacher's torques have none

    def __init__(self, network: Network, mode: ActionMode, strength: float | Array, teacher: Controller) -> None:
        super().__init__(mode)
        self.network, self._strength, self._teacher = network, strength, teacher
        self.teacher_acts: BoolArray = np.zeros(0, dtype=bool)
        self._observations: NDArray[np.float32] | None = None
        self.samples: list[tuple[NDArray[np.float32], Array, BoolArray]] = []

    def __deepcopy__(self, memo: object) -> "_StudentMode":
        return self  # a rollout copies its agent; samples and teacher stay in this object

    @property
    def sensors(self) -> tuple[object, ...]:
        """Names of the sensors that the mode, its base and the teacher read."""
        return (*super().sensors, *self._teacher.sensors)

    def law(self, observations: NDArray[np.float32]) -> Array:
        """Return the actions (b, n) of the student for observations (b, size)."""
        self._observations = observations
        return self.network(observations)

    def reset(self, arms: IntArray, episode: EpisodeInfo, count: int) -> None:
        """Start new episodes of the arms (r,)."""
        self._teacher.reset(arms, episode, count)
        super().reset(arms, episode, count)

    def act(self, actions: Array, readings: Readings, applied: Array, active: BoolArray) -> Array:
        """Return the torques (b, n) of the teacher or the student of each arm, as fractions of the torque limits."""
        teacher = np.clip(self._teacher.act(readings, applied, active), -1.0, 1.0)
        student = super().act(actions, readings, applied, active)
        if self._observations is not None:
            labels = actions + (teacher - student) / self._strength
            self.samples.append((self._observations, np.clip(labels, -1.0, 1.0), active.copy()))
            self._observations = None
        result: Array = np.where(self.teacher_acts[:, None], teacher, student)
        return result


def _strength(mode: ActionMode) -> float | Array:
    """Return the torque of an action of 1 as a fraction of the torque limit, for all joints or for each joint (n,)."""
    strength: float | Array | None = getattr(mode, "strength", None)
    if strength is None:
        allowed = "torque, current, or shaping with pace, offset and fading 0: a student learns torques"
        raise value_error("actions", ", ".join(mode.names), allowed)
    return strength


class DAgger:
    """DAgger: imitation of a teacher in iterations of episodes, trained on the data of the latest iterations.

    The teacher controls all arms in the first iteration and a share BETA in the next ones; afterwards the student
    controls all arms. The teacher labels every visited state (Ross, Gordon and Bagnell, A reduction of imitation
    learning to no-regret online learning, 2011). Weights of the samples balance small and large labels. The policy is
    an exponential moving average of the network parameters over the last few hundred gradient steps.

    Args:
        settings: settings of the run, with the algorithm "dagger".

    Attributes:
        steps: environment steps of the training, summed over all arms; a whole number of iterations.
    """

    def __init__(self, settings: Settings) -> None:
        hyperparameters = DEFAULT_HYPERPARAMETERS["dagger"] | dict(settings.hyperparameters)
        for name in hyperparameters:
            one_of("hyperparameters", name, sorted(DEFAULT_HYPERPARAMETERS["dagger"]))
        torch.set_num_threads(1)
        torch.manual_seed(settings.seed)
        self._settings, self._hyperparameters, self._environment = settings, hyperparameters, settings.environment
        self._random = np.random.default_rng(settings.seed)
        environment = settings.environment
        widths = [
            history_length(environment.history) * sum(each["size"] for each in observation_layout(environment)),
            *hyperparameters["net_arch"],
        ]
        pairs, activation = pairwise(widths), ACTIVATION_LAYERS[hyperparameters["activation"]]
        inner = [layer for inputs, outputs in pairs for layer in (torch.nn.Linear(inputs, outputs), activation())]
        self._layers = torch.nn.Sequential(*inner, torch.nn.Linear(widths[-1], len(environment.torque_limit)))
        for values in self._layers[-1].parameters():
            torch.nn.init.zeros_(values)
        self._statistics = {"mean": np.zeros(widths[0]), "var": np.ones(widths[0])}
        self._optimizer = torch.optim.Adam(self._layers.parameters(), fused=True)
        average = get_ema_multi_avg_fn(EMA_DECAY)  # type: ignore[no-untyped-call]
        self._averaged = AveragedModel(self._layers, multi_avg_fn=average)
        check_fixed(environment.foundation, "the torques of the teacher are imitated, not its travel")
        model = resolve_fidelity(environment).model
        mode = make_base_and_mode(environment, model)[1]
        strength = _strength(mode)  # checked before the teacher, whose design may take long
        teacher = make_base(hyperparameters["teacher"], make_plant(environment, model))
        self._student = _StudentMode(self._network(), mode, strength, teacher)
        self._per_iteration = settings.envs * -(-environment.max_periods // environment.action_repeat)
        self.steps = self._per_iteration * -(-settings.steps // self._per_iteration)
        self._iterations: list[list[NDArray[np.float32]]] = []  # [observations, labels, weights] of each iteration

    def learn(self, stop: Callable[[int, Mapping[str, float]], bool]) -> bool:
        """Train to the end of the steps.

        Args:
            stop: function of the environment steps so far and the metrics of the last iteration, called before each
                iteration and at the end; the training stops when the function returns True.

        Returns:
            False if the training was stopped.
        """
        iterations, updates = self.steps // self._per_iteration, self._hyperparameters["updates"]
        schedule, metrics = self._settings.schedule("learning_rate"), dict[str, float]()
        for number in range(iterations):
            if stop(number * self._per_iteration, metrics):
                return False
            metrics = self._collect(number)
            losses = []
            for update in range(updates):
                progress, rate = (number + update / updates) / iterations, self._hyperparameters["learning_rate"]
                self._optimizer.param_groups[0]["lr"] = schedule.at(progress) if schedule else rate
                losses.append(self._update())
            metrics["train/loss"] = float(np.mean(losses))
        stop(self.steps, metrics)
        return True

    def policy(self) -> dict[str, Any]:
        """Return the policy: layers under their names in PPO, and mean and variance of the observations (size,)."""
        layers = list(self._averaged.module.children())
        names = {f"mlp_extractor.policy_net.{place}": layer for place, layer in enumerate(layers[:-1])}
        arrays = {f"{name}.{part}": value.detach().numpy().copy()
                  for name, layer in {**names, "action_net": layers[-1]}.items()
                  for part, value in layer.named_parameters()}  # fmt: skip
        for part in ("weight", "bias"):
            arrays[f"action_net.{part}"] /= ACTION_SCALE
        return {"policy": arrays, "statistics": dict(self._statistics)}

    def _agent(self) -> AgentSpec:
        """Return the student as an agent."""
        interface = split_interface(self._environment)[1]
        own = {name: value for name, value in interface.items() if name not in ("base", "gains")}
        return AgentSpec("Student", self._student.law, {**own, "actions": self._student})

    def _network(self) -> "_FastNetwork":
        return _FastNetwork("dagger", self._hyperparameters["activation"], *self.policy().values())

    def _collect(self, number: int) -> dict[str, float]:
        """Run the episodes of iteration `number` and add their samples; return the metrics."""
        arms, kept = self._settings.envs, self._hyperparameters["iterations_kept"]
        self._student.network, self._student.samples = self._network(), []
        self._student.teacher_acts = self._random.random(arms) < (BETA[number] if number < len(BETA) else 0.0)
        first = training_seed(self._settings.seed) + number * arms
        result = rollout(self._agent(), split_interface(self._environment)[0], range(first, first + arms))
        self._iterations = [*self._iterations, _training_set(self._student.samples, number % 2)][-kept:]
        self._mean_weight = np.mean([weights.mean() for _, _, weights in self._iterations])
        if number == 0:
            observed = self._iterations[0][0]
            self._statistics = {
                "mean": observed.mean(axis=0, dtype=np.float64), "var": observed.var(axis=0, dtype=np.float64)
            }  # fmt: skip
        return _rollout_metrics(result)

    def _update(self) -> float:
        """Take a gradient step on a batch with equally many samples from each iteration; return the loss."""
        size, remainder = divmod(self._hyperparameters["batch_size"], len(self._iterations))
        chosen = [self._random.integers(len(observed), size=size + (index < remainder))
                  for index, (observed, _, _) in enumerate(self._iterations)]  # fmt: skip
        parts = [[part[rows] for part in data] for data, rows in zip(self._iterations, chosen, strict=True)]
        observed, labels, weights = (np.concatenate(part) for part in zip(*parts, strict=True))
        deviation = np.sqrt(self._statistics["var"] + VARIANCE_OFFSET)
        scaled = np.clip((observed - self._statistics["mean"]) / deviation, -MAX_INPUT, MAX_INPUT)
        weights_tensor = torch.as_tensor(np.minimum(weights / self._mean_weight, MAX_WEIGHT).astype(np.float32))
        errors = self._layers(torch.as_tensor(scaled.astype(np.float32))) - torch.as_tensor(labels)
        loss = (weights_tensor[:, None] * errors**2).mean()
        self._optimizer.zero_grad()
        loss.backward()
        torch.nn.utils.clip_grad_norm_(self._layers.parameters(), MAX_GRADIENT_NORM)
        self._optimizer.step()
        self._averaged.update_parameters(self._layers)
        return float(loss.item())


class DAggerRun:
    """DAgger training in a run folder; it cannot be resumed, because the samples are not saved."""

    done = 0

    def __init__(self, settings: Settings, folder: Path) -> None:
        self._imitation, self._settings, self._folder = DAgger(settings), settings, folder

    def set_state(self, data: dict[str, Any], further: bool) -> None:
        """Raise ValueError: a finished imitation cannot be continued."""
        raise value_error("steps", self._settings.steps, f"nothing: the imitation in {self._folder} is finished")

    def learn(self, checkpoint_every: int, progress: bool, hook: Hook | None) -> None:
        """Train to the end of the steps and save the policy; a training that is stopped saves nothing."""
        curves, done = open_logger(self._folder, 0, 0), 0

        def stop(steps: int, metrics: Mapping[str, float]) -> bool:
            nonlocal done
            done = steps
            for name, value in metrics.items():
                curves.record(name, value)
            if metrics:
                curves.record(STEPS_COLUMN, steps)
                curves.dump(steps)
            if progress and metrics:
                values = ", ".join(f"{name.split('/')[1]} {value:.3g}" for name, value in metrics.items())
                print(f"{steps:,} of {self._imitation.steps:,} steps: {values}", file=sys.stderr)
            return stop_requested.is_set() or bool(hook and hook(TrainingReport(steps, {}, lambda: None)))

        with stop_on_interrupt() as stop_requested:
            learned = self._imitation.learn(stop)
        curves.close()
        if learned:
            record = {"settings": self._settings.plain(), "training": {"counts": {"num_timesteps": done}}}
            write_npz(self._folder / NEWEST, self._imitation.policy() | record)
        elif stop_requested.is_set():
            raise Interrupted(f"{self._folder}: stopped after {done} steps; an imitation saves nothing before its end")


class _FastNetwork(Network):
    """Network with matrix products by BLAS: faster, but the last digits of a row depend on the number of rows."""

    def product(self, values: Array, weights: Array) -> Array:
        return values @ weights.T


def _training_set(samples: list[tuple[NDArray[np.float32], Array, BoolArray]], first: int) -> list[NDArray[np.float32]]:
    """Return observations (r, size), scaled labels (r, n) and weights (r,) of every second sample from `first` on."""
    parts = []
    for observed, labels, active in samples[first::2]:
        scaled = ACTION_SCALE * labels[active]
        weight = 1.0 / (WEIGHT_FLOOR + np.abs(scaled).mean()) ** 2
        parts.append((observed[active], scaled, np.full(len(scaled), weight)))
    return [np.concatenate(part).astype(np.float32) for part in zip(*parts, strict=True)]


def _rollout_metrics(result: Rollout) -> dict[str, float]:
    return {
        "rollout/ep_rew_mean": float(np.nansum(result.rewards, axis=1).mean()),
        "rollout/failed": float(np.mean([bool(failure) for failure in result.failures])),
    }

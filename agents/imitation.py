"""DAgger: the student acts, the teacher labels the visited states."""

import sys
import time
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
from flexman_gym.common.arrays import Array, BoolArray, IntArray
from flexman_gym.common.checks import one_of, value_error
from flexman_gym.common.run_folder import NEWEST, write_npz
from flexman_gym.control.actions import ActionMode
from flexman_gym.control.agent import history_length
from flexman_gym.control.controller import Controller, EpisodeInfo, Readings
from flexman_gym.control.network import MAX_INPUT, VARIANCE_OFFSET, Network
from flexman_gym.envs.config.fidelity import resolve_fidelity
from flexman_gym.envs.config.specification import make_base_and_mode, make_controller
from flexman_gym.evaluation.agent import AgentSpec, observation_layout, split_interface
from flexman_gym.evaluation.agent_info import TIME_COLUMN
from flexman_gym.evaluation.rollout import Rollout, rollout, training_seed

BETA = (1.0, 0.5, 0.25)  # share of the arms that the teacher leads, in the first rounds
ACTION_SCALE = 10.0  # of actions while they are learned: most are small beside 1
WEIGHT_FLOOR, MAX_WEIGHT = (
    0.15,
    10.0,
)  # beside the mean size of actions of an instant, by which it is weighed; largest weight
EMA_DECAY = 0.995  # of the weights that act, after each step
MAX_GRADIENT_NORM = 5.0  # norm of a gradient


class _StudentMode:
    """Action mode of a student, with a teacher that labels the states that it visits.

    The environment's agent observes, keeps a history and repeats actions; the law of the student gives its commands.

    Args:
        network: of the student.
        mode: action mode of torques, made with its base.
        strength: part of a torque limit that a command of 1 adds, of every joint or of each (n,).
        teacher: controller made for the same arm.

    Attributes:
        led: (b,) arms that the teacher leads.
        notes: of each instant at which a command begins: the observations (b, size), the commands (b, n) with which the
            motors would get the torques of the teacher, and which arms (b,) are playing.
    """

    def __init__(self, network: Network, mode: ActionMode, strength: float | Array, teacher: Controller) -> None:
        self.network, self._mode, self._strength, self._teacher = network, mode, strength, teacher
        self.joints, self.names, self.sensors = mode.joints, mode.names, (*mode.sensors, *teacher.sensors)
        self.shown: Mapping[str, int] = getattr(mode, "shown", {})
        self.led: BoolArray = np.zeros(0, dtype=bool)
        self._observations: NDArray[np.float32] | None = None
        self.notes: list[tuple[NDArray[np.float32], Array, BoolArray]] = []

    def __deepcopy__(self, memo: object) -> "_StudentMode":
        return self  # a rollout copies what acts; this one keeps its notes, and the teacher its designs

    def law(self, observations: NDArray[np.float32]) -> Array:
        """Return the commands (b, n) of the student for observations (b, size)."""
        self._observations = observations
        return self.network(observations)

    def reset(self, arms: IntArray, episode: EpisodeInfo, count: int) -> None:
        """Start new episodes of the arms (r,)."""
        self._teacher.reset(arms, episode, count)
        self._mode.reset(arms, episode, count)

    def look(self, readings: Readings, applied: Array, playing: BoolArray) -> Array:
        """Return what the mode shows the student, (b, size)."""
        shown: Array = self._mode.look(readings, applied, playing)  # type: ignore[attr-defined]
        return shown

    def act(self, actions: Array, readings: Readings, applied: Array, playing: BoolArray) -> Array:
        """Return the torques (b, n) of the teacher where it leads, of the student elsewhere, parts of the limits."""
        wanted = np.clip(self._teacher.act(readings, applied, playing), -1.0, 1.0)
        asked = self._mode.act(actions, readings, applied, playing)
        if self._observations is not None:
            better = actions + (wanted - asked) / self._strength
            self.notes.append((self._observations, np.clip(better, -1.0, 1.0), playing.copy()))
            self._observations = None
        result: Array = np.where(self.led[:, None], wanted, asked)
        return result


def _strength(mode: ActionMode) -> float | Array:
    """The part of a torque limit that an action of 1 adds, of every joint or of each (n,)."""
    strength: float | Array | None = getattr(mode, "strength", None)
    if strength is None:
        allowed = "torque, current, or shaping with pace, offset and fading 0: a student learns torques"
        raise value_error("actions", ", ".join(mode.names), allowed)
    return strength


class DAgger:
    """Learns from a teacher in rounds of episodes, of which the last ones are remembered.

    In the first round the teacher leads the arms, later the student does, and the teacher says what it would have done
    (Ross, Gordon and Bagnell, A reduction of imitation learning to no-regret online learning, 2011). Instants at which
    the teacher adds little count as much as those at which it adds a lot. What acts has the mean of the weights over
    the last few hundred steps, in which older ones fade.

    Args:
        settings: with the algorithm "dagger".

    Attributes:
        steps: actions of all arms, in whole rounds.

    Raises:
        ValueError: one line, for a hyperparameter that it does not know, and for actions that are no torques.
    """

    def __init__(self, settings: Settings) -> None:
        chosen = DEFAULT_HYPERPARAMETERS["dagger"] | dict(settings.hyperparameters)
        for name in chosen:
            one_of("hyperparameters", name, sorted(DEFAULT_HYPERPARAMETERS["dagger"]))
        torch.set_num_threads(1)
        torch.manual_seed(settings.seed)
        self._settings, self._chosen, self._described = settings, chosen, settings.environment
        self._random = np.random.default_rng(settings.seed)
        described = self._described
        widths = [
            history_length(described.history) * sum(each["size"] for each in observation_layout(described)),
            *chosen["net_arch"],
        ]
        pairs, between = pairwise(widths), ACTIVATION_LAYERS[chosen["activation"]]
        inner = [layer for k, m in pairs for layer in (torch.nn.Linear(k, m), between())]
        self._layers = torch.nn.Sequential(*inner, torch.nn.Linear(widths[-1], len(described.torque_limit)))
        for values in self._layers[-1].parameters():
            torch.nn.init.zeros_(values)
        self._moments = {"mean": np.zeros(widths[0]), "var": np.ones(widths[0])}
        self._optimizer = torch.optim.Adam(self._layers.parameters(), fused=True)
        averaged = get_ema_multi_avg_fn(EMA_DECAY)  # type: ignore[no-untyped-call]
        self._mean = AveragedModel(self._layers, multi_avg_fn=averaged)
        model = resolve_fidelity(described).model
        mode = make_base_and_mode(described, model)[1]
        strength = _strength(mode)  # refuses a mode of something else before a teacher is made
        teacher = make_controller(described, chosen["teacher"], model)
        self._student = _StudentMode(self._network(), mode, strength, teacher)
        self._per_round = settings.envs * -(-described.max_periods // described.action_repeat)
        self.steps = self._per_round * -(-settings.steps // self._per_round)
        self._rounds: list[list[NDArray[np.float32]]] = []  # what was seen, what is wanted, and how much it counts

    def learn(self, stop: Callable[[int, Mapping[str, float]], bool]) -> bool:
        """Learns to the end of the steps; gives False where it was stopped.

        Args:
            stop: is told before each round, and at the end, the steps taken and figures; it gives True to stop.
        """
        rounds, updates = self.steps // self._per_round, self._chosen["updates"]
        schedule, figures = self._settings.schedule("learning_rate"), dict[str, float]()
        for number in range(rounds):
            if stop(number * self._per_round, figures):
                return False
            figures = self._play(number)
            losses = []
            for update in range(updates):
                rate = schedule.at((number + update / updates) / rounds) if schedule else self._chosen["learning_rate"]
                self._optimizer.param_groups[0]["lr"] = rate
                losses.append(self._update())
            figures["train/loss"] = float(np.mean(losses))
        stop(self.steps, figures)
        return True

    def policy(self) -> dict[str, Any]:
        """Gives what acts: layers under the names that PPO has for them, and statistics of what they see."""
        layers = list(self._mean.module.children())
        names = {f"mlp_extractor.policy_net.{place}": layer for place, layer in enumerate(layers[:-1])}
        arrays = {f"{name}.{part}": value.detach().numpy().copy()
                  for name, layer in {**names, "action_net": layers[-1]}.items()
                  for part, value in layer.named_parameters()}  # fmt: skip
        for part in ("weight", "bias"):
            arrays[f"action_net.{part}"] /= ACTION_SCALE
        return {"policy": arrays, "statistics": dict(self._moments)}

    def _agent(self) -> AgentSpec:
        """Return the student as an agent."""
        interface = split_interface(self._described)[1]
        own = {name: value for name, value in interface.items() if name not in ("base", "gains")}
        return AgentSpec("Student", self._student.law, {**own, "actions": self._student})

    def _network(self) -> "_FastNetwork":
        return _FastNetwork("dagger", self._chosen["activation"], *self.policy().values())

    def _play(self, number: int) -> dict[str, float]:
        """Plays a round, and remembers what it teaches."""
        arms, kept = self._settings.envs, self._chosen["rounds_kept"]
        self._student.network, self._student.notes = self._network(), []
        self._student.led = self._random.random(arms) < (BETA[number] if number < len(BETA) else 0.0)
        first = training_seed(self._settings.seed) + number * arms
        played = rollout(self._agent(), split_interface(self._described)[0], range(first, first + arms))
        self._rounds = [*self._rounds, _training_set(self._student.notes, number % 2)][-kept:]
        self._usual = np.mean([weights.mean() for _, _, weights in self._rounds])
        if number == 0:
            seen = self._rounds[0][0]
            self._moments = {"mean": seen.mean(axis=0, dtype=np.float64), "var": seen.var(axis=0, dtype=np.float64)}
        return _rollout_metrics(played)

    def _update(self) -> float:
        """Takes a step along the gradient of a batch; gives its loss."""
        share, rest = divmod(self._chosen["batch_size"], len(self._rounds))
        chosen = [self._random.integers(len(seen), size=share + (place < rest))
                  for place, (seen, _, _) in enumerate(self._rounds)]  # fmt: skip
        parts = [[part[rows] for part in lesson] for lesson, rows in zip(self._rounds, chosen, strict=True)]
        seen, wanted, weights = (np.concatenate(part) for part in zip(*parts, strict=True))
        scaled = np.clip(
            (seen - self._moments["mean"]) / np.sqrt(self._moments["var"] + VARIANCE_OFFSET), -MAX_INPUT, MAX_INPUT
        )
        counts = torch.as_tensor(np.minimum(weights / self._usual, MAX_WEIGHT).astype(np.float32))
        errors = self._layers(torch.as_tensor(scaled.astype(np.float32))) - torch.as_tensor(wanted)
        loss = (counts[:, None] * errors**2).mean()
        self._optimizer.zero_grad()
        loss.backward()
        torch.nn.utils.clip_grad_norm_(self._layers.parameters(), MAX_GRADIENT_NORM)
        self._optimizer.step()
        self._mean.update_parameters(self._layers)
        return float(loss.item())


class DAggerRun:
    """An imitation in a folder. What it remembers of its rounds is not kept, so that it cannot go on."""

    done = 0

    def __init__(self, settings: Settings, folder: Path) -> None:
        self._imitation, self._settings, self._folder = DAgger(settings), settings, folder

    def give(self, data: dict[str, Any], another: bool) -> None:
        """Refuses to go on after its end."""
        raise value_error("steps", self._settings.steps, f"nothing: the imitation in {self._folder} is finished")

    def learn(self, checkpoint_every: int, progress: bool, hook: Hook | None) -> None:
        """Learns to the end of the steps, or until it is told to stop, and then keeps nothing."""
        curves, taken, started = open_logger(self._folder, 0, 0), 0, time.process_time()

        def stop(steps: int, figures: Mapping[str, float]) -> bool:
            nonlocal taken
            taken = steps
            for name, value in figures.items():
                curves.record(name, value)
            if figures:
                curves.record(STEPS_COLUMN, steps)
                curves.record(TIME_COLUMN, time.process_time() - started)
                curves.dump(steps)
            if progress and figures:
                said = ", ".join(f"{name.split('/')[1]} {value:.3g}" for name, value in figures.items())
                print(f"{steps:,} of {self._imitation.steps:,} actions: {said}", file=sys.stderr)
            return asked.is_set() or bool(hook and hook(TrainingReport(steps, {}, lambda: None)))

        with stop_on_interrupt() as asked:
            learned = self._imitation.learn(stop)
        curves.close()
        if learned:
            told = {"settings": self._settings.plain(), "training": {"counts": {"num_timesteps": taken}}}
            write_npz(self._folder / NEWEST, self._imitation.policy() | told)
        elif asked.is_set():
            raise Interrupted(f"{self._folder}: stopped after {taken} steps, of which an imitation keeps none")


class _FastNetwork(Network):
    """A network by products of BLAS: quicker, but the last digits of a row depend on the others."""

    def product(self, values: Array, weights: Array) -> Array:
        return values @ weights.T


def _training_set(notes: list[tuple[NDArray[np.float32], Array, BoolArray]], odd: int) -> list[NDArray[np.float32]]:
    """Every second one of the notes: what was seen (r, size), actions wanted (r, n), how much they count (r,)."""
    parts = []
    for seen, wanted, due in notes[odd::2]:
        scaled = ACTION_SCALE * wanted[due]
        weight = 1.0 / (WEIGHT_FLOOR + np.abs(scaled).mean()) ** 2
        parts.append((seen[due], scaled, np.full(len(scaled), weight)))
    return [np.concatenate(part).astype(np.float32) for part in zip(*parts, strict=True)]


def _rollout_metrics(played: Rollout) -> dict[str, float]:
    return {
        "rollout/ep_rew_mean": float(np.nansum(played.rewards, axis=1).mean()),
        "rollout/failed": float(np.mean([bool(failure) for failure in played.failures])),
    }

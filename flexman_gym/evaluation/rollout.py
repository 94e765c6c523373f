"""Rollout: episodes of one agent side by side, recorded in every control period, and their seeds."""

import fcntl
import re
from collections.abc import Callable, Mapping, Sequence
from contextlib import nullcontext
from copy import deepcopy
from dataclasses import dataclass
from functools import cache
from numbers import Integral
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np

from flexman_gym.common.arrays import Array, IntArray
from flexman_gym.common.checks import value_error, whole_number
from flexman_gym.common.progress import Progress
from flexman_gym.control.controller import Controller
from flexman_gym.envs.config.configuration import Configuration
from flexman_gym.envs.episodes import Episodes, validate_actions
from flexman_gym.evaluation.agent import AgentSpec, find_agent, split_interface
from flexman_gym.kernels import CACHE_FOLDER
from flexman_gym.metrics import BAND
from flexman_gym.simulation.batch import Batch
from flexman_gym.simulation.episode import Episode, episode_metadata

SELECTION_SEEDS = range(5000, 5100)  # episodes on which the best policy of a run is chosen
TEST_SEEDS = range(9000, 9100)  # episodes on which nothing is chosen: those of `flexman evaluate`
TRAINING_SEEDS_STRIDE = 1_000_000  # arm i of a run with seed s begins with the seed TRAINING (s + 1) + i


def training_seed(seed: int) -> int:
    """Gives the seed of the first arm of a training run."""
    return TRAINING_SEEDS_STRIDE * (seed + 1)


def _episode_seeds(seeds: Sequence[int] | int) -> list[int]:
    """Return the seeds of episodes: those given, or the first of TEST where their number is given.

    Raises:
        ValueError: for anything else.
    """
    given: Any = seeds
    if isinstance(given, Integral):
        return list(TEST_SEEDS[: whole_number("seeds", given, 1, len(TEST_SEEDS))])
    if isinstance(given, str) or not hasattr(given, "__len__") or len(given) == 0:
        raise value_error("seeds", given, f"a list of whole numbers, or how many of the {len(TEST_SEEDS)} test seeds")
    return list(given)


INSTANT_ARRAYS = ("tips", "errors", "states", "targets", "readings")  # what is recorded from the reset on
PERIOD_ARRAYS = ("actions", "torques", "rewards")  # what is recorded of each control period


@dataclass(frozen=True, eq=False)
class EpisodeRecord:
    """What happened in an episode of T control periods.

    Attributes:
        tips: (T + 1, 3) m, base frame, from the reset on.
        errors: (T + 1,) m, distances of tip and target.
        actions: (T, n) what the motors were asked for, parts of the torque limits.
        rewards: (T,).
        failure: "" or what ended the episode.
        period: of control, s.
        band: m around the target, in which a tip has settled.
    """

    tips: Array
    errors: Array
    actions: Array
    rewards: Array
    failure: str
    period: float
    band: float


@dataclass(frozen=True, eq=False)
class Rollout:
    """Episodes side by side, as arrays with an axis for them in front; after the end of an episode they are nan.

    Attributes:
        tips: (b, T + 1, 3) m, of T periods of the longest episode.
        errors: (b, T + 1) m.
        actions: (b, T, n).
        rewards: (b, T).
        lengths: (b,) control periods of each episode.
        failures: (b,) texts.
        period: as of a Record.
        band: as of a Record.
        states: (b, T + 1, 2 d).
        targets: (b, T + 1, 3) m.
        torques: (b, T, n) N m, after delays and other effects.
        readings: (b, T + 1, size) what the agent's sensors had read last.
        about: plain data that the episodes share, and "seeds" of each; "slices" of the readings by name.
    """

    tips: Array
    errors: Array
    actions: Array
    rewards: Array
    lengths: IntArray
    failures: tuple[str, ...]
    period: float
    band: float
    states: Array
    targets: Array
    torques: Array
    readings: Array
    about: dict[str, Any]

    def episode(self, number: int) -> Episode:
        """Gives one of the episodes, counted from 0, to its end."""
        end = int(self.lengths[number])
        own = {name: getattr(self, name)[number, : end + 1] for name in ("states", "tips", "targets", "errors")}
        own |= {name: getattr(self, name)[number, :end] for name in ("actions", "torques", "rewards")}
        told = {name: value for name, value in self.about.items() if name not in ("seeds", "slices")}
        told |= {"seed": self.about["seeds"][number], "failure": self.failures[number], "band": self.band}
        slices = {name: slice(*ends) for name, ends in self.about["slices"].items()}
        readings = {name: self.readings[number, : end + 1, place] for name, place in slices.items()}
        return Episode(self.period * np.arange(end + 1.0), **own, readings=readings, about=told)

    def save(self, folder: str | Path) -> list[Path]:
        """Writes each of the episodes to a file NAME-SEED.npz in a folder, from which `Episode.load` gives it.

        Raises:
            OSError: where a file cannot be written.
        """
        name = re.sub(r"[^\w.-]+", "-", self.about["name"]).strip("-.") or "episode"
        return [self.episode(i).save(Path(folder) / f"{name}-{seed}.npz") for i, seed in enumerate(self.about["seeds"])]

    @property
    def records(self) -> list[EpisodeRecord]:
        """What happened in each of the episodes, to its end."""
        return [
            EpisodeRecord(self.tips[i, : end + 1], self.errors[i, : end + 1], self.actions[i, :end], self.rewards[i,
            :end],
                   self.failures[i], self.period, self.band)
            for i, end in enumerate(self.lengths)
        ]  # fmt: skip


def rollout(
    entrant: str | AgentSpec | Controller,
    environment: str | Configuration,
    seeds: Sequence[int] | int,
    watch: Callable[[Episodes], None] | None = None,
    moved: Callable[[Batch], None] | None = None,
) -> Rollout:
    """Run an episode from each seed, side by side.

    The environment takes sensors, history, base, actions and hold of the agent and repeats its actions; every control
    period is recorded. The law of the agent is called on what the environment observes, as in its training.

    Args:
        entrant: a name or the folder of a run, see `find_agent`, or a Controller.
        environment: an id, an id and a condition, a file, or a Configuration.
        seeds: of the episodes; a number n stands for the first n test seeds, 9000 to 9000 + n - 1, n <= 100.
        watch: called after the reset and after every control period.
        moved: lets something else move the arms, see `physical`.

    Returns:
        A Rollout of b episodes of at most T control periods: tips (b, T + 1, 3) m, errors (b, T + 1) m, torques
        (b, T, n) N m, actions (b, T, n) as parts of the torque limits, period s, and more.

    Raises:
        FileNotFoundError, ValueError: one line with what is wrong and what is allowed.

    Examples:
        >>> played = fm.rollout("pd", "FlexOne-v0", seeds=range(2))
        >>> played.tips.shape, played.failures
        ((2, 501, 3), ('', ''))
    """
    player, described = find_agent(entrant), find_environment(environment)
    numbers, (bare, own) = _episode_seeds(seeds), split_interface(described)
    _check_arm(player, described)
    venv = gym.make_vec(described.id, len(numbers), "vector_entry_point", **_keywords(player, bare, own))
    episodes, size = venv.unwrapped.episodes, venv.action_space.shape or ()  # type: ignore[attr-defined]
    if moved is not None:
        moved(episodes.batch)
    recorder = _Recorder(episodes, watch)
    episodes.agent.check_law(player.law)
    venv.reset(seed=numbers)  # type: ignore[arg-type]
    recorder.begin()
    episodes.watch = recorder.record
    while not recorder.ends.all():  # not by steps of `venv`, which would reset each arm whose episode has ended
        asked = np.zeros(size) if player.law is None else player.law(episodes.agent.observations.copy())
        commands = np.asarray(asked, dtype=np.float32)
        episodes.step(validate_actions("actions", commands, size, "a number from -1 to 1 for each motor of each arm"))
    told = _metadata(venv.unwrapped, player, described) | {"seeds": [int(seed) for seed in numbers]}
    venv.close()
    return recorder.rollout(told)


def _keywords(player: AgentSpec, bare: Configuration, own: dict[str, Any]) -> dict[str, Any]:
    """Return the keywords of the environment of an agent; its parts are copied, as it may act elsewhere too."""
    keywords = bare.keywords() | deepcopy(own if player.interface is None else player.interface)
    if player.environment is not None:
        keywords["task"] = _ObservedTask(bare.task, player.environment.task.sensors)
    return keywords


class _ObservedTask:
    """Task with the sensors of another one, on which a policy was trained."""

    def __init__(self, task: object, sensors: Sequence[object]) -> None:
        self._task, self.sensors = task, sensors

    def __getattr__(self, name: str) -> Any:
        return getattr(self.__dict__["_task"], name)


def _check_arm(player: AgentSpec, described: Configuration) -> None:
    """Refuse a policy that was trained on an arm with another number of joints."""
    if player.environment is None:
        return
    own, count = player.environment.arm.n_joints, described.arm.n_joints
    if own != count:
        allowed = f"a policy for {described.id}, of {count} joints: it is one for {player.environment.id}, of {own}"
        raise value_error("entrant", player.name, allowed)


def find_environment(environment: str | Configuration) -> Configuration:
    """Gives the description of an id, an id and a condition, or a file, or the description itself."""
    return environment if isinstance(environment, Configuration) else Configuration.find(environment)


def _metadata(env: Any, player: AgentSpec, described: Configuration) -> dict[str, Any]:
    """What the episodes of an entrant on an environment have in common, plain."""
    sensors = env.episodes.sensors
    settings = {"environment": split_interface(described)[0].to_plain(strict=False), "interface": player.interface}
    return episode_metadata(
        env.batch.model, settings, name=player.name, environment=described.id, units=dict(sensors.units),
        slices={name: [place.start, place.stop] for name, place in sensors.slices.items()},
        torque_limits=env.torque_limit.tolist(),
    )  # fmt: skip


class _Recorder:
    """Records control periods of arms, and the ends of their first episodes; what they do afterwards does not count."""

    def __init__(self, episodes: Episodes, watch: Callable[[Episodes], None] | None) -> None:
        self._episodes, self._watch = episodes, watch
        self._rows: dict[str, list[Array]] = {name: [] for name in (*INSTANT_ARRAYS, *PERIOD_ARRAYS)}
        self.ends = np.zeros(len(episodes.over), dtype=np.int64)
        self._failures = [""] * len(self.ends)
        self._progress = Progress(f"control periods of {len(self.ends)} episodes", episodes.max_periods)

    def begin(self) -> None:
        """Records what a reset leaves."""
        self._keep(self._instant())

    def record(self) -> None:
        """Records a control period."""
        episodes, view = self._episodes, self._episodes.view
        self._keep(self._instant() | {"actions": view.action.copy(), "torques": episodes.motors.torques.copy(),
                                      "rewards": episodes.rewards()})  # fmt: skip
        self._progress.count()
        for arm in np.flatnonzero(episodes.over & (self.ends == 0)).tolist():
            self.ends[arm], self._failures[arm] = len(self._rows["actions"]), episodes.failures.get(arm, "")

    def _instant(self) -> dict[str, Array]:
        """What is known of this moment; an INSTANTS entry each."""
        view, state = self._episodes.view, 2 * self._episodes.batch.model.n_dof
        return {"tips": view.tip.copy(), "errors": view.tip_error.copy(), "states": view.state[:, :state].copy(),
                "targets": view.target.copy(), "readings": self._episodes.sensors.observations.copy()}  # fmt: skip

    def _keep(self, now: Mapping[str, Array]) -> None:
        for name, values in now.items():
            self._rows[name].append(values)
        if self._watch is not None:
            self._watch(self._episodes)

    def rollout(self, told: dict[str, Any]) -> Rollout:
        """Gives all of it, nothing where an episode was over, and what is told about it."""
        arrays = {name: np.array(rows).swapaxes(0, 1).copy() for name, rows in self._rows.items()}
        for name, values in arrays.items():
            for arm, end in enumerate(self.ends):
                values[arm, end + (name in INSTANT_ARRAYS) :] = np.nan
        view = self._episodes.view
        return Rollout(**arrays, lengths=self.ends, failures=tuple(self._failures), period=view.control_period,
                       band=BAND * view.reach, about=told)  # fmt: skip


@cache
def compile_kernels() -> None:
    """Compile the kernels of the environments; of several processes on a computer, one compiles and the rest wait."""
    with (Path(CACHE_FOLDER) / "lock").open("w") if CACHE_FOLDER else nullcontext() as lock:
        if lock is not None:
            fcntl.flock(lock, fcntl.LOCK_EX)
        for env in (gym.make("FlexRRR-v0"), gym.make_vec("FlexRRR-v0", 2, "vector_entry_point")):
            env.reset(seed=0)
            env.step(env.action_space.sample())

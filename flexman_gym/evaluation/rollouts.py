"""Rollout: simulation of episodes of one agent, recorded in every control period, and the seeds of episodes."""

import re
from collections.abc import Callable, Mapping, Sequence
from copy import deepcopy
from dataclasses import dataclass
from numbers import Integral
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np

from flexman_gym.common.arrays import Array, IntArray
from flexman_gym.common.checks import whole_number
from flexman_gym.common.errors import value_error, warn_caller
from flexman_gym.common.progress import Progress
from flexman_gym.envs.config.configuration import Configuration
from flexman_gym.envs.episodes import Episodes
from flexman_gym.envs.tasks.task import Task
from flexman_gym.evaluation.agent_spec import AgentSpec, has_instrument_errors, split_interface
from flexman_gym.evaluation.agents import find_agent
from flexman_gym.metrics import BAND, damping_ratio
from flexman_gym.simulation.batch import Batch
from flexman_gym.simulation.episode import Episode

SELECTION_SEEDS = range(5000, 5100)  # seeds of the episodes by which the best policy of a training run is selected
TEST_SEEDS = range(9000, 9100)  # seeds of the test episodes of `flexman evaluate`, which are not used for selection
MAX_RECORDED = 10**8  # control periods of all episodes of a rollout
TRAINING_SEEDS_STRIDE = 1_000_000  # arm i of a training run with seed s starts with the seed STRIDE (s + 1) + i


def training_seed(seed: int) -> int:
    """Return the seed of the first episode of the first arm of a training run."""
    return TRAINING_SEEDS_STRIDE * (seed + 1)


def _episode_seeds(seeds: Sequence[int] | int) -> list[int]:
    """Return a list of seeds; for a whole number n the first n test seeds."""
    given: Any = seeds
    if isinstance(given, Integral):
        return list(TEST_SEEDS[: whole_number("seeds", given, 1, len(TEST_SEEDS))])
    if isinstance(given, str) or not hasattr(given, "__len__") or len(given) == 0:
        allowed = f"a list of whole numbers, or a number of test seeds up to {len(TEST_SEEDS)}"
        raise value_error("seeds", given, allowed)
    return list(given)


INSTANT_ARRAYS = ("tips", "errors", "states", "targets", "readings")  # recorded at the reset and after each period
PERIOD_ARRAYS = ("actions", "torques", "rewards")  # recorded once per control period


@dataclass(frozen=True, eq=False)
class EpisodeRecord:
    """Record of an episode of T control periods, from which metrics are computed.

    Attributes:
        tips: (T + 1, 3) positions of the tip in the base frame, from the reset on, m.
        errors: (T + 1,) distances of the tip from its target, m.
        actions: (T, n) commanded motor torques as fractions of the torque limits.
        rewards: (T,) rewards of the control periods.
        failure: cause of a failure, which terminated the episode; "" without a failure.
        period: control period, s.
        band: distance from the target within which a tip counts as settled, m.
        changes: (T, n) changes of the actions by the safety filter; None without a filter.
        excess: (T,) largest excess beyond the limits in each control period, see `Limits.excess`; None without limits
            that are recorded.
    """

    tips: Array
    errors: Array
    actions: Array
    rewards: Array
    failure: str
    period: float
    band: float
    excess: Array | None = None
    changes: Array | None = None

    def equivalent_damping(self) -> float:
        """Return the damping ratio of the oscillation of the tip after its first arrival in the band.

        The oscillation is evaluated along the base axis of the largest motion. The ratio is infinite without an
        oscillation, and 0 if the episode failed or the tip never arrived.
        """
        inside = np.flatnonzero(self.errors <= self.band)
        if self.failure or not len(inside) or len(self.tips) - inside[0] < 3:
            return 0.0
        tips = self.tips[inside[0] :]
        ratio = damping_ratio(tips[:, np.argmax(np.ptp(tips, axis=0))])
        return np.inf if np.isnan(ratio) else ratio


@dataclass(frozen=True, eq=False)
class Rollout:
    """Records of b episodes as arrays, with NaN after the end of each episode.

    Attributes:
        tips: (b, T + 1, 3) positions of the tip, m; the longest episode has T control periods.
        errors: (b, T + 1) distances of the tip from its target, m.
        actions: (b, T, n) commanded motor torques as fractions of the torque limits.
        rewards: (b, T) rewards of the control periods.
        lengths: (b,) numbers of control periods of the episodes.
        failures: b causes of failures, which terminated the episodes; "" without a failure.
        period: control period, s.
        band: distance from the target within which a tip counts as settled, m.
        states: (b, T + 1, 2 d) generalised coordinates and their rates, in the order of `kernels.layout`.
        targets: (b, T + 1, 3) targets of the tip, m.
        torques: (b, T, n) applied motor torques, after delay and other effects, N m.
        readings: (b, T + 1, size) readings of the agent's sensors.
        metadata: common metadata of the episodes, their "seeds", and the "slices" of the readings by entry.
        excess: (b, T) largest excess beyond the limits, see `EpisodeRecord`.
        changes: (b, T, n) changes of the actions by the safety filter, see `EpisodeRecord`.
        bases: (b, T + 1, 3) positions of bases that move, world frame, m; None for fixed bases.
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
    metadata: dict[str, Any]
    excess: Array | None = None
    changes: Array | None = None
    bases: Array | None = None

    def episode(self, number: int) -> Episode:
        """Return the episode with an index from 0 to b - 1, up to its end."""
        end = int(self.lengths[number])
        arrays = {name: getattr(self, name)[number, : end + 1] for name in ("states", "tips", "targets", "errors")}
        arrays |= {name: getattr(self, name)[number, :end] for name in ("actions", "torques", "rewards")}
        metadata = {name: value for name, value in self.metadata.items() if name not in ("seeds", "slices")}
        metadata |= {"seed": self.metadata["seeds"][number], "failure": self.failures[number], "band": self.band}
        if self.excess is not None:
            metadata["violations"] = _violations(self.excess[number, :end], self.period)
        slices = {name: slice(*ends) for name, ends in self.metadata["slices"].items()}
        readings = {name: self.readings[number, : end + 1, columns] for name, columns in slices.items()}
        bases = None if self.bases is None else self.bases[number, : end + 1]
        return Episode(self.period * np.arange(end + 1.0), **arrays, readings=readings, bases=bases, about=metadata)

    @property
    def file_name(self) -> str:
        """Name of the agent in the names of files."""
        return re.sub(r"[^\w.-]+", "-", self.metadata["name"]).strip("-.") or "episode"

    def save(self, folder: str | Path) -> list[Path]:
        """Write each episode to a file NAME-SEED.npz, which `fm.Episode.load` reads; return the paths.

        Args:
            folder: folder of the files; it is created if it does not exist.

        Raises:
            OSError: if a file cannot be written.
        """
        paths = [Path(folder) / f"{self.file_name}-{seed}.npz" for seed in self.metadata["seeds"]]
        return [self.episode(i).save(path) for i, path in enumerate(paths)]

    @property
    def records(self) -> list[EpisodeRecord]:
        """Record of each episode up to its end."""
        return [
            EpisodeRecord(
                self.tips[i, : end + 1], self.errors[i, : end + 1], self.actions[i, :end], self.rewards[i, :end],
                self.failures[i], self.period, self.band,
                *(None if each is None else each[i, :end] for each in (self.excess, self.changes)),
            )
            for i, end in enumerate(self.lengths)
        ]  # fmt: skip


def save_rollouts(results: Sequence[Rollout], folder: Path) -> list[Path]:
    """Write the episodes of several agents to a folder; return the paths.

    If two agents have the same name, each agent has a folder of its own in it: 1, 2, and so on.

    Raises:
        OSError: if a file cannot be written.
    """
    same = len({result.file_name for result in results}) < len(results)
    folders = [folder / str(number) if same else folder for number in range(1, len(results) + 1)]
    return [path for result, own in zip(results, folders, strict=True) for path in result.save(own)]


def rollout(
    agent: object,
    environment: str | Configuration,
    seeds: Sequence[int] | int,
    callback: Callable[[Episodes], None] | None = None,
    set_plant: Callable[[Batch], None] | None = None,
    options: dict[str, Any] | None = None,
    safety: bool = False,
) -> Rollout:
    """Simulate one episode for each seed, all episodes together, and record every control period.

    Sensors, history, base controller, action mode and action repeat are settings of the agent; arm, task, effects and
    limits are settings of the environment. A policy has the same observations as in its training.

    Args:
        agent: name of a baseline or a shipped policy, folder of a run, Controller, or another object of `find_agent`.
        environment: id, id and condition such as "FlexRRR-v0/delay", path of a file, or Configuration.
        seeds: seeds of the episodes; a number n <= 100 stands for the first n test seeds, 9000 to 9000 + n - 1.
        callback: function of the simulated `envs.episodes.Episodes`, called after the reset and every control period.
        set_plant: function that makes the simulated `Batch` use another simulation of the arms, see
            `toolbox.league.scenarios.PLANTS`; None for the integrator of the environment.
        options: options of the reset, such as start, goal and physical parameters, of all or of each of the arms.
        safety: True to run the agent with the setting safety=True of the environment, which needs the extra `mpc`.

    Returns:
        Records of b episodes of at most T control periods: tips (b, T + 1, 3) m, errors (b, T + 1) m, torques
        (b, T, n) N m, actions (b, T, n) as fractions of the torque limits, the control period (s), and more.

    Raises:
        ValueError, FileNotFoundError: for an unknown agent or environment, and a ValueError for more than
            MAX_RECORDED control periods of all episodes.

    Examples:
        >>> result = fm.rollout("pd", "FlexOne-v0", seeds=range(2))
        >>> result.tips.shape, result.failures
        ((2, 501, 3), ('', ''))
        >>> final_errors = [float(record.errors[-1]) for record in result.records]  # m
        >>> max(final_errors) < result.band
        True
    """
    environment = Configuration.find(environment)
    environment = environment.replace(safety=safety) if safety else environment
    if agent == "zero" and environment.base is not None:
        warn_caller(
            'base: left out for the agent "zero", which has no torque; give the base as the agent, by name or mapping'
        )
    loop = RolloutLoop(agent, environment, seeds, callback, set_plant, options)
    episodes = loop.episodes
    most = MAX_RECORDED // len(episodes.over)
    if episodes.max_periods > most:
        allowed = f"at most {most * environment.control_period:g} (s): {len(episodes.over)} x {most} control periods"
        raise value_error("horizon", environment.horizon, allowed)
    progress = Progress(f"control periods of {len(episodes.over)} episodes", episodes.max_periods)
    while not loop.over:
        loop.step()
        for _ in range(episodes.agent.action_repeat):
            progress.count()
    return loop.result()


class RolloutLoop:
    """Rollout that is advanced step by step, for programs that act between two steps; arguments as in `rollout`.

    Attributes:
        episodes: simulated episodes, with the law of the agent.
    """

    def __init__(
        self,
        agent: object,
        environment: str | Configuration,
        seeds: Sequence[int] | int,
        callback: Callable[[Episodes], None] | None = None,
        set_plant: Callable[[Batch], None] | None = None,
        options: dict[str, Any] | None = None,
    ) -> None:
        spec, environment = find_agent(agent), Configuration.find(environment)
        seeds = _episode_seeds(seeds)
        _check_joint_count(spec, environment)
        keywords = _keywords(spec, environment)
        venv: Any = gym.make_vec(environment.id, len(seeds), "vector_entry_point", **keywords)
        self._venv = venv
        self.episodes, self._seeds = venv.unwrapped.episodes, [int(seed) for seed in seeds]
        self.episodes.agent.set_law(spec.law)
        self.begin(callback, set_plant, options)
        self._metadata = _metadata(venv.unwrapped, spec, environment) | {"seeds": self._seeds}

    def begin(
        self,
        callback: Callable[[Episodes], None] | None,
        set_plant: Callable[[Batch], None] | None,
        options: dict[str, Any] | None,
    ) -> None:
        """Begin the episodes, or begin them anew from the same seeds; arguments as in `rollout`."""
        if set_plant is not None:
            set_plant(self.episodes.batch)
        self._recorder = _Recorder(self.episodes, callback)
        self._venv.reset(seed=self._seeds, options=options)
        self._recorder.begin()
        self.episodes.callback = self._recorder.record

    @property
    def over(self) -> bool:
        """True if all episodes have ended."""
        return bool(self._recorder.ends.all())

    def step(self) -> None:
        """Simulate one action of the agent, `action_repeat` control periods; ended episodes keep their last state."""
        self.episodes.step()

    def result(self) -> Rollout:
        """Return the records of the simulated control periods, of which there must be at least one."""
        return self._recorder.rollout(self._metadata)


def _keywords(agent: AgentSpec, environment: Configuration) -> dict[str, Any]:
    """Return the keyword arguments of `gym.make_vec` for an agent with its settings in place of those in INTERFACE.

    The objects of the agent are copied. An agent without these settings has those of the environment. A controller
    without a policy reads with the errors of the instruments of the environment.
    """
    bare, interface = split_interface(environment)
    keywords = bare.keywords() | deepcopy(interface if agent.interface is None else agent.interface)
    if agent.law is None and has_instrument_errors(environment):
        keywords.setdefault("sensors", environment.sensors)
    if agent.environment is not None:
        keywords["task"] = _ObservedTask(bare.task, agent.environment.task.sensors)
    return keywords


@Task.register  # from Python 3.12 on the check of a protocol does not call __getattr__
class _ObservedTask:
    """Task of an environment, with the sensors of the task on which a policy was trained."""

    def __init__(self, task: object, sensors: Sequence[object]) -> None:
        self._task, self.sensors = task, sensors

    def __getattr__(self, name: str) -> Any:
        return getattr(self.__dict__["_task"], name)


def _check_joint_count(agent: AgentSpec, environment: Configuration) -> None:
    """Raise ValueError if a policy was trained on an arm with a different number of joints.

    A policy with actions and observations in units of the arm acts on any number of joints.
    """
    actions = (agent.interface or {}).get("actions")
    if agent.environment is None or (isinstance(actions, dict) and actions.get("units") == "arm"):
        return
    own, count = agent.environment.arm.n_joints, environment.arm.n_joints
    if own != count:
        allowed = f"a policy for {environment.id}, of {count} joints: it is one for {agent.environment.id}, of {own}"
        raise value_error("agent", agent.name, allowed)


def _metadata(env: Any, agent: AgentSpec, environment: Configuration) -> dict[str, Any]:
    """Return the metadata of all episodes of an agent in an environment, as JSON-compatible data."""
    sensors, limits = env.episodes.sensors, env.episodes.limits
    settings = {"environment": split_interface(environment)[0].to_plain(strict=False), "interface": agent.interface}
    return Episode.metadata(
        env.batch.model, settings, name=agent.name, environment=environment.id, units=dict(sensors.units),
        slices={name: [columns.start, columns.stop] for name, columns in sensors.slices.items()},
        torque_limits=env.torque_limit.tolist(), **{"limits": limits.to_plain()} if limits.recorded else {},
    )  # fmt: skip


def _violations(excess: Array, period: float) -> list[list[float]]:
    """Return start and end (s) of each violation, and the largest excess in it, for the excess (T,) of an episode."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], excess > 0.0, [False]])))
    parts = edges.reshape(-1, 2).tolist()
    return [[(start + 1) * period, end * period, float(excess[start:end].max())] for start, end in parts]


class _Recorder:
    """Recorder of control periods; `ends` (b,) has the lengths of the ended episodes, and 0 for a running episode."""

    def __init__(self, episodes: Episodes, callback: Callable[[Episodes], None] | None) -> None:
        self._episodes, self._callback = episodes, callback
        names = (*INSTANT_ARRAYS, *PERIOD_ARRAYS, *["excess"] * episodes.limits.recorded)
        names += ("changes",) * (episodes.safety is not None) + ("bases",) * (episodes.foundation is not None)
        self._rows: dict[str, list[Array]] = {name: [] for name in names}
        self.ends = np.zeros(len(episodes.over), dtype=np.int64)
        self._failures = [""] * len(self.ends)

    def begin(self) -> None:
        """Record the state after the reset."""
        self._append(self._instant())

    def record(self) -> None:
        """Record a control period."""
        episodes, view = self._episodes, self._episodes.view
        now = {"actions": view.action.copy(), "torques": episodes.motors.torques.copy(), "rewards": episodes.rewards()}
        if episodes.limits.recorded:
            now["excess"] = episodes.excess
        if episodes.safety is not None:
            now["changes"] = episodes.safety.change.copy()
        self._append(self._instant() | now)
        for arm in np.flatnonzero(episodes.over & (self.ends == 0)).tolist():
            self.ends[arm], self._failures[arm] = len(self._rows["actions"]), episodes.failures.get(arm, "")

    def _instant(self) -> dict[str, Array]:
        """Return the current values of INSTANT_ARRAYS by name."""
        view, size = self._episodes.view, 2 * self._episodes.batch.model.n_dof
        now = {"tips": view.tip.copy(), "errors": view.tip_error.copy(), "states": view.state[:, :size].copy(),
               "targets": view.target.copy(), "readings": self._episodes.sensors.observations.copy()}  # fmt: skip
        foundation = self._episodes.foundation
        return now if foundation is None else now | {"bases": foundation.displacements}

    def _append(self, now: Mapping[str, Array]) -> None:
        for name, values in now.items():
            self._rows[name].append(values)
        if self._callback is not None:
            self._callback(self._episodes)

    def rollout(self, metadata: dict[str, Any]) -> Rollout:
        """Return the records, with NaN after the end of each episode."""
        arrays = {name: np.array(rows).swapaxes(0, 1).copy() for name, rows in self._rows.items()}
        ends = np.where(self.ends, self.ends, len(self._rows["actions"]))
        for name, values in arrays.items():
            for arm, end in enumerate(ends):
                values[arm, end + (name in (*INSTANT_ARRAYS, "bases")) :] = np.nan
        view = self._episodes.view
        return Rollout(**arrays, lengths=ends, failures=tuple(self._failures), period=view.control_period,
                       band=BAND * view.reach, metadata=metadata)  # fmt: skip

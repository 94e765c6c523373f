"""Moves of agents with and without the safety filter, with limits that the agents violate without it."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from time import process_time
from typing import Any
from unittest.mock import patch

import gymnasium as gym
import numpy as np

import flexman_gym as fm
from flexman_gym.agent.controller import Controller, EpisodeInfo, Readings
from flexman_gym.common.arrays import Array, BoolArray, IntArray
from flexman_gym.common.files import write_atomically
from flexman_gym.envs.config.configuration import Configuration
from flexman_gym.envs.episodes import Episodes
from flexman_gym.evaluation.metrics import METRICS
from flexman_gym.evaluation.rollouts import Rollout, rollout
from flexman_gym.metrics.statistics import upper_median
from flexman_gym.toolbox.safety.safety_filter import CHANGED, STOPPED, SafetyFilter

ENVIRONMENT, STUDY, RATE, HALF_SPACE = "FlexRRR-v0", "strain and torque", "rate", "half space"
ATTACKED = 0.6  # limit of the agents that have no goal, which they exceed in nearly all moves
PERCENTILE = 60.0  # of the largest values of the free agent; the limit, which 40 % of its moves exceed
CALIBRATION_SEEDS, TEST_SEED, CHUNK = range(5000, 5100), 9000, 200  # seeds of limits, first of moves, moves of a chunk
SINGLE_SEEDS = range(8000, 8003)  # of single arms, for the CPU time
ACCEPTED = 0.02  # fraction of the limit; excess that does not count
LEVEL = 0.95  # confidence of the bound of the rate of violations
HEIGHT = 3.0  # m; largest height of the tip in the half space, in which 30 % of the goals of the task are not
FIELDS = ("free_excess", "free_settling", "excess", "settling", "change", "changed", "stopped", "cpu")


@dataclass(frozen=True)
class Cell:
    """Agent, condition and limits of a row, and its number of moves."""

    condition: str
    agent: str
    limits: str
    moves: int

    @property
    def name(self) -> str:
        """Name of the cell in file names."""
        return "_".join((self.condition, self.agent, self.limits)).replace(" ", "-")

    @property
    def has_goal(self) -> bool:
        """True for an agent that moves to the goal, False for one that attacks the limits."""
        return self.agent not in ("random", "along the rates", "PPO to violate")


CELLS = (
    Cell("nominal", "lqr-tracking", STUDY, 2000),
    Cell("nominal", "lqr-tracking", RATE, 200),
    Cell("nominal", "lqr-tracking", HALF_SPACE, 100),
    Cell("nominal", "adaptive-lqr", STUDY, 100),
    Cell("nominal", "ppo-flexrrr", STUDY, 200),
    Cell("nominal", "random", STUDY, 30),
    Cell("nominal", "along the rates", STUDY, 30),
    Cell("nominal", "PPO to violate", STUDY, 60),
    Cell("unknown-lab", "adaptive-lqr", STUDY, 200),
    Cell("unknown-lab", "lab-flexrrr", STUDY, 200),
    Cell("unknown-lab", "along the rates", STUDY, 30),
    Cell("uncertain", "adaptive-lqr", STUDY, 100),
    Cell("uncertain", "along the rates", STUDY, 15),
)


@dataclass(frozen=True)
class SafetyRow:
    """Result of a cell; a violation is an excess above 2 % of a limit; of rate and half space any excess.

    Attributes:
        condition, agent, limits: the cell.
        value: limit: factor of the strains and spring torques of `limits="study"`, rate (rad/s) or height (m).
        moves: number of moves.
        free_violations: share of the moves with a violation without the filter.
        violations: number of moves with a violation with the filter.
        bound: upper bound of the rate of violations with the filter, 95 % confidence (Clopper and Pearson).
        largest: largest excess with the filter, fraction of the limit.
        free_settled, settled: share of settled moves without and with the filter.
        free_settling, settling: median settling time without and with the filter, s.
        change: mean square change of the torques, as fractions of their limits.
        changed, stopped: share of the control periods with a changed action, and with the backup.
        cpu, cpu_single: CPU time of the filter for an action, ms, in a batch of all moves (at most 200) and for a
            single arm; the lowest mean of several runs.
    """

    condition: str
    agent: str
    limits: str
    value: float
    moves: int
    free_violations: float
    violations: int
    bound: float
    largest: float
    free_settled: float
    settled: float
    free_settling: float
    settling: float
    change: float
    changed: float
    stopped: float
    cpu: float
    cpu_single: float


class RandomTorques:
    """Independent uniform torques in every control period."""

    sensors: tuple[str, ...] = ()

    def reset(self, arms: IntArray, episode: EpisodeInfo, count: int) -> None:
        """Start new episodes; arguments as in `Controller.reset`."""
        self._random, self._joints = np.random.default_rng(1), episode.start.shape[1]

    def act(self, readings: Readings, applied: Array, active: BoolArray) -> Array:
        """Return torques (b, n); arguments as in `Controller.act`."""
        return self._random.uniform(-1.0, 1.0, (len(active), self._joints))


class TorquesAlongRates(RandomTorques):
    """Largest torques along the motor rates, which feed energy into every vibration."""

    sensors = ("motor_encoders",)

    def act(self, readings: Readings, applied: Array, active: BoolArray) -> Array:
        """Return torques (b, n); arguments as in `Controller.act`."""
        return np.where(readings["motor_rates"] < 0.0, -1.0, 1.0)


CONTROLLERS: dict[str, Callable[[], Controller]] = {"random": RandomTorques, "along the rates": TorquesAlongRates}


def violation_bound(violations: int, moves: int) -> float:
    """Return the upper bound of a rate by Clopper and Pearson (Biometrika 26, 1934), one-sided."""
    from scipy.stats import beta

    return 1.0 if violations == moves else float(beta.ppf(LEVEL, violations + 1, moves - violations))


def environment(cell: Cell, value: float) -> Configuration:
    """Return the environment of a cell with a limit, see `SafetyRow`; a violation does not end the episode."""
    name = ENVIRONMENT if cell.condition == "nominal" else f"{ENVIRONMENT}/{cell.condition}"
    given: dict[str, Any] = {"on_violation": "cost"}
    if cell.limits == STUDY:
        study = Configuration.find(ENVIRONMENT, ["limits=study"]).limits
        given |= {each: tuple(value * np.array(getattr(study, each))) for each in ("strain", "spring_torque")}
    elif cell.limits == RATE:
        given["margin"] = {"rate": fm.Limits.rate - value}
    else:
        given["workspace"] = [{"half_space": [[0.0, 0.0, 1.0], value]}]
    return Configuration.find(name).replace(limits=fm.Limits(**given))


def agent(cell: Cell) -> Any:
    """Return the agent of a cell for `rollout`."""
    if not cell.has_goal and cell.agent not in CONTROLLERS:
        from studies.safety.learning import adversary  # needs PyTorch

        return adversary()
    return CONTROLLERS[cell.agent]() if cell.agent in CONTROLLERS else cell.agent


def calibrated(cell: Cell) -> float:
    """Return a fixed limit, or the one that the free agent exceeds in 40 % of its moves on the calibration seeds."""
    if cell.limits == HALF_SPACE or not cell.has_goal:
        return HEIGHT if cell.limits == HALF_SPACE else ATTACKED
    peaks = np.zeros(len(CALIBRATION_SEEDS))

    def record(episodes: Episodes) -> None:
        view = episodes.view
        if cell.limits == RATE:
            values = [view.motor_rates, view.joint_twist_rates]
        else:
            limits = episodes.limits
            values = [view.root_strains / limits.of_quantities("strain"),
                      view.spring_torques / limits.of_quantities("spring_torque")]  # fmt: skip
        largest = np.abs(np.concatenate(values, axis=1)).max(axis=1)
        np.maximum(peaks, np.where(episodes.over, 0.0, largest), out=peaks)

    rollout(agent(cell), environment(cell, 1.0), list(CALIBRATION_SEEDS), record)
    return float(np.percentile(peaks, PERCENTILE))


def options(cell: Cell, seeds: list[int]) -> dict[str, Any] | None:
    """Return the options of the reset: for a half space the goals that the task draws without it."""
    if cell.limits != HALF_SPACE:
        return None
    arms = gym.make_vec(ENVIRONMENT, len(seeds), "vector_entry_point")
    arms.reset(seed=seeds)  # type: ignore[arg-type]
    goals = arms.unwrapped.episodes.view.episode_parameters["goal_angles"].copy()  # type: ignore[attr-defined]
    arms.close()
    return {"goal_angles": goals}


@contextmanager
def timed_filter() -> Iterator[list[float]]:
    """Measure the CPU time (s) of all calls of safety filters, and the number of their actions."""
    total, call = [0.0, 0.0], SafetyFilter.__call__

    def timed(self: SafetyFilter, actions: Array, readings: Readings, applied: Array, active: BoolArray) -> Array:
        started = process_time()
        result = call(self, actions, readings, applied, active)
        total[0] += process_time() - started
        total[1] += float(active.sum())
        return result

    with patch.object(SafetyFilter, "__call__", timed):
        yield total


def filtered(cell: Cell, value: float, seeds: list[int]) -> tuple[Rollout, Array, float]:
    """Return the moves of a cell with the filter, counts (2, b) of periods changed and stopped, and CPU time, ms."""
    counts = np.zeros((2, len(seeds)))

    def count(episodes: Episodes) -> None:
        assert episodes.safety is not None
        for row, status in zip(counts, (CHANGED, STOPPED), strict=True):
            row += ~episodes.over & (episodes.safety.status == status)

    with timed_filter() as total:
        limited, given = environment(cell, value), options(cell, seeds)
        moves = rollout(agent(cell), limited, seeds, count, options=given, safety=True)
    return moves, counts, 1e3 * total[0] / total[1]


def measure(cell: Cell, value: float, seeds: list[int]) -> Array:
    """Return FIELDS (FIELDS, b) of moves."""
    free = rollout(agent(cell), environment(cell, value), seeds, options=options(cell, seeds))
    moves, counts, cpu = filtered(cell, value, seeds)
    settling = [[METRICS["settling_time"].evaluate([each]) for each in run.records] for run in (free, moves)]
    changes = [np.mean(np.square(np.asarray(each.changes))) for each in moves.records]
    excess = [[np.asarray(each.excess).max() for each in run.records] for run in (free, moves)]
    return np.array([excess[0], settling[0], excess[1], settling[1], changes, *(counts / moves.lengths),
                     np.full(len(seeds), cpu)])  # fmt: skip


def kept(path: Path, make: Callable[[], Any]) -> Array:
    """Return an array from a file, which is made if it does not exist."""
    if not path.exists():
        data = np.asarray(make())
        write_atomically(path, lambda file: np.save(file, data))
    return np.asarray(np.load(path))


def row(cell: Cell, folder: Path) -> SafetyRow:
    """Return the row of a cell; finished parts are kept in a folder, from which an interrupted study resumes."""
    value = float(kept(folder / f"{cell.name}.npy", lambda: calibrated(cell)))
    chunks = []
    for first in range(0, cell.moves, CHUNK):
        seeds = list(range(TEST_SEED + first, TEST_SEED + min(first + CHUNK, cell.moves)))
        chunks.append(kept(folder / f"{cell.name}_{first}.npy", partial(measure, cell, value, seeds)))
    single = kept(folder / f"{cell.name}_single.npy",
                  lambda: [filtered(cell, value, [seed])[2] for seed in SINGLE_SEEDS])  # fmt: skip
    given = dict(zip(FIELDS, np.concatenate(chunks, axis=1), strict=True))
    accepted = ACCEPTED if cell.limits == STUDY else 0.0
    violations = int((given["excess"] > accepted).sum())
    free, limited = given["free_settling"], given["settling"]
    return SafetyRow(
        cell.condition, cell.agent, cell.limits, value, cell.moves, float((given["free_excess"] > accepted).mean()),
        violations, violation_bound(violations, cell.moves), float(given["excess"].max()),
        float(np.isfinite(free).mean()), float(np.isfinite(limited).mean()), upper_median(free), upper_median(limited),
        float(given["change"].mean()), float(given["changed"].mean()), float(given["stopped"].mean()),
        float(given["cpu"].min()), float(single.min()),
    )  # fmt: skip

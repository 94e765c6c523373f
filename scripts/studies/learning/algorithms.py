"""Comparison of the algorithms of training at equal CPU time."""

import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from flexman_agents.callbacks import TrainingReport
from flexman_agents.settings import Settings, find_recipe
from flexman_agents.training import train_or_resume
from flexman_gym.common.arrays import Array
from flexman_gym.common.parallel import Workers, parallel_map
from flexman_gym.envs.config.configuration import Configuration
from flexman_gym.envs.vector_env import compile_kernels
from flexman_gym.evaluation.agents import find_agent
from flexman_gym.evaluation.metrics import METRICS
from flexman_gym.evaluation.rollouts import rollout
from studies.files import read_rows, write_rows

ENVIRONMENT = "FlexRRR-v0"
RECIPES = {"sac": "sac_on_pd", "tqc": "tqc_on_pd", "crossq": "crossq_on_pd", "ppo": "ppo_on_pd"}
STEPS = {"sac": 3_100_000, "tqc": 2_600_000, "crossq": 2_000_000, "ppo": 25_000_000}
"""Algorithm -> environment steps of a run, about 40 CPU minutes; the schedules of the recipe end with them."""
BUDGETS = (2.0, 10.0, 40.0)  # CPU time of the training at which a policy is evaluated, min
EPISODES = range(130_000, 130_100)  # seeds of the evaluation, used for no choice
REFERENCES = ("pd", "lqr-tracking", "shaping-flexrrr", "planned")  # agents without training in this study
SAVE_EVERY = 120.0  # s; CPU time between checkpoints of a training

Key = tuple[str, float | None, float | None]  # algorithm or agent, seed, nominal CPU time (min)


@dataclass(frozen=True)
class AlgorithmRow:
    """Results of a policy, or of an agent without training, in the episodes of the evaluation.

    Attributes:
        algorithm: algorithm, or name of the agent.
        seed: seed of the training; None for an agent without training.
        minutes: nominal CPU time of the training, min.
        cpu, steps: CPU time (s) and environment steps of the training.
        settled: share of episodes that stay within the band until the end.
        time, vibration: medians, s and m.
        times: settling time of each episode, s, separated by blanks; "inf" if it does not settle.
    """

    algorithm: str
    seed: float | None
    minutes: float | None
    cpu: float | None
    steps: float | None
    settled: float
    time: float
    vibration: float
    times: str

    @property
    def key(self) -> Key:
        """Algorithm, seed and nominal CPU time, which identify a row."""
        return self.algorithm, self.seed, self.minutes

    @property
    def settling_times(self) -> Array:
        """Settling times (episodes,), s."""
        return np.array(self.times.split(), dtype=float)


@dataclass(frozen=True)
class Spent:
    """CPU time (s) of a training up to a number of environment steps, a row of its clock."""

    steps: float
    cpu: float


class Clock:
    """Hook of a training that stops it after a CPU time, which it keeps in the run folder across resumptions.

    Loading, compilation and checkpoints do not count.

    Args:
        folder: folder of the run.
        budget: CPU time, s.
        last: environment steps of the whole run.
    """

    def __init__(self, folder: Path, budget: float, last: int) -> None:
        self._path, self._budget, self._last = folder / "cpu.csv", budget, last
        self._spent = read_rows(self._path, Spent) if self._path.is_file() else []
        self._started: float | None = None  # at the first call
        self._saved = 0.0
        self._latest: Spent | None = None

    def __call__(self, report: TrainingReport) -> bool:
        """Return True if the CPU time is spent; keep it before each checkpoint."""
        now = time.process_time()
        if self._started is None:
            self._spent = [each for each in self._spent if each.steps <= report.steps]  # later steps were lost
            self._saved = self._spent[-1].cpu if self._spent else 0.0
            self._started = now - self._saved
        cpu = now - self._started
        self._latest = Spent(report.steps, cpu)
        ends = cpu >= self._budget or report.steps >= self._last
        if ends or cpu >= self._saved + SAVE_EVERY:
            self.keep()
            self._saved = cpu
            if not ends:
                report.save()
                self._started += time.process_time() - now
        return ends

    def keep(self) -> None:
        """Keep the CPU time of the latest call; also after Ctrl-C, which saves the run one rollout later."""
        if self._latest and self._latest not in self._spent:
            self._spent.append(self._latest)
            write_rows(self._spent, self._path, 10)

    @property
    def spent(self) -> Spent:
        """Steps and CPU time of the latest checkpoint."""
        return self._spent[-1]


class Cell(NamedTuple):
    """Training of an algorithm with a seed.

    Attributes:
        settings: settings of the run.
        folder: folder of the run.
        budgets: CPU times of the evaluations, min, ascending.
    """

    settings: Settings
    folder: Path
    budgets: Sequence[float]


def run_settings(algorithm: str, seed: int) -> Settings:
    """Return the settings of a run: those of the recipe, with the steps of the study and without evaluations."""
    return replace(find_recipe(RECIPES[algorithm]), steps=STEPS[algorithm], eval_every=0).with_seed(seed)


def run(cell: Cell) -> list[AlgorithmRow]:
    """Train, or resume, a run to each CPU time and return its rows; a row in the folder is not made again."""
    rows = []
    for minutes in cell.budgets:
        path = cell.folder / f"row-{minutes:g}.csv"
        if not path.is_file():
            clock = Clock(cell.folder, 60.0 * minutes, cell.settings.steps)
            try:
                train_or_resume((cell.settings, str(cell.folder), {"progress": False, "hook": clock}))
            finally:
                clock.keep()
            spent = clock.spent
            result = evaluated(str(cell.folder))
            write_rows([replace(result, algorithm=cell.settings.algo, seed=float(cell.settings.seed), minutes=minutes,
                                cpu=spent.cpu, steps=spent.steps)], path)  # fmt: skip
        rows += read_rows(path, AlgorithmRow)
    return rows


def evaluated(agent: str) -> AlgorithmRow:
    """Return the row of an agent, without the cost of a training."""
    records = rollout(find_agent(agent), Configuration(ENVIRONMENT), EPISODES).records
    times = METRICS["settling_time"].values(records)
    settled, median, vibration = (METRICS[name].evaluate(records) for name in ("settled", "settling_time", "vibration"))
    text = " ".join(f"{each:.3g}" for each in times)
    return AlgorithmRow(agent, None, None, None, None, settled, median, vibration, text)


def measure(
    known: Mapping[Key, AlgorithmRow], cells: Sequence[Cell], workers: Workers | int = 1
) -> Iterator[AlgorithmRow]:
    """Yield the known rows and the rows of runs, in the order of agents, algorithms, seeds and CPU times.

    Args:
        known: rows that are not made again, by their keys.
        cells: runs.
        workers: workers, each for one run at a time.
    """
    result = dict(known)
    for agent in REFERENCES:
        if (agent, None, None) not in result:
            result[agent, None, None] = evaluated(agent)
    missing = [cell._replace(budgets=budgets) for cell in cells if (budgets := _missing(cell, known))]
    for rows in parallel_map(run, missing, workers, prepare=compile_kernels):
        result |= {row.key: row for row in rows}
    names = [*REFERENCES, *RECIPES]
    yield from sorted(result.values(), key=lambda row: (names.index(row.algorithm), row.seed or 0, row.minutes or 0))


def _missing(cell: Cell, known: Mapping[Key, AlgorithmRow]) -> list[float]:
    """Return the CPU times of a run, min, whose rows are not known."""
    return [each for each in cell.budgets if (cell.settings.algo, cell.settings.seed, each) not in known]

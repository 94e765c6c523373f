"""Callbacks of a training: exploration, checkpoints, evaluation, learning curves and interruption."""

import csv
import math
import signal
import sys
import threading
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import NamedTuple

import torch
from stable_baselines3 import SAC
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.logger import CSVOutputFormat, Logger, TensorBoardOutputFormat
from torch.utils.tensorboard import SummaryWriter

from flexman_agents.settings import Schedule, Settings
from flexman_gym.common.checks import is_decimal_integer
from flexman_gym.common.renamed import deprecated_names
from flexman_gym.common.time_series import read_csv_rows
from flexman_gym.control.agent import Law
from flexman_gym.evaluation.agent import AgentSpec, split_interface
from flexman_gym.evaluation.metrics import METRICS, evaluate
from flexman_gym.evaluation.rollout import SELECTION_SEEDS


class Interrupted(Exception):
    """A training was asked to stop; the run is kept and can go on."""


@contextmanager
def stop_on_interrupt() -> Iterator[threading.Event]:
    """An event that Ctrl-C sets; pressed again it interrupts at once."""
    asked = threading.Event()
    if threading.current_thread() is not threading.main_thread():
        yield asked  # only the main thread hears signals
        return

    def hear(number: int, frame: object) -> None:
        if asked.is_set():
            raise KeyboardInterrupt
        asked.set()
        print("Stopping after this rollout; press Ctrl-C again to lose it.", file=sys.stderr)

    before = signal.signal(signal.SIGINT, hear)
    try:
        yield asked
    finally:
        signal.signal(signal.SIGINT, before)


STEPS_COLUMN = "time/total_timesteps"  # the column that Stable-Baselines3 counts in


class _Events(TensorBoardOutputFormat):
    """TensorBoard events of a folder; those from `steps` on that an earlier process wrote are hidden."""

    def __init__(self, folder: Path, steps: int) -> None:
        self.writer = SummaryWriter(str(folder), purge_step=steps)
        self._is_closed = False


def open_logger(folder: Path, before: int, steps: int) -> Logger:
    """Opens the curves of a run that goes on after `steps`, the run in the folder before it having taken `before`.

    They are in progress-N.csv for N = before + steps > 0, else in progress.csv. Rows of the same run from there on,
    which a process wrote that did not keep its steps, are taken out of the earlier files. Events of another run are in
    a folder of their own.
    """
    for path in folder.glob("progress*.csv"):
        first = path.stem.removeprefix("progress").removeprefix("-") or "0"
        if is_decimal_integer(first) and before <= int(first) < before + steps and not path.is_symlink():
            _cut(path, steps)
    path = folder / (f"progress-{before + steps}.csv" if before + steps else "progress.csv")
    path.unlink(missing_ok=True)  # it may be a link to a file of somebody's
    events = folder / f"after-{before}" if before else folder
    return Logger(str(folder), [CSVOutputFormat(str(path)), _Events(events, steps)])


def _cut(path: Path, steps: int) -> None:
    """Takes the rows after so many steps out of a file."""
    names, *rows = [*read_csv_rows(path)] or [[]]
    if STEPS_COLUMN not in names:
        return
    column = names.index(STEPS_COLUMN)
    rows = [row for row in rows if len(row) == len(names) and row[column] and float(row[column]) <= steps]
    with path.open("w", newline="", encoding="utf-8") as file:
        csv.writer(file, lineterminator="\n").writerows([names, *rows])


CURVE_METRICS = ("settling_time", "vibration", "error", "reward", "settled", "roughness", "failed")
WARNING_DROP = 0.2  # share of settled episodes that may be lost before a warning


class TrainingReport(NamedTuple):
    """What a hook is told where a rollout begins, and at the end.

    Attributes:
        steps: that have been taken.
        figures: of the last evaluation on selection seeds, by name as of `fm.evaluate`; empty before there was one.
        save: writes the run into its folder as it is now, from which `resume` goes on.
    """

    steps: int
    figures: Mapping[str, float]
    save: Callable[[], None]


Hook = Callable[[TrainingReport], bool | None]


class Exploration(BaseCallback):
    """Sets the exploration by a schedule, or a mapping of one.

    For PPO that is the logarithm of the standard deviation, which is then not learned; for SAC the entropy it aims at.
    """

    def __init__(self, schedule: Schedule | Mapping[str, float], steps: int) -> None:
        super().__init__()
        self._schedule = schedule if isinstance(schedule, Schedule) else Schedule(**schedule)
        self._steps = steps

    def _on_training_start(self) -> None:
        if not isinstance(self.model, SAC):
            self.model.policy.log_std.requires_grad_(False)

    def _on_rollout_start(self) -> None:
        value = self._schedule.at(min(1.0, self.num_timesteps / self._steps))
        if isinstance(self.model, SAC):
            self.model.target_entropy = value
            return
        with torch.no_grad():
            self.model.policy.log_std.fill_(value)  # type: ignore[operator]

    def _on_step(self) -> bool:
        return True


class ValueWarmup(BaseCallback):
    """Lets the value function of PPO learn alone at first: while it says nothing, a policy learns noise from it."""

    def __init__(self, steps: int) -> None:
        super().__init__()
        self._steps = steps

    def _on_rollout_start(self) -> None:
        policy = self.model.policy
        for part in (policy.mlp_extractor.policy_net, policy.action_net):  # type: ignore[union-attr]
            part.requires_grad_(self.num_timesteps >= self._steps)

    def _on_step(self) -> bool:
        return True


class Checkpoints(BaseCallback):
    """Saves the run where a rollout begins: every so many steps, and when it is asked to stop, which it then does.

    Attributes:
        stopped: the steps after which it has stopped; None as long as it goes on.
    """

    def __init__(self, every: int, save: Callable[[], None], asked: Callable[[], bool]) -> None:
        super().__init__()
        self._every, self._save, self._asked = every, save, asked
        self.stopped: int | None = None

    def _on_training_start(self) -> None:
        self._next = self.num_timesteps + self._every

    def _on_rollout_start(self) -> None:
        if self._asked():
            self._save()
            self.stopped = self.model.num_timesteps
        elif self._every and self.model.num_timesteps >= self._next:
            self._next = self.model.num_timesteps + self._every
            self._save()

    def _on_step(self) -> bool:
        return self.stopped is None


class Evaluation(BaseCallback):
    """Evaluates the policy without noise on selection seeds, at the end too, and keeps the best one.

    The best has the highest mean reward, which tells more in a hundred episodes than the share that settles. A line on
    stderr says so when a policy settles much less often than the best.

    Attributes:
        latest: figures of the last evaluation.
    """

    state_fields = ("_best", "_next", "_warned")

    def __init__(self, settings: Settings, law: Law, keep: Callable[[], None]) -> None:
        super().__init__()
        self._environment, interface = split_interface(settings.environment)
        self._entrant = AgentSpec("training", law, interface)
        self._every, self._last, self._keep = settings.judge_every, settings.steps, keep
        self._best = [-math.inf, 0.0]  # reward, and share that settled
        self.latest: Mapping[str, float] = {}
        self.begin()

    def begin(self) -> None:
        """Counts steps from zero again."""
        self._next, self._warned = self._every, False

    def _on_step(self) -> bool:
        return True

    def _on_rollout_end(self) -> None:
        if self.num_timesteps >= self._next:
            self._next = self.num_timesteps + self._every
            self._compare()

    def _on_training_end(self) -> None:
        if self.num_timesteps >= self._last:  # and not stopped before
            self._compare()

    def _compare(self) -> None:
        """Evaluates the policy as it is and keeps it where it is the best."""
        self.latest = result = evaluate(self._entrant, self._environment, SELECTION_SEEDS)
        for name in CURVE_METRICS:
            unit = METRICS[name].unit
            self.logger.record(f"selection/{name}_{unit}" if unit else f"selection/{name}", result[name])
        if result["reward"] > self._best[0]:
            self._best, self._warned = [result["reward"], result["settled"]], False
            self._keep()
        elif result["settled"] < self._best[1] - WARNING_DROP and not self._warned:
            self._warned = True
            share = f"{result['settled']:.0%} settle instead of {self._best[1]:.0%}"
            said = f"after {self.num_timesteps} steps the policy is worse than before: {share}; the best one is kept"
            print(said, file=sys.stderr)


__getattr__ = deprecated_names(__name__)

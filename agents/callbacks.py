"""Training callbacks: exploration schedule, value warm-up, evaluation, learning curves, interruption by Ctrl-C."""

import csv
import io
import math
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import NamedTuple

import torch
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.logger import CSVOutputFormat, KVWriter, Logger, TensorBoardOutputFormat
from stable_baselines3.common.off_policy_algorithm import OffPolicyAlgorithm
from torch.utils.tensorboard import SummaryWriter

from flexman_agents.settings import Schedule, Settings
from flexman_gym.agent.agent import Law
from flexman_gym.common.checks import is_decimal_integer
from flexman_gym.common.files import write_atomically
from flexman_gym.common.progress import Progress
from flexman_gym.common.tables import read_csv_rows
from flexman_gym.evaluation.agent_info import CPU_COLUMN
from flexman_gym.evaluation.agent_spec import AgentSpec, split_interface
from flexman_gym.evaluation.metrics import METRICS, evaluate
from flexman_gym.evaluation.rollouts import SELECTION_SEEDS


class Interrupted(Exception):
    """Training stopped by Ctrl-C; the run is saved and can be resumed."""


@contextmanager
def stop_on_interrupt() -> Iterator[threading.Event]:
    """Yield an event that Ctrl-C sets; a second Ctrl-C interrupts at once."""
    stop_requested = threading.Event()
    if threading.current_thread() is not threading.main_thread():
        yield stop_requested  # only the main thread receives signals
        return

    def handle(number: int, frame: object) -> None:
        if stop_requested.is_set():
            raise KeyboardInterrupt
        stop_requested.set()
        print("Stopping after this rollout; press Ctrl-C again to stop at once, without saving it.", file=sys.stderr)

    previous = signal.signal(signal.SIGINT, handle)
    try:
        yield stop_requested
    finally:
        signal.signal(signal.SIGINT, previous)


STEPS_COLUMN = "time/total_timesteps"  # environment steps summed over all arms; column of Stable-Baselines3


class _Events(TensorBoardOutputFormat):
    """TensorBoard writer for a folder; hides the events that an earlier process wrote from step `steps` on."""

    def __init__(self, folder: Path, steps: int) -> None:
        self.writer = SummaryWriter(str(folder), purge_step=steps)
        self._is_closed = False


class _CurveLogger(Logger):
    """Logger of Stable-Baselines3 that adds the CPU time since its construction to each row."""

    def __init__(self, folder: str | None, output_formats: list[KVWriter]) -> None:
        super().__init__(folder, output_formats)
        self._started = time.process_time()

    def dump(self, step: int = 0) -> None:
        """Write the recorded values and the CPU time."""
        self.record(CPU_COLUMN, time.process_time() - self._started)
        super().dump(step)


def open_logger(folder: Path, before: int, steps: int) -> Logger:
    """Open the files of the learning curves of a new or resumed run.

    The rows go to progress.csv, or to progress-N.csv if N = `before` + `steps` is positive. Rows of this run with more
    than `steps` steps are removed: they belong to steps that were lost when a process was killed. TensorBoard events
    of a run that continues a finished run go to a subfolder.

    Args:
        folder: folder of the run.
        before: environment steps of the finished runs in the folder.
        steps: environment steps of this run so far.

    Returns:
        Logger of Stable-Baselines3 for the CSV file and the TensorBoard events.
    """
    for path in folder.glob("progress*.csv"):
        first = path.stem.removeprefix("progress").removeprefix("-") or "0"
        if is_decimal_integer(first) and before <= int(first) < before + steps and not path.is_symlink():
            _remove_later_rows(path, steps)
    path = folder / (f"progress-{before + steps}.csv" if before + steps else "progress.csv")
    path.unlink(missing_ok=True)  # it may be a link to a file outside the folder
    events = folder / f"after-{before}" if before else folder
    return _CurveLogger(str(folder), [CSVOutputFormat(str(path)), _Events(events, steps)])


def _remove_later_rows(path: Path, steps: int) -> None:
    """Remove the rows with more than `steps` environment steps from a CSV file of learning curves."""
    names, *rows = [*read_csv_rows(path)] or [[]]
    if STEPS_COLUMN not in names:
        return
    column = names.index(STEPS_COLUMN)
    rows = [row for row in rows if len(row) == len(names) and row[column] and float(row[column]) <= steps]
    text = io.StringIO(newline="")
    csv.writer(text, lineterminator="\n").writerows([names, *rows])
    write_atomically(path, lambda file: file.write(text.getvalue().encode()))


# metrics of the evaluations that the learning curves contain
CURVE_METRICS = ("settling_time", "vibration", "error", "reward", "settled", "roughness", "failed")
WARNING_DROP = 0.2  # decrease of the share of settled episodes, relative to the best policy, that causes a warning


class TrainingReport(NamedTuple):
    """Progress of a training run, passed to the hook at the start of each rollout and at the end of the training.

    Attributes:
        steps: environment steps so far, summed over all arms.
        metrics: metrics of the latest evaluation on the selection seeds, by name as in `fm.evaluate`; empty before the
            first evaluation.
        save: function that saves the run in its folder; `resume` continues from there.
    """

    steps: int
    metrics: Mapping[str, float]
    save: Callable[[], None]


Hook = Callable[[TrainingReport], bool | None]
"""Function of the progress of a training; the training stops when the function returns True."""


class Exploration(BaseCallback):
    """Schedule of the exploration over the training.

    For PPO the schedule sets the logarithm of the standard deviation of the actions, which is then not learned. For
    SAC, TQC and CrossQ the schedule sets the target entropy.

    Args:
        schedule: values by progress of the training.
        steps: environment steps of the training.
    """

    def __init__(self, schedule: Schedule, steps: int) -> None:
        super().__init__()
        self._schedule, self._steps = schedule, steps

    def _on_training_start(self) -> None:
        if not isinstance(self.model, OffPolicyAlgorithm):
            self.model.policy.log_std.requires_grad_(False)

    def _on_rollout_start(self) -> None:
        value = self._schedule.at(min(1.0, self.num_timesteps / self._steps))
        if isinstance(self.model, OffPolicyAlgorithm):
            self.model.target_entropy = value  # type: ignore[attr-defined]
            return
        with torch.no_grad():
            self.model.policy.log_std.fill_(value)  # type: ignore[operator]

    def _on_step(self) -> bool:
        return True


class ProgressLines(BaseCallback):
    """Lines of progress every 10 s, where no progress bar can be drawn, such as in a file.

    Args:
        steps: environment steps of the run.
    """

    def __init__(self, steps: int) -> None:
        super().__init__()
        self._steps = steps

    def _on_training_start(self) -> None:
        self._first = self.model.num_timesteps  # of a resumed run
        self._progress = Progress("steps", self._steps - self._first)

    def _on_step(self) -> bool:
        self._progress.reach(self.num_timesteps - self._first)
        return True


class ValueWarmup(BaseCallback):
    """Warm-up of PPO's value function, with a fixed policy: advantages from an untrained value function are noise.

    Args:
        steps: environment steps during which only the value function is updated.
    """

    def __init__(self, steps: int) -> None:
        super().__init__()
        self._steps = steps

    def _on_rollout_start(self) -> None:
        policy = self.model.policy
        for part in (policy.mlp_extractor.policy_net, policy.action_net):  # type: ignore[union-attr]
            part.requires_grad_(self.num_timesteps >= self._steps)

    def _on_step(self) -> bool:
        return True


class Evaluation(BaseCallback):
    """Periodic and final evaluation of the deterministic policy on the selection seeds; saves the best policy.

    The best policy has the highest mean return, the metric "reward"; over a hundred episodes it is a better criterion
    than the share of settled episodes. A warning is printed when a policy settles much less often than the best policy.

    Args:
        settings: settings of the run.
        law: deterministic policy: function from observations (b, size) to actions (b, n).
        save_best: function that saves the policy as the best one.

    Attributes:
        latest: metrics of the latest evaluation.
    """

    state_fields = ("_best", "_next", "_warned")

    def __init__(self, settings: Settings, law: Law | None, save_best: Callable[[], None]) -> None:
        super().__init__()
        self._environment, interface = split_interface(settings.environment)
        self._agent = AgentSpec("training", law, interface)
        self._every, self._last, self._save_best = settings.eval_every, settings.steps, save_best
        self._best = [-math.inf, 0.0]  # mean return, share of settled episodes
        self.latest: Mapping[str, float] = {}
        self.begin()

    def begin(self) -> None:
        """Schedule the next evaluation `eval_every` steps after the start of a run, and re-enable the warning."""
        self._next, self._warned = self._every, False

    def _on_step(self) -> bool:
        return True

    def _on_rollout_end(self) -> None:
        if self.num_timesteps >= self._next:
            self._next = self.num_timesteps + self._every
            self._evaluate()

    def _on_training_end(self) -> None:
        if self.num_timesteps >= self._last:  # not stopped earlier
            self._evaluate()

    def _evaluate(self) -> None:
        """Evaluate the current policy and save it if it is the best so far."""
        self.latest = result = evaluate(self._agent, self._environment, SELECTION_SEEDS)
        for name in CURVE_METRICS:
            unit = METRICS[name].unit
            self.logger.record(f"selection/{name}_{unit}" if unit else f"selection/{name}", result[name])
        if result["reward"] > self._best[0]:
            self._best, self._warned = [result["reward"], result["settled"]], False
            self._save_best()
        elif result["settled"] < self._best[1] - WARNING_DROP and not self._warned:
            self._warned = True
            share = f"{result['settled']:.0%} settle instead of {self._best[1]:.0%}"
            text = f"after {self.num_timesteps} steps the policy is worse than before: {share}; the best one is kept"
            print(text, file=sys.stderr)

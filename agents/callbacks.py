"""Callbacks: what happens on the way of a training, its exploration, its judgement and its curves."""

import sys
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import torch
from stable_baselines3 import SAC
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.logger import Logger, make_output_format

from flexman_agents.evaluation import evaluate, summary
from flexman_agents.policies import Act, Policy, parted
from flexman_agents.seeds import SELECTION
from flexman_agents.settings import Schedule, Settings

WORSE = 0.2  # share of settled episodes that may be lost before a warning


def writers(folder: Path, steps: int = 0) -> Logger:
    """Opens progress.csv, or progress-STEPS.csv for what follows after so many, and TensorBoard events in a folder."""
    suffix = f"-{steps}" if steps else ""
    return Logger(str(folder), [make_output_format(kind, str(folder), suffix) for kind in ("csv", "tensorboard")])


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


class Saves(BaseCallback):
    """Saves the run."""

    def __init__(self, save: Callable[[], bool]) -> None:
        super().__init__()
        self._save = save

    def _on_step(self) -> bool:
        return self._save()


class Judge(BaseCallback):
    """Evaluates the policy without noise on selection seeds, records its figures and keeps the best one.

    The best settles most often within the band; among equals the one with the smaller median error. A run that goes on
    begins with the figures of its best so far. A line on stderr says so when a policy has become much worse than the
    best.
    """

    def __init__(self, settings: Settings, act: Act, keep: Callable[[], bool], best: Act | None = None) -> None:
        super().__init__()
        self._environment, interface = parted(settings.description)
        self._policy = Policy("training", act, interface)
        self._every, self._keep, self._next = settings.judge_every, keep, settings.judge_every
        self._best = (-1.0, 0.0) if best is None else _score(self._judged(best))
        self._warned = False

    def _judged(self, act: Act) -> dict[str, Any]:
        """Figures of what acts."""
        return summary(evaluate(replace(self._policy, act=act), self._environment, SELECTION))

    def _on_training_start(self) -> None:
        self._next = self.num_timesteps + self._every

    def _on_step(self) -> bool:
        return True

    def _on_rollout_end(self) -> None:
        if self.num_timesteps < self._next:
            return
        self._next = self.num_timesteps + self._every
        found = self._judged(self._policy.act)
        names = {"stabilisation_time": "stabilisation_time_s", "vibration": "vibration_m", "error": "error_m"}
        for key, name in names.items():
            self.logger.record(f"selection/{name}", found[key][0])
        for key in ("reward", "settled", "failed"):
            self.logger.record(f"selection/{key}", found[key])
        score = _score(found)
        if score > self._best:
            self._best, self._warned = score, False
            self._keep()
        elif score[0] < self._best[0] - WORSE and not self._warned:
            self._warned = True
            share = f"{score[0]:.0%} settle instead of {self._best[0]:.0%}"
            said = f"after {self.num_timesteps} steps the policy is worse than before: {share}; the best one is kept"
            print(said, file=sys.stderr)


def _score(found: dict[str, Any]) -> tuple[float, float]:
    return found["settled"], -found["error"][0]

"""Training steps: what PPO of agents.training costs, learning included, and which part of it the arms take."""

import time
from collections.abc import Callable
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from flexman_gym.envs.vector_env import FlexManVectorEnv
from flexman_gym.studies.benchmark.rows import Cost, Timer


class Watch:
    """A context in which the time of all calls of a method is added up."""

    def __init__(self, owner: type, name: str) -> None:
        self._owner, self._name, self._method = owner, name, getattr(owner, name)
        self.cpu = self.wall = 0.0

    def __enter__(self) -> "Watch":
        method: Callable[..., Any] = self._method

        def watched(*arguments: Any, **named: Any) -> Any:
            started = time.process_time(), time.perf_counter()
            try:
                return method(*arguments, **named)
            finally:
                self.cpu += time.process_time() - started[0]
                self.wall += time.perf_counter() - started[1]

        setattr(self._owner, self._name, watched)
        return self

    def __exit__(self, *error: object) -> None:
        setattr(self._owner, self._name, self._method)


def ppo(arms: int, rollouts: int) -> Timer:
    """Steps of a new policy in so many rollouts; raises ImportError without Stable-Baselines3."""
    from flexman_agents.settings import HYPERPARAMETERS, Settings
    from flexman_agents.training import ALGORITHMS, train

    steps = rollouts * arms * HYPERPARAMETERS["ppo"]["n_steps"]
    settings = Settings(algo="ppo", envs=arms, steps=steps)

    def measure() -> Cost:
        learning, stepping = Watch(ALGORITHMS["ppo"], "learn"), Watch(FlexManVectorEnv, "step")
        with TemporaryDirectory() as folder, learning as learn, stepping as step:
            train(settings, Path(folder) / "run", progress=False)
        return Cost(learn.cpu / steps, learn.wall / steps, step.cpu / learn.cpu)

    return measure

"""Measure the overhead of learning libraries and of worker processes: python scripts/scale.py [NAME ...]"""

import argparse
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np

import flexman_gym  # noqa: F401  registers the environments
from flexman_gym.common.parallel import Workers, parallel_map

ARMS, PERIODS, UPDATES = 256, 12, 20
RECIPE = "ppo_on_pd_minute"
SETTINGS: dict[str, Any] = {
    "base": "pd", "action_repeat": 5, "sensors": ("full", "fine"), "task": {"kind": "slew", "reward": "distance"},
}  # fmt: skip


def environment(infos: str = "at end", updates: int = UPDATES) -> float:
    """Return the steps per CPU second of the vector environment alone."""
    env = gym.make_vec("FlexRRR-v0", ARMS, "vector_entry_point", autoreset_mode="SameStep", infos=infos, **SETTINGS)
    env.reset(seed=0)
    still = np.zeros((ARMS, 3), dtype=np.float32)
    env.step(still)
    started = time.process_time()
    for _ in range(updates * PERIODS):
        env.step(still)
    return updates * PERIODS * ARMS / (time.process_time() - started)


def torchrl() -> float:
    """Return the steps per CPU second of TorchRL's collector with a two-layer policy."""
    from torchrl.collectors import Collector

    sys.path.insert(0, "docs/examples")
    import collect  # type: ignore[import-not-found]

    env, moments, frames = collect.make(), [], ARMS * PERIODS
    env.set_seed(0)
    for _ in Collector(env, collect.actor(env), frames_per_batch=frames, total_frames=frames * (UPDATES + 1)):
        moments.append(time.process_time())
    return UPDATES * frames / (moments[-1] - moments[0])


def sb3() -> float:
    """Return the steps per CPU second of PPO training with Stable-Baselines3, updates included."""
    from flexman_agents.settings import find_recipe
    from flexman_agents.training import train

    settings, moments = replace(find_recipe(RECIPE), steps=(UPDATES + 2) * ARMS * PERIODS), []
    with tempfile.TemporaryDirectory() as folder:
        train(settings, Path(folder) / "run", progress=False,
              hook=lambda report: moments.append((report.steps, time.process_time())))  # fmt: skip
    return _rate(moments)


def rllib() -> float:
    """Return the steps per CPU second of PPO training with RLlib and a local runner, updates included."""
    from ray.rllib.algorithms.ppo import PPO

    from flexman_agents import rllib
    from flexman_agents.settings import find_recipe

    settings, moments, inner = replace(find_recipe(RECIPE), steps=(UPDATES + 2) * ARMS * PERIODS), [], PPO.train

    def watched(self: Any) -> Any:
        result = inner(self)
        moments.append((int(result["env_runners"]["num_env_steps_sampled_lifetime"]), time.process_time()))
        return result

    PPO.train = watched
    with tempfile.TemporaryDirectory() as folder:
        rllib.train_rllib(settings, Path(folder) / "run", 0, 0)
    return _rate(moments)


def _rate(moments: list[tuple[int, float]]) -> float:
    (before, started), (after, ended) = moments[2], moments[-1]
    return (after - before) / (ended - started)


def started(number: int) -> float:
    """Return the CPU seconds used by a worker before its first cell, then wait, so that a second worker starts too."""
    result = time.process_time()
    time.sleep(2.0)
    return result


def worker() -> float:
    """Return the CPU seconds of the start of a worker process, including loading cached kernels."""
    return max(parallel_map(started, range(2), Workers(2)))


PARTS: dict[str, Callable[[], float]] = {
    "environment": environment, "environment with infos": lambda: environment("always"), "torchrl": torchrl,
    "sb3": sb3, "rllib": rllib, "worker": worker,
}  # fmt: skip


def main() -> None:
    """Measure the selected parts and print one line each."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("part", nargs="*", help=f"parts to measure, from {', '.join(PARTS)}; default: all")
    for name in parser.parse_args().part or PARTS:
        print(f"{name} {PARTS[name]():.4g}", flush=True)


if __name__ == "__main__":
    main()

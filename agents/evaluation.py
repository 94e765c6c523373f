"""Evaluation: episodes of a policy, and what they are worth, in figures and one table."""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
from numpy.typing import NDArray

import flexman_gym  # noqa: F401  registers the environments
from flexman_agents.residual import readings
from flexman_agents.training import MODEL, STATISTICS, existing, load_settings, make_env

Array = NDArray[np.float64]
Act = Callable[[NDArray[np.float32]], NDArray[np.float32]]

BASELINES = ("pd", "zero", "random")
SETTLED = 0.05  # m of tip error
LAST_SECONDS = 3.0  # of an episode, in which the vibration that is left is measured


@dataclass(frozen=True)
class Episode:
    """Figures of one episode; an episode that failed has no residual vibration and never settles.

    Attributes:
        total_reward: sum of the rewards.
        tip_error: m, median over the last second.
        vibration: m, largest peak-to-peak motion of the tip along an axis in the last 3 s.
        settling_time: s after which the tip stays within 50 mm of the target; infinite if it does not.
        failure: "" or what ended the episode.
    """

    total_reward: float
    tip_error: float
    vibration: float
    settling_time: float
    failure: str


def load_policy(name: str) -> tuple[gym.Env[Any, Any], Act]:
    """The environment and the acting function of a policy.

    Args:
        name: "pd", "zero", "random", or the folder of a training run.

    Raises:
        FileNotFoundError, ValueError: one line with what is wrong and what is allowed.
    """
    if name not in BASELINES:
        return _trained(Path(name))
    env = gym.make("FlexRRR-v0")
    if name == "pd":
        pd = env.unwrapped.setup.pd  # type: ignore[attr-defined]
        return env, lambda observation: pd.act(readings(env, observation))
    size = env.action_space.shape or ()
    if name == "zero":
        return env, lambda observation: np.zeros(size, dtype=np.float32)
    random = np.random.default_rng(0)
    return env, lambda observation: random.uniform(-1.0, 1.0, size).astype(np.float32)


def _trained(folder: Path) -> tuple[gym.Env[Any, Any], Act]:
    if not folder.is_dir():
        names = ", ".join(BASELINES)
        raise FileNotFoundError(f"policy: {folder} is not allowed; give the folder of a training run, or {names}")
    settings = load_settings(folder)
    model_path, statistics_path = existing(folder / MODEL), existing(folder / STATISTICS)
    import torch  # a second to import, which the baselines need not wait for
    from stable_baselines3.common.vec_env import DummyVecEnv, VecNormalize

    from flexman_agents.training import ALGORITHMS

    torch.set_num_threads(1)
    model = ALGORITHMS[settings.algo].load(model_path, device="cpu")
    statistics = VecNormalize.load(str(statistics_path), DummyVecEnv([lambda: make_env(settings)]))

    def act(observation: NDArray[np.float32]) -> NDArray[np.float32]:
        action, _ = model.predict(statistics.normalize_obs(observation), deterministic=True)
        return np.asarray(action, dtype=np.float32)

    return make_env(settings), act


def run_episode(env: gym.Env[Any, Any], act: Act, seed: int) -> Episode:
    """One episode from a seed."""
    observation, info = env.reset(seed=seed)
    tips, errors, total, over = [info["tip"]], [info["tip_error"]], 0.0, False
    while not over:
        observation, reward, terminated, truncated, info = env.step(act(observation))
        total += float(reward)
        tips.append(info["tip"])
        errors.append(info["tip_error"])
        over = terminated or truncated
    period = env.unwrapped.simulator.control_period  # type: ignore[attr-defined]
    return episode_figures(total, np.array(tips), np.array(errors), period, info["failure"])


def episode_figures(total: float, tips: Array, errors: Array, period: float, failure: str) -> Episode:
    """Figures from tip positions (T, 3) m and tip errors (T,) m sampled with a period in s."""
    if failure:
        return Episode(total, float(errors[-1]), float("nan"), float("inf"), failure)
    outside = np.nonzero(errors > SETTLED)[0]
    settled_at = 0 if len(outside) == 0 else int(outside[-1]) + 1
    last = tips[-round(LAST_SECONDS / period) :]
    return Episode(
        total_reward=total,
        tip_error=float(np.median(errors[-round(1.0 / period) :])),
        vibration=float((last.max(axis=0) - last.min(axis=0)).max()),
        settling_time=settled_at * period if settled_at < len(errors) else float("inf"),
        failure="",
    )


def evaluate(name: str, episodes: int, seed: int) -> list[Episode]:
    """Episodes of a policy with the seeds seed, seed + 1, ...; the same for every policy."""
    env, act = load_policy(name)
    return [run_episode(env, act, seed + i) for i in range(episodes)]


def table(results: Mapping[str, Iterable[Episode]]) -> str:
    """One line a policy: medians over its episodes, share that settled, share that failed."""
    head = f"{'policy':<12}{'mean reward':>12}{'tip error':>12}{'vibration':>12}{'settled':>10}{'failed':>9}"
    unit = f"{'':<12}{'of 500':>12}{'median m':>12}{'median m':>12}{'in 50 mm':>10}{'':>9}"
    lines = [head, unit]
    for name, result in results.items():
        episodes = list(result)
        good = [episode.vibration for episode in episodes if not episode.failure]
        vibration = f"{np.median(good):.3f}" if good else "-"
        settled = np.mean([np.isfinite(episode.settling_time) for episode in episodes])
        failed = np.mean([episode.failure != "" for episode in episodes])
        reward = np.mean([episode.total_reward for episode in episodes])
        error = np.median([episode.tip_error for episode in episodes])
        lines.append(f"{name:<12}{reward:>12.1f}{error:>12.3f}{vibration:>12}{settled:>10.0%}{failed:>9.0%}")
    return "\n".join(lines)

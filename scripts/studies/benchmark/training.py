"""Cost of PPO training steps, updates included, and the share of it spent in the environment."""

from pathlib import Path
from tempfile import TemporaryDirectory

from flexman_gym.envs.vector_env import FlexManVectorEnv
from studies.stopwatch import Cost, Stopwatch, Timer


def ppo(arms: int, rollouts: int) -> Timer:
    """Return a timer of PPO training steps with a new policy over a number of rollouts.

    Raises:
        ImportError: without Stable-Baselines3.
    """
    from stable_baselines3 import PPO

    from flexman_agents.settings import DEFAULT_HYPERPARAMETERS, Settings
    from flexman_agents.training import train

    steps = rollouts * arms * DEFAULT_HYPERPARAMETERS["ppo"]["n_steps"]
    settings = Settings(algo="ppo", envs=arms, steps=steps)

    def measure() -> Cost:
        learning, stepping = Stopwatch(PPO, "learn"), Stopwatch(FlexManVectorEnv, "step")
        with TemporaryDirectory() as folder, learning as learn, stepping as step:
            train(settings, Path(folder) / "run", progress=False)
        return Cost(learn.cpu / steps, learn.wall / steps, step.cpu / learn.cpu)

    return measure

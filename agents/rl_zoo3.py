"""RL Zoo: recipes as hyperparameter files of rl_zoo3."""

from pathlib import Path
from typing import Any

from flexman_agents.sb3 import ALGORITHMS, algorithm_arguments
from flexman_agents.settings import EXPLORATION, RECIPE_FOLDER, RECIPES, Schedule, Settings, find_recipe
from flexman_gym.common import files
from flexman_gym.common.checks import value_error

ZOO = RECIPE_FOLDER / "rl_zoo3"
KNOWN = [name for name in RECIPES if find_recipe(name).algo in ALGORITHMS]  # to rl_zoo3
CALLBACK = "flexman_agents.callbacks.Exploration"


def zoo_hyperparameters(settings: Settings) -> dict[str, Any]:
    """Gives settings in the form of rl_zoo3, id of the environment -> hyperparameters.

    The schedule of the exploration becomes a callback. The seed is said on the command line of rl_zoo3, and judging is
    its own.

    Raises:
        ValueError: for a learning rate that neither stays nor falls to zero at the end, which rl_zoo3 cannot say.
    """
    chosen = algorithm_arguments(settings)
    policy = chosen.pop("policy_kwargs")
    words = [f"{name}={_word(value)}" for name, value in policy.items()]
    chosen["learning_rate"] = _rate(chosen["learning_rate"])
    described = settings.environment
    result = {
        "n_envs": settings.envs,
        "n_timesteps": settings.steps,
        "policy": "MlpPolicy",
        "normalize": {"norm_obs": True, "norm_reward": settings.normalise_reward},
        **chosen,
        "policy_kwargs": f"dict({', '.join(words)})",
        "env_kwargs": _difference(described.to_plain(), type(described)(described.id).to_plain()),
    }
    for name in EXPLORATION:
        if name in settings.schedules:
            result["callback"] = {CALLBACK: {"schedule": dict(settings.schedules[name]), "steps": settings.steps}}
    return {described.id: result}


def write_zoo_files(folder: Path = ZOO) -> None:
    """Writes the recipes of algorithms that rl_zoo3 has into a folder, a file for each."""
    folder.mkdir(exist_ok=True)
    for name in KNOWN:
        files.write_data(folder / f"{name}.yml", zoo_hyperparameters(find_recipe(name)))


def _rate(rate: object) -> object:
    if not isinstance(rate, Schedule):
        return rate
    if rate.end == rate.start:
        return rate.start
    if rate.end != 0.0 or rate.until != 1.0:
        raise value_error("schedules.learning_rate", rate, "one that stays, or falls to zero at the end, for rl_zoo3")
    return f"lin_{rate.start}"


def _word(value: object) -> str:
    return f"nn.{value.__name__}" if isinstance(value, type) else repr(value)


def _difference(settings: dict[str, Any], named: dict[str, Any]) -> dict[str, Any]:
    """The settings that the named environment does not have of itself."""
    return {name: value for name, value in settings.items() if name != "id" and named.get(name) != value}

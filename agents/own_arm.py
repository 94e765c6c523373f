"""Settings of a recipe for an arm of the user: times, payloads, exploration and episodes in proportion to the arm."""

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from flexman_agents.settings import Settings
from flexman_gym.envs.config.arm_settings import ArmFacts, arm_facts
from flexman_gym.envs.config.conditions import usual_payload
from flexman_gym.envs.config.configuration import Configuration
from flexman_gym.envs.config.named_environments import NAMED_ENVIRONMENTS
from flexman_gym.evaluation.agent_spec import INTERFACE, AgentSpec, split_interface
from flexman_gym.evaluation.metrics import DEFAULT_TASK_METRICS, METRICS
from flexman_gym.evaluation.rollouts import SELECTION_SEEDS, rollout

ACTIONS_PER_SLEW = 16  # actions of the agent in the median slew of an arm of the user
SETTLING_TIMES, SLEWS = 2.0, 8.0  # of the base, and median slews, in an episode of the training
ENTROPY = 0.002  # coefficient of the entropy bonus: without it deviations vanish before the policy avoids limits
FEWEST_SLEWS = 3.0  # median slews in an episode of the training, at least
BASE_SEEDS = SELECTION_SEEDS[:20]  # seeds of the episodes in which the base is timed


def fit_to_arm(settings: Settings, arm: object, changes: Sequence[str] = ()) -> Settings:
    """Return the settings of a recipe for an arm of the user.

    An action lasts a sixteenth of the median slew. An episode of reinforcement learning lasts twice the settling time
    of the base controller, so that most samples belong to motions, or eight median slews if the base does not settle.
    The torques of PPO at random are in proportion to those of a slew. Time constants of the history and ranges of the
    payload are in proportion to those of the named environment. Control period, horizon, limits, slew time and gains
    follow from the arm.

    Args:
        settings: settings of the recipe.
        arm: as the setting `arm` of an environment, or the path of a file of an environment. The settings of such a
            file take precedence over those of the recipe, apart from those of the agent in INTERFACE.
        changes: changes "name=value" of settings of the environment, which take precedence.

    Raises:
        ValueError: for a recipe that is trained over random arms.
    """
    if settings.arms is not None:
        allowed = "none: this recipe is trained over random arms, and its policy acts on any"
        raise ValueError(f"arm: a file is not allowed; give {allowed}")
    named, given = settings.environment, {"arm": arm}  # checked after the changes, which may have torque limits
    kept = named.without(("arm", "gains", "horizon", "control_period", "limits", "slew_time"))
    if of_file := Configuration.of_file(arm):
        given = {name: each for name, each in of_file.given.items() if name not in INTERFACE}
        kept = Configuration(of_file.id, kept.given)
    own = kept.changed(changes, **given)
    scaled: dict[str, Any] = {"action_repeat": max(1, round(action_time(own) / own.control_period))}
    if isinstance(own.history, tuple):
        scale = action_time(own) / action_time(named)
        scaled["history"] = [float(f"{scale * each:.3g}") for each in own.history]
    if "payload_mass" in own.randomised_ranges and "randomisation" not in given:
        scaled["randomisation"] = own.randomised_ranges | {"payload_mass": _payload_range(named, own)}
    environment = own.replace(**scaled).changed(changes)
    if settings.algo == "dagger":
        return replace(settings, environment=environment)
    horizon = min(_episode_time(environment), environment.horizon)
    fitted = replace(settings, environment=environment, training_horizon=float(f"{horizon:.3g}"))
    return _scale_exploration(fitted) if settings.algo == "ppo" and environment.actions == "torque" else fitted


def action_time(environment: Configuration) -> float:
    """Return the time of an action that suits the slews of the arm of an environment, s."""
    return _median_slew(environment) / ACTIONS_PER_SLEW


def base_alone(environment: Configuration, base: object) -> tuple[Configuration, AgentSpec]:
    """Return an environment without the settings of the agent, and the agent that is a base controller alone."""
    bare, interface = split_interface(environment)
    gains = {name: interface[name] for name in ("gains",) if name in interface}
    return bare, AgentSpec("base", None, {"base": base, **gains})


def _episode_time(environment: Configuration) -> float:
    """Return the time of an episode of the training, s."""
    slew = _median_slew(environment)
    metrics = getattr(environment.task, "metrics", DEFAULT_TASK_METRICS)
    if environment.base is None or "settling_time" not in metrics:
        return SLEWS * slew
    bare, agent = base_alone(environment, environment.base)
    records = rollout(agent, bare, BASE_SEEDS).records
    time = float(np.median(METRICS["settling_time"].values(records)))
    return max(SETTLING_TIMES * time, FEWEST_SLEWS * slew) if math.isfinite(time) else SLEWS * slew


def _scale_exploration(settings: Settings) -> Settings:
    """Return settings with standard deviations of the actions in proportion to the torques of a slew."""
    change = math.log(_facts(settings.environment).torque_share)
    values, schedules = dict(settings.hyperparameters), dict(settings.schedules)
    if "log_std_init" in values:
        values = {"ent_coef": ENTROPY} | values | {"log_std_init": round(values["log_std_init"] + change, 2)}
    if "log_std" in schedules:
        moved = {name: round(schedules["log_std"][name] + change, 2) for name in ("start", "end")}
        schedules["log_std"] = {**schedules["log_std"], **moved}
    return replace(settings, hyperparameters=values, schedules=schedules)


def _median_slew(environment: Configuration) -> float:
    """Return the median duration of the slews of an arm, s."""
    return float(np.median(_facts(environment).durations))


def _facts(environment: Configuration) -> ArmFacts:
    """Return the properties of the arm of an environment."""
    return arm_facts(environment.arm, environment.torque_limit, environment.slew_span)


def _payload_range(named: Configuration, own: Configuration) -> list[float]:
    """Return the payloads (kg) of an arm in the same ratio to its usual payload as in a recipe."""
    ratio = usual_payload(own.arm) / NAMED_ENVIRONMENTS[named.id].usual_payload
    return [float(f"{ratio * each:.6g}") for each in named.randomised_ranges["payload_mass"]]

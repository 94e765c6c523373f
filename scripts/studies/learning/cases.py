"""Learning, cases: the recipes with their seeds, and PPO on PD without one of its means at a time."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

from flexman_agents.recipes import find_recipe
from flexman_agents.settings import Settings

ABLATED = "ppo_on_pd_minute"
SEEDS = {"ppo_on_pd_minute": 5, "ppo_on_pd": 5, "ppo_alone": 1, "sac_on_pd": 3, "planar_ppo_on_pd": 3,
         "lab_ppo_shaping": 3, "lab_student": 3, "ppo_shaping": 3, "track_ppo_on_pd": 1, "hold_ppo_on_pd": 1,
         "gravity_ppo_on_pd": 1, "planar_track_ppo_on_pd": 1, "planar_hold_ppo_on_pd": 1}  # fmt: skip
UNKNOWN = "FlexRRR-v0/unknown-lab"
# recipes that are judged elsewhere than they learn
VENUES = {"ppo_shaping": "FlexRRR-v0", "lab_ppo_shaping": UNKNOWN, "lab_student": UNKNOWN}
ABLATION_SEEDS = 3
CONTROLLERS = {"FlexRRR-v0": ("pd", "lqr", "lqr-tracking"), "FlexPlanar-v0": ("pd", "lqr", "lqr-tracking")}
LAW, ESTIMATOR, LEARNED = "lqr-tracking", "adaptive-lqr", "lab-flexrrr"
TASKS = {
    "FlexRRR-Track-v0": ("track_ppo_on_pd", LAW),
    "FlexRRR-Hold-v0": ("hold_ppo_on_pd", LAW),
    "FlexRRR-Gravity-v0": ("gravity_ppo_on_pd", LAW),
    "FlexPlanar-v0": ("planar_ppo_on_pd", LAW),
    "FlexPlanar-Track-v0": ("planar_track_ppo_on_pd", LAW),
    "FlexPlanar-Hold-v0": ("planar_hold_ppo_on_pd", LAW),
    UNKNOWN: (LEARNED, ESTIMATOR),
    "FlexRRR-Track-v0/unknown-lab": ("", ESTIMATOR),
    "FlexRRR-Hold-v0/unknown-lab": (LEARNED, ESTIMATOR),
    "FlexRRR-Gravity-v0/unknown-lab": (LEARNED, ESTIMATOR),
    "FlexPlanar-v0/unknown-lab": ("", ESTIMATOR),
    "FlexPlanar-Track-v0/unknown-lab": ("", ESTIMATOR),
    "FlexPlanar-Hold-v0/unknown-lab": ("", ESTIMATOR),
}
"""Venue -> the recipe or the shipped policy that learned for it, "" for none, and a controller that knows a model."""


@dataclass(frozen=True)
class Without:
    """PPO on PD without one of its means: what is changed of its settings, and in words.

    Attributes:
        means: what is taken away.
        instead: what takes its place.
        environment, hyperparameters, schedules: settings that change; a schedule of None is taken away.
        steps: instead of the recipe's, for the same CPU time.
    """

    means: str
    instead: str
    environment: Mapping[str, Any] = field(default_factory=dict)
    hyperparameters: Mapping[str, Any] = field(default_factory=dict)
    schedules: Mapping[str, Any] = field(default_factory=dict)
    steps: int | None = None

    def settings(self, whole: Settings) -> Settings:
        """The settings of the recipe with the changes."""
        schedules = {**whole.schedules, **self.schedules}
        return replace(
            whole,
            environment={**whole.environment, **self.environment},
            hyperparameters={**whole.hyperparameters, **self.hyperparameters},
            schedules={name: schedule for name, schedule in schedules.items() if schedule is not None},
            steps=self.steps or whole.steps,
        )


ABLATIONS = {
    "hold": Without(
        "the held action",
        "a new action in every control period; discount and lambda the same for a second, steps for the same CPU time",
        {"hold": 1},
        {"n_steps": 60, "gamma": 0.99, "gae_lambda": 0.98},
        steps=1_600_000,
    ),
    "rate": Without(
        "the schedule of the learning rate", "the rate of the start throughout",
        schedules={"learning_rate": {"start": 0.001, "end": 0.001}},
    ),
    "reward": Without("the reward with slope at every scale", "the reward of bells", {"task": {"kind": "slew"}}),
    "discount": Without("the short horizon", "a discount of 0.99 an action", hyperparameters={"gamma": 0.99}),
}  # fmt: skip


@dataclass(frozen=True)
class Case:
    """Runs of one kind: "recipe" or "ablation", name, settings, and how many seeds."""

    kind: str
    name: str
    settings: Settings
    seeds: int


def cases() -> list[Case]:
    """All of them, the recipes first."""
    recipes = [Case("recipe", name, find_recipe(name), count) for name, count in SEEDS.items()]
    whole = find_recipe(ABLATED)
    return recipes + [
        Case("ablation", name, without.settings(whole), ABLATION_SEEDS) for name, without in ABLATIONS.items()
    ]

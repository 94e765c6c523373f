"""Learning study: cases, training runs and their results, learning curves."""

import json
import shutil
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from flexman_agents.settings import Settings, find_recipe
from flexman_agents.training import train
from flexman_gym.common.parallel import Workers, parallel_map
from flexman_gym.envs.config.configuration import Configuration
from flexman_gym.envs.config.named_environments import DEFAULT_ID, NAMED_ENVIRONMENTS
from flexman_gym.envs.vector_env import FlexManVectorEnv, compile_kernels
from flexman_gym.evaluation.agent_spec import AgentSpec, split_interface
from flexman_gym.evaluation.agents import find_agent
from flexman_gym.evaluation.metrics import METRICS
from flexman_gym.evaluation.policy_files import POLICIES
from flexman_gym.evaluation.rollouts import TEST_SEEDS, rollout
from flexman_gym.simulation.integrator import default_step
from flexman_gym.toolbox.view.learning_curves import draw_learning_curves, read_progress
from studies.stopwatch import Stopwatch

ABLATED = "ppo_on_pd_minute"
PICTURE = f"learning_{DEFAULT_ID}.svg"
# runs of a training; fewer of those that take more than four CPU minutes
SEEDS = {"ppo_on_pd_minute": 5, "ppo_on_pd": 3, "ppo_alone": 1, "sac_on_pd": 1, "planar_ppo_on_pd": 3,
         "lab_ppo_shaping": 2, "lab_student": 2, "ppo_shaping": 2, "track_ppo_on_pd": 1, "hold_ppo_on_pd": 1,
         "gravity_ppo_on_pd": 1, "planar_track_ppo_on_pd": 1, "planar_hold_ppo_on_pd": 1}  # fmt: skip
UNKNOWN = "FlexRRR-v0/unknown-lab"
# recipe -> scenario of its evaluation, where it differs from the training environment
EVALUATED_IN = {"ppo_shaping": "FlexRRR-v0", "lab_ppo_shaping": UNKNOWN, "lab_student": UNKNOWN}
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
"""Scenario -> its recipe or shipped policy ("" for none), and a model-based controller."""


@dataclass(frozen=True)
class _Without:
    """Ablation of one setting of the recipe.

    Attributes:
        means: removed setting, in words.
        instead: replacement, in words.
        environment, hyperparameters, schedules: changed settings; a schedule of None is removed.
        steps: number of steps, chosen for equal CPU time; None keeps that of the recipe.
    """

    means: str
    instead: str
    environment: Mapping[str, Any] = field(default_factory=dict)
    hyperparameters: Mapping[str, Any] = field(default_factory=dict)
    schedules: Mapping[str, Any] = field(default_factory=dict)
    steps: int | None = None

    def settings(self, whole: Settings) -> Settings:
        """Return the settings of the recipe with the ablation applied."""
        schedules = {**whole.schedules, **self.schedules}
        return replace(
            whole,
            environment=whole.environment.replace(**self.environment),
            hyperparameters={**whole.hyperparameters, **self.hyperparameters},
            schedules={name: schedule for name, schedule in schedules.items() if schedule is not None},
            steps=self.steps or whole.steps,
        )


ABLATIONS = {
    "hold": _Without(
        "the held action",
        "a new action in every control period, 1.6 times as many actions, equal time scales of discount and lambda",
        {"action_repeat": 1},
        {"n_steps": 60, "gamma": 0.99, "gae_lambda": 0.98},
        steps=1_600_000,
    ),
    "rate": _Without(
        "the schedule of the learning rate", "the initial rate throughout",
        schedules={"learning_rate": {"start": 0.001, "end": 0.001}},
    ),
    "reward": _Without(
        "the sloped reward", "the default reward, a sum of bell curves",
        {"task": {"kind": "slew"}},
    ),
    "discount": _Without("the short horizon", "a discount of 0.99 per action", hyperparameters={"gamma": 0.99}),
}  # fmt: skip


@dataclass(frozen=True)
class LearningCase:
    """Training runs of a kind ("recipe" or "ablation") with their name, settings and number of seeds."""

    kind: str
    name: str
    settings: Settings
    seeds: int


def cases() -> list[LearningCase]:
    """Return all cases, recipes first."""
    recipes = [LearningCase("recipe", name, find_recipe(name), count) for name, count in SEEDS.items()]
    whole = find_recipe(ABLATED)
    return recipes + [
        LearningCase("ablation", name, without.settings(whole), ABLATION_SEEDS) for name, without in ABLATIONS.items()
    ]


COLUMN = "rollout/ep_rew_mean"  # recorded by every run, with or without evaluation during training
POINTS = 50  # number of points of a learning curve, equidistant in steps


@dataclass(frozen=True)
class Point:
    """Point of a learning curve: mean reward of the latest training episodes after a number of steps."""

    name: str
    seed: float
    steps: float
    reward: float


def points(name: str, seed: int, folder: Path) -> Iterator[Point]:
    """Yield the learning curve of the run in a folder at POINTS equidistant steps."""
    steps, rewards, _ = read_progress(folder, COLUMN)
    for each in np.linspace(steps[0], steps[-1], POINTS):
        yield Point(name, seed, float(each), float(np.interp(each, steps, rewards)))


def environment(name: str) -> str:
    """Return the id of the environment in which a recipe is trained."""
    return str(find_recipe(name).environment.id)


def adds_to_pd(name: str) -> bool:
    """Return whether a recipe has a PD as base controller."""
    return bool(find_recipe(name).environment.base == "pd")


def picture(curves: Sequence[Point], folder: Path) -> Path:
    """Plot PICTURE: the recipes of DEFAULT_ID that add to a PD and therefore share a reward; return its path."""
    names = [name for name in SEEDS if any(point.name == name for point in curves) and adds_to_pd(name)]
    runs = {name: _seeds(curves, name) for name in names if environment(name) == DEFAULT_ID}
    return draw_learning_curves(runs, folder / PICTURE, "reward of a training episode")


def _seeds(curves: Sequence[Point], name: str) -> list[tuple[np.ndarray, np.ndarray]]:
    own = [point for point in curves if point.name == name]
    found = sorted({point.seed for point in own})
    each = [[(point.steps, point.reward) for point in own if point.seed == seed] for seed in found]
    return [(np.array(run)[:, 0], np.array(run)[:, 1]) for run in each]


COST = "cost.json"
TASK = {"kind": "slew", "reward": "distance"}  # task of the recipes
AS_TRAINED, FINER, LONGER = "as trained", "finer model", "longer episodes"
LONG = 30.0  # s; duration of the longer episodes
FINER_ELEMENTS, FINER_STEPS = 3, 4  # elements per link; steps per default step


@dataclass(frozen=True)
class LearningRow:
    """Results of a policy on the test episodes, and the cost of its training.

    Attributes:
        kind: "recipe", "ablation", "controller", or "task" for scenarios of other tasks.
        name, seed: name and seed of the run.
        where: variant of the environment, see `variants`.
        steps, cpu, rate, share: actions and CPU time (s) of the training, actions per CPU second, share of the CPU
            time spent in the environment.
        settled: share of episodes that stay within the band until the end.
        time, vibration, error: medians, s, m and m; `time_low`, `time_high`: confidence interval of the time.
        reward, effort, failed, roughness: means; roughness is None in older rows.
        rms: median RMS tip error, m; None in older rows.
    """

    kind: str
    name: str
    seed: float | None
    where: str
    steps: float | None
    cpu: float | None
    rate: float | None
    share: float | None
    settled: float
    time: float
    time_low: float
    time_high: float
    vibration: float
    error: float
    reward: float
    effort: float
    failed: float
    roughness: float | None
    rms: float | None = None


def controllers() -> Iterator[LearningRow]:
    """Yield the rows of controllers without learning, with the rewards of the recipes."""
    for id, names in CONTROLLERS.items():
        for name in names:
            for where, environment in variants(Configuration(id, {"task": TASK})).items():
                yield _row("controller", f"{name}, {id}", None, where, {}, find_agent(name), environment)


def tasks() -> Iterator[LearningRow]:
    """Yield the rows of a PD, a model-based controller and the shipped policies in scenarios of other tasks."""
    for scenario, (learned, law) in TASKS.items():
        for name in ("pd", law, *([learned] if learned in POLICIES else [])):
            yield _row(
                "task", f"{name}, {scenario}", None, AS_TRAINED, {}, find_agent(name), Configuration.find(scenario)
            )


def runs(case: LearningCase, folder: Path, workers: Workers | int = 1) -> Iterator[LearningRow]:
    """Train the missing runs of a case in a folder, in parallel, and yield the rows of all its runs."""
    seeds = range(case.seeds)
    folders = [run_folder(case, folder, seed) for seed in seeds]
    costs = parallel_map(
        trained, [(case.settings.with_seed(seed), folders[seed]) for seed in seeds], workers, prepare=compile_kernels
    )
    for seed, each, cost in zip(seeds, folders, costs, strict=True):
        policy = find_agent(str(each))
        assert policy.environment is not None
        scenario = Configuration.find(EVALUATED_IN[case.name]) if case.name in EVALUATED_IN else policy.environment
        for where, environment in variants(split_interface(scenario)[0]).items():
            if case.kind == "recipe" or where == AS_TRAINED:
                yield _row(case.kind, case.name, seed, where, cost, policy, environment)


def run_folder(case: LearningCase, folder: Path, seed: int) -> Path:
    """Return the folder of a training run."""
    return folder / case.kind / case.name / f"seed-{seed}"


def trained(cell: tuple[Settings, Path]) -> dict[str, float | None]:
    """Train a run if its folder has no result yet, and return the cost of the training."""
    settings, folder = cell
    path = folder / COST
    if not path.is_file():
        if folder.exists():
            shutil.rmtree(folder)  # interrupted run: its total cost is unknown
        with Stopwatch(FlexManVectorEnv, "step") as stepping:
            started = time.process_time()
            train(settings, folder, progress=False)
            cpu = time.process_time() - started
        cost = {"steps": settings.steps, "cpu": cpu, "rate": settings.steps / cpu, "share": stepping.cpu / cpu or None}
        path.write_text(json.dumps(cost, indent=1) + "\n", encoding="utf-8")
    return dict(json.loads(path.read_text(encoding="utf-8")))


def variants(environment: Configuration) -> dict[str, Configuration]:
    """Return the environment as trained, with a finer model, and with longer episodes."""
    named = NAMED_ENVIRONMENTS[environment.id]
    step = default_step(environment.control_period, named.longest_step) / FINER_STEPS
    finer = [f"elements={FINER_ELEMENTS}", "modes=null", "stiffening=true", f"step={step!r}"]
    return {
        AS_TRAINED: environment,
        FINER: environment.changed(finer),
        LONGER: environment.changed([f"horizon={LONG}"]),
    }


def _row(
    kind: str,
    name: str,
    seed: int | None,
    where: str,
    costs: dict[str, float | None],
    who: AgentSpec,
    environment: Configuration,
) -> LearningRow:
    records = rollout(who, environment, TEST_SEEDS).records
    result = {name: metric.evaluate(records) for name, metric in METRICS.items()}
    time, low, high = METRICS["settling_time"].interval(records)
    known: dict[str, Any] = {key: costs.get(key) for key in ("steps", "cpu", "rate", "share")}
    return LearningRow(
        **known,
        kind=kind,
        name=name,
        seed=seed,
        where=where,
        time=time,
        time_low=low,
        time_high=high,
        vibration=result["vibration"],
        error=result["error"],
        rms=result["rms_error"],
        **{key: result[key] for key in ("settled", "reward", "effort", "failed", "roughness")},
    )

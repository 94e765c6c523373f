"""Learning study: cases, training runs with their scores, learning curves."""

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
from flexman_gym.draw.learning_curves import draw_learning_curves, read_progress
from flexman_gym.envs.config.configuration import Configuration
from flexman_gym.envs.config.named_environments import NAMED_ENVIRONMENTS
from flexman_gym.envs.vector_env import FlexManVectorEnv, compile_kernels
from flexman_gym.evaluation.agent import AgentSpec, find_agent, split_interface
from flexman_gym.evaluation.metrics import METRICS
from flexman_gym.evaluation.policy_files import POLICIES
from flexman_gym.evaluation.rollout import TEST_SEEDS, rollout
from flexman_gym.simulation.integrator import default_step
from studies.stopwatch import Stopwatch

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
class _Without:
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
            environment=whole.environment.replace(**self.environment),
            hyperparameters={**whole.hyperparameters, **self.hyperparameters},
            schedules={name: schedule for name, schedule in schedules.items() if schedule is not None},
            steps=self.steps or whole.steps,
        )


ABLATIONS = {
    "hold": _Without(
        "the held action",
        "a new action in every control period; discount and lambda the same for a second, steps for the same CPU time",
        {"action_repeat": 1},
        {"n_steps": 60, "gamma": 0.99, "gae_lambda": 0.98},
        steps=1_600_000,
    ),
    "rate": _Without(
        "the schedule of the learning rate", "the rate of the start throughout",
        schedules={"learning_rate": {"start": 0.001, "end": 0.001}},
    ),
    "reward": _Without("the reward with slope at every scale", "the reward of bells", {"task": {"kind": "slew"}}),
    "discount": _Without("the short horizon", "a discount of 0.99 an action", hyperparameters={"gamma": 0.99}),
}  # fmt: skip


@dataclass(frozen=True)
class LearningCase:
    """Runs of one kind: "recipe" or "ablation", name, settings, and how many seeds."""

    kind: str
    name: str
    settings: Settings
    seeds: int


def cases() -> list[LearningCase]:
    """All of them, the recipes first."""
    recipes = [LearningCase("recipe", name, find_recipe(name), count) for name, count in SEEDS.items()]
    whole = find_recipe(ABLATED)
    return recipes + [
        LearningCase("ablation", name, without.settings(whole), ABLATION_SEEDS) for name, without in ABLATIONS.items()
    ]


COLUMN = "rollout/ep_rew_mean"  # what every run has, judged on the way or not
POINTS = 50  # of the curve of a run, evenly over its steps


@dataclass(frozen=True)
class Point:
    """Mean reward of the newest training episodes of a run after so many steps."""

    name: str
    seed: float
    steps: float
    reward: float


def points(name: str, seed: int, folder: Path) -> Iterator[Point]:
    """The curve of a run in a folder, thinned."""
    steps, rewards, _ = read_progress(folder, COLUMN)
    for each in np.linspace(steps[0], steps[-1], POINTS):
        yield Point(name, seed, float(each), float(np.interp(each, steps, rewards)))


def environment(name: str) -> str:
    """The id of the environment in which a recipe learns."""
    return str(find_recipe(name).environment.id)


def adds_to_pd(name: str) -> bool:
    """Return whether a recipe has a PD as base controller."""
    return bool(find_recipe(name).environment.base == "pd")


def pictures(curves: Sequence[Point], folder: Path) -> list[Path]:
    """Draw learning_ID.png for each environment with recipes that add to a PD, whose rewards are of one kind."""
    names = [name for name in SEEDS if any(point.name == name for point in curves) and adds_to_pd(name)]
    result = []
    for id in dict.fromkeys(environment(name) for name in names):
        runs = {name: _seeds(curves, name) for name in names if environment(name) == id}
        result.append(draw_learning_curves(runs, folder / f"learning_{id}.png", "reward of a training episode"))
    return result


def _seeds(curves: Sequence[Point], name: str) -> list[tuple[np.ndarray, np.ndarray]]:
    own = [point for point in curves if point.name == name]
    found = sorted({point.seed for point in own})
    each = [[(point.steps, point.reward) for point in own if point.seed == seed] for seed in found]
    return [(np.array(run)[:, 0], np.array(run)[:, 1]) for run in each]


COST = "cost.json"
TASK = {"kind": "slew", "reward": "distance"}  # of the recipes
AS_TRAINED, FINER, LONGER = "as trained", "finer model", "longer episodes"
LONG = 30.0  # s, of the longer episodes
FINER_ELEMENTS, FINER_STEPS = 3, 4  # elements a link, and steps where the default takes one


@dataclass(frozen=True)
class LearningRow:
    """Medians and shares of a policy over the test episodes, and what its training cost.

    Attributes:
        kind: "recipe", "ablation", "controller" or, for venues of other tasks, "task".
        name, seed: of the run.
        where: the environment, as trained or another.
        steps, cpu, rate, share: of the training: actions, s, actions a second of CPU, part of it in the environment.
        settled: share of episodes within the band to the end.
        time, vibration, error: medians, s, m and m, and the interval of the time.
        reward, effort, failed, roughness: means; the last is None in rows of before it was taken, as is the next.
        rms: median of the RMS error, m.
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
    """Rows of the controllers that learn nothing, rewarded as the recipes are."""
    for id, names in CONTROLLERS.items():
        for name in names:
            for where, environment in places(Configuration(id, {"task": TASK})).items():
                yield _row("controller", f"{name}, {id}", None, where, {}, find_agent(name), environment)


def tasks() -> Iterator[LearningRow]:
    """Rows of a PD, of controllers that know a model and of shipped policies in venues of other tasks."""
    for venue, (learned, law) in TASKS.items():
        for name in ("pd", law, *([learned] if learned in POLICIES else [])):
            yield _row("task", f"{name}, {venue}", None, AS_TRAINED, {}, find_agent(name), Configuration.find(venue))


def runs(case: LearningCase, folder: Path, workers: Workers | int = 1) -> Iterator[LearningRow]:
    """Rows of the runs of a case, which are trained in the folder if they are not there, and by whom `grid` says."""
    seeds = range(case.seeds)
    folders = [place(case, folder, seed) for seed in seeds]
    costs = parallel_map(
        trained, [(case.settings.with_seed(seed), folders[seed]) for seed in seeds], workers, prepare=compile_kernels
    )
    for seed, each, cost in zip(seeds, folders, costs, strict=True):
        policy = find_agent(str(each))
        assert policy.environment is not None
        played = Configuration.find(VENUES[case.name]) if case.name in VENUES else policy.environment
        for where, environment in places(split_interface(played)[0]).items():
            if case.kind == "recipe" or where == AS_TRAINED:
                yield _row(case.kind, case.name, seed, where, cost, policy, environment)


def place(case: LearningCase, folder: Path, seed: int) -> Path:
    """The folder of a run of a case, in that of all runs."""
    return folder / case.kind / case.name / f"seed-{seed}"


def trained(cell: tuple[Settings, Path]) -> dict[str, float | None]:
    """Train a run and keeps what it cost in its folder, or reads the cost of one that is there."""
    settings, folder = cell
    path = folder / COST
    if not path.is_file():
        if folder.exists():
            shutil.rmtree(folder)  # of a run that was killed, whose whole cost nobody knows
        with Stopwatch(FlexManVectorEnv, "step") as stepping:
            started = time.process_time()
            train(settings, folder, progress=False)
            cpu = time.process_time() - started
        cost = {"steps": settings.steps, "cpu": cpu, "rate": settings.steps / cpu, "share": stepping.cpu / cpu or None}
        path.write_text(json.dumps(cost, indent=1) + "\n", encoding="utf-8")
    return dict(json.loads(path.read_text(encoding="utf-8")))


def places(environment: Configuration) -> dict[str, Configuration]:
    """The environment as it is, with a finer model, and with longer episodes."""
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

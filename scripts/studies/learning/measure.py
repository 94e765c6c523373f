"""Learning, measure: trains the runs of a case, unless they are there, and judges them on the test episodes."""

import json
import shutil
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from flexman_agents.settings import Settings
from flexman_agents.training import train
from flexman_gym.envs.catalog import NAMED
from flexman_gym.envs.description import Description
from flexman_gym.envs.vector_env import FlexManVectorEnv
from flexman_gym.evaluation.entrants import Entrant, find_entrant, parted
from flexman_gym.evaluation.figures import FIGURES
from flexman_gym.evaluation.grid import Workers, gathered
from flexman_gym.evaluation.rollout import rollout
from flexman_gym.evaluation.seeds import TEST
from flexman_gym.evaluation.shipped import POLICIES
from flexman_gym.simulation.run import default_step
from studies.learning.cases import CONTROLLERS, TASKS, VENUES, Case
from studies.watch import Watch

COST = "cost.json"
TASK = {"kind": "slew", "reward": "distance"}  # of the recipes
AS_TRAINED, FINER, LONGER = "as trained", "finer model", "longer episodes"
LONG = 30.0  # s, of the longer episodes
FINER_ELEMENTS, FINER_STEPS = 3, 4  # elements a link, and steps where the default takes one


@dataclass(frozen=True)
class Row:
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


def controllers() -> Iterator[Row]:
    """Rows of the controllers that learn nothing, rewarded as the recipes are."""
    for id, names in CONTROLLERS.items():
        for name in names:
            for where, environment in places(Description(id, {"task": TASK})).items():
                yield _row("controller", f"{name}, {id}", None, where, {}, find_entrant(name), environment)


def tasks() -> Iterator[Row]:
    """Rows of a PD, of controllers that know a model and of shipped policies in venues of other tasks."""
    for venue, (learned, law) in TASKS.items():
        for name in ("pd", law, *([learned] if learned in POLICIES else [])):
            yield _row("task", f"{name}, {venue}", None, AS_TRAINED, {}, find_entrant(name), Description.find(venue))


def runs(case: Case, folder: Path, workers: Workers | int = 1) -> Iterator[Row]:
    """Rows of the runs of a case, which are trained in the folder if they are not there, and by whom `grid` says."""
    seeds = range(case.seeds)
    folders = [place(case, folder, seed) for seed in seeds]
    costs = gathered(trained, [(case.settings.with_seed(seed), folders[seed]) for seed in seeds], workers)
    for seed, each, cost in zip(seeds, folders, costs, strict=True):
        policy = find_entrant(str(each))
        assert policy.environment is not None
        played = Description.find(VENUES[case.name]) if case.name in VENUES else policy.environment
        for where, environment in places(parted(played)[0]).items():
            if case.kind == "recipe" or where == AS_TRAINED:
                yield _row(case.kind, case.name, seed, where, cost, policy, environment)


def place(case: Case, folder: Path, seed: int) -> Path:
    """The folder of a run of a case, in that of all runs."""
    return folder / case.kind / case.name / f"seed-{seed}"


def trained(cell: tuple[Settings, Path]) -> dict[str, float | None]:
    """Trains a run and keeps what it cost in its folder, or reads the cost of one that is there."""
    settings, folder = cell
    path = folder / COST
    if not path.is_file():
        if folder.exists():
            shutil.rmtree(folder)  # of a run that was killed, whose whole cost nobody knows
        with Watch(FlexManVectorEnv, "step") as stepping:
            started = time.process_time()
            train(settings, folder, progress=False)
            cpu = time.process_time() - started
        cost = {"steps": settings.steps, "cpu": cpu, "rate": settings.steps / cpu, "share": stepping.cpu / cpu or None}
        path.write_text(json.dumps(cost, indent=1) + "\n", encoding="utf-8")
    return dict(json.loads(path.read_text(encoding="utf-8")))


def places(environment: Description) -> dict[str, Description]:
    """The environment as it is, with a finer model, and with longer episodes."""
    named = NAMED[environment.id]
    step = default_step(environment.setup().control_period, named.longest_step) / FINER_STEPS
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
    who: Entrant,
    environment: Description,
) -> Row:
    records = rollout(who, environment, TEST).records
    result = {name: figure.sum_up(records) for name, figure in FIGURES.items()}
    time, low, high = FIGURES["settling_time"].interval(records)
    known: dict[str, Any] = {key: costs.get(key) for key in ("steps", "cpu", "rate", "share")}
    return Row(
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

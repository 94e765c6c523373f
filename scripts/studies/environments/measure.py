"""Measurements of the named environments: errors of the default model, metrics and pictures of the baselines."""

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import gymnasium as gym
import numpy as np

from flexman_gym.common.arrays import Array
from flexman_gym.common.plot_style import BLUE, RED, SLATE, save_figure
from flexman_gym.envs.config.configuration import Configuration
from flexman_gym.envs.config.named_environments import NAMED_ENVIRONMENTS
from flexman_gym.envs.foundation import find_foundation
from flexman_gym.evaluation.metrics import METRICS
from flexman_gym.evaluation.rollouts import TEST_SEEDS, Rollout, rollout
from flexman_gym.kernels import layout
from flexman_gym.model.model import Model, build_model
from flexman_gym.simulation.batch import Batch
from flexman_gym.toolbox.view.comparison import side_by_side, suggested_gain
from flexman_gym.toolbox.view.video import write_video
from studies.charts import new_chart

MOTIONS, DURATION, HELD, SPREAD, PART = 8, 1.0, 0.2, 0.5, 0.5  # s, s, rad, share of the torque limits
FINER = 8  # ratio of the numbers of steps


class Accuracy(NamedTuple):
    """Tip errors (m) of the default model in each motion (MOTIONS,), with respect to finer steps and to a finer model.

    The finer model has all coordinates of the elements, foreshortening, and the finer steps. `cost` is the CPU time of
    a step of the finer model relative to the same step of the default model.
    """

    steps: Array
    model: Array
    cost: float


def accuracy(name: str, **arguments: Any) -> Accuracy:
    """Simulate random torques from rest with the default and finer models; `arguments` are keywords of `gym.make`."""
    env = gym.make(name, **arguments).unwrapped
    setup, model, period = env.configuration, env.simulator.model, env.simulator.control_period  # type: ignore[attr-defined]
    method, substeps = env.simulator.method, env.simulator.substeps  # type: ignore[attr-defined]
    finest = build_model(setup.arm, **(vars(model.choice) | {"modes": None, "stiffening": True}))
    random, periods = np.random.default_rng(0), round(DURATION / period)
    postures = random.uniform(-SPREAD, SPREAD, (MOTIONS, model.n_joints))
    postures[:, [joint.passive and joint.stiffness is not None for joint in setup.arm.joints]] = 0.0  # at rest
    levels = random.uniform(-PART, PART, (round(DURATION / HELD), MOTIONS, model.n_joints)) * setup.torque_limit
    drives = np.zeros((MOTIONS, periods, model.n_joints + 6))
    drives[:, :, : model.n_joints] = np.repeat(levels, round(HELD / period), axis=0)[:periods].swapaxes(0, 1)

    def tips(of: Model, parts: int) -> tuple[Array, float]:
        batch = Batch(of, method, period / parts, period, arms=MOTIONS)
        batch.reset(np.arange(MOTIONS), of.at_rest(postures))
        batch.roll(drives[:, :1])  # loads what is compiled
        batch.reset(np.arange(MOTIONS), of.at_rest(postures))
        started = time.process_time()
        outputs = batch.roll(drives)[1]
        return outputs[:, :, layout.TIP], time.process_time() - started

    ours, (finer, quick), (finest_tips, slow) = (
        tips(model, substeps)[0], tips(model, FINER * substeps), tips(finest, FINER * substeps),
    )  # fmt: skip
    by_steps, by_model = (np.linalg.norm(each - ours, axis=-1).max(axis=1) for each in (finer, finest_tips))
    return Accuracy(by_steps, by_model, slow / quick)


BASELINES = {"no torque": "zero", "PD": "pd", "tracking LQR": "lqr-tracking"}
"""Name of a baseline on the pages -> agent. The tracking LQR is given the parameters and the state of the arm."""


SHAPED, ADAPTIVE = "PD with input shaper", "adaptive LQR"
"""Names of the agents pd-shaped and adaptive-lqr, baselines of environments with a hanging load."""
AGENTS = {"PD": "pd", SHAPED: "pd-shaped", ADAPTIVE: "adaptive-lqr"}  # baselines under CONDITIONS
CONDITIONS = {  # environment with a hanging load -> conditions of its table
    "FlexGantry-v0": ("payload", "unknown", "short-rope", "long-rope"),
    "FlexCrane-v0": ("payload", "unknown"),
}
SPEED = {  # speed of the GIF of an environment relative to the motion; 1 for other environments
    "FlexOne-v0": 0.5, "FlexPlanar-v0": 0.25, "FlexQuanser-v0": 0.25, "FlexRotary-v0": 0.2, "FlexGantry-v0": 2.4,
    "FlexTwoMass-v0": 4.0,  # its disturbance begins after 14 s
}  # fmt: skip


def travels(name: str) -> bool:
    """Return True for an environment whose foundation the agent commands."""
    return (NAMED_ENVIRONMENTS[name].foundation or {}).get("kind") == "travel"


def baselines_of(name: str) -> dict[str, str]:
    """Return the baselines of an environment, name -> agent; the tracking LQR needs a motor."""
    passive = [joint.passive for joint in NAMED_ENVIRONMENTS[name].arm.joints]
    found = {each: agent for each, agent in BASELINES.items() if not all(passive) or each != "tracking LQR"}
    return found | {SHAPED: "pd-shaped"} if any(passive) else found


LONG, LONG_NAME = 30.0, "PD, episodes of 30 s"  # s; horizon in which the PD of FlexRRR-v0 settles; name of its row
SEEDS = TEST_SEEDS
SIZE, RATE, SECONDS, HOLD = (480, 360), 8.0, 5.0, 2.0  # pixels, 1/s, s, s
LEAST = 0.01  # mm; smaller tip errors are drawn at this value of the logarithmic axis


@dataclass(frozen=True)
class Baseline:
    """Metrics of a baseline over episodes: medians (s, m) and shares; see `evaluation.metrics.METRICS`."""

    environment: str
    baseline: str
    settled: float
    settling_time: float
    vibration: float
    rms_error: float
    failed: float
    episodes: float


@dataclass(frozen=True)
class ModelError:
    """Largest tip errors (m) of the default model: median and maximum over the motions, see `Accuracy`."""

    environment: str
    steps_median: float
    steps_largest: float
    model_median: float
    model_largest: float
    cost: float


def run(name: str, agent: str, horizon: float | None = None, seeds: Sequence[int] = SEEDS) -> Rollout:
    """Run one episode of an agent per seed.

    Args:
        name: environment.
        agent: name of the agent.
        horizon: duration of the episodes, s; None for that of the environment.
        seeds: seeds of the episodes.
    """
    environment = Configuration.find(name)
    return rollout(agent, environment.replace(horizon=horizon) if horizon else environment, seeds)


def baseline_rows(name: str, runs: Mapping[str, Rollout]) -> list[Baseline]:
    """Return the metrics of the baselines, by their names, in an environment."""
    shown = ("settled", "settling_time", "vibration", "rms_error", "failed")
    return [
        Baseline(
            name,
            baseline,
            **{metric: METRICS[metric].evaluate(each.records) for metric in shown},
            episodes=len(each.records),
        )
        for baseline, each in runs.items()
    ]


def condition_agents(name: str) -> dict[str, str]:
    """Return the baselines of an environment under CONDITIONS, name -> agent; the adaptive LQR needs a motor."""
    return {baseline: agent for baseline, agent in AGENTS.items() if not travels(name) or baseline != ADAPTIVE}


def condition_rows(name: str) -> list[Baseline]:
    """Return the metrics of the baselines with a controller under CONDITIONS; [] for an environment without."""
    agents = condition_agents(name)
    return [
        row
        for condition in CONDITIONS.get(name, ())
        for row in baseline_rows(
            f"{name}/{condition}", {each: run(f"{name}/{condition}", agent) for each, agent in agents.items()}
        )
    ]


def model_error(name: str) -> ModelError:
    """Return the errors of the default model of an environment."""
    each = accuracy(name)
    steps, model = ((float(np.median(errors)), float(errors.max())) for errors in (each.steps, each.model))
    return ModelError(name, *steps, *model, each.cost)


def draw(runs: Mapping[str, Rollout], path: Path) -> None:
    """Plot tip error and commands of an episode of each baseline, and record the best two with a controller as a GIF.

    The commands are the largest torque relative to its limit or, of a moving foundation, its speed relative to the
    largest.
    """
    shown = [baseline for baseline in ("PD", "tracking LQR", SHAPED) if baseline in runs][:2]
    pair = [runs[baseline].episode(0) for baseline in shown]
    travel = find_foundation(NAMED_ENVIRONMENTS[path.name].foundation) if travels(path.name) else None
    speed = SPEED.get(path.name, 1.0)
    frames = side_by_side(pair, SIZE, RATE / speed, SECONDS * speed, HOLD * speed, suggested_gain(pair))
    write_video(frames, path.with_suffix(".gif"), RATE)
    figure, ((left, right),) = new_chart((7.6, 2.7), columns=2)
    for baseline, colour in zip(("no torque", *shown), (SLATE, BLUE, RED), strict=False):
        episode = runs[baseline].episode(0)
        left.semilogy(episode.time, np.maximum(1e3 * episode.errors, LEAST), color=colour, label=baseline)
        if baseline != "no torque":
            used = np.abs(episode.actions).max(axis=1)
            if travel is not None:
                used = np.abs(episode.readings["travel_rate"][1:, 0]) / travel.speed
            right.plot(episode.time[1:], used, color=colour, label=baseline)
    left.set(xlabel="time (s)", ylabel="tip error (mm)")
    limited = "torque" if travel is None else "speed"
    right.axhline(1.0, color=SLATE, linestyle="--", label=f"{limited} limit")
    label = "largest torque / its limit" if travel is None else "speed of the portal / its limit"
    right.set(xlabel="time (s)", ylabel=label, ylim=(0.0, 1.05))
    for axes in (left, right):
        axes.legend(
            frameon=False,
            fontsize=8,
            ncols=3,
            handlelength=1.2,
            columnspacing=1.0,
            loc="lower left",
            bbox_to_anchor=(0.0, 1.0),
        )
    save_figure(figure, path.with_suffix(".svg"))

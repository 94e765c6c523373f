"""Measurements of the named environments: accuracy of the default model, baselines, first training."""

import time
from pathlib import Path
from typing import Any, NamedTuple

import gymnasium as gym
import numpy as np

from flexman_gym.common import files
from flexman_gym.common.arrays import Array
from flexman_gym.common.markdown import markdown_table
from flexman_gym.common.plot_style import BLUE, LIGHT, MIDDLE, ORANGE, RED, new_figure
from flexman_gym.draw.video import side_by_side, write_video
from flexman_gym.envs.config.named_environments import NAMED_ENVIRONMENTS
from flexman_gym.envs.tasks import Slew
from flexman_gym.evaluation.rollout import TEST_SEEDS, Rollout, rollout
from flexman_gym.kernels import layout
from flexman_gym.model.model import Model, build_model
from flexman_gym.simulation.batch import Batch

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


BASES = {
    None: "no torque",
    "pd": "PD",
    "lqr-tracking": "tracking LQR",
}  # the tracking LQR is given the arm's parameters and state
SEEDS = TEST_SEEDS[:20]
SIZE, BROADER, LEAST = (280, 210), 1.5, 1e-5


def run(name: str, base: str | None) -> Rollout:
    """Run one episode of a baseline per seed."""
    return rollout(base or "zero", name, SEEDS)


def draw(runs: dict[str | None, Rollout], path: Path) -> None:
    """Plot tip error and torques of an episode under each baseline, and record the tracking LQR as a GIF."""
    frames, rate = side_by_side([runs["lqr-tracking"].episode(0)], small=True, size=SIZE)
    write_video(frames, path.with_suffix(".gif"), rate)
    figure = new_figure((11.0, 2.9), 110.0, layout="constrained")
    left, right = figure.subplots(1, 2)
    looks = {None: (MIDDLE, "-"), "pd": (BLUE, "-"), "lqr-tracking": (RED, "-")}
    for base, each in runs.items():
        colour, style = looks[base]
        episode = each.episode(0)
        times, errors = episode.time, 1e3 * np.maximum(episode.errors, LEAST)
        left.semilogy(times, errors, style, color=colour, label=BASES[base])
        if base is not None:
            torques = np.abs(episode.actions).max(axis=1)
            right.plot(times[1:], torques, style, color=colour, linewidth=BROADER, label=BASES[base])
    left.set(xlabel="time (s)", ylabel="tip error (mm)")
    right.set(xlabel="time (s)", ylabel="largest torque / its limit", ylim=(0.0, 1.05))
    right.axhline(1.0, color=ORANGE, linewidth=0.8)
    for axes in (left, right):
        axes.grid(color=LIGHT, linewidth=0.6)
        axes.spines[["top", "right"]].set_visible(False)
        axes.legend(frameon=False, fontsize=9, ncols=3, loc="lower left", bbox_to_anchor=(0.0, 1.0))
    figure.savefig(path)


ROOT = Path(__file__).parents[3]
RECIPES, DOCS = ROOT / "agents" / "recipes", ROOT / "docs"
RECIPE = {
    "FlexRRR-v0": "ppo_on_pd", "FlexRRR-Track-v0": "track_ppo_on_pd", "FlexRRR-Hold-v0": "hold_ppo_on_pd",
    "FlexRRR-Gravity-v0": "gravity_ppo_on_pd", "FlexPlanar-v0": "planar_ppo_on_pd",
    "FlexPlanar-Track-v0": "planar_track_ppo_on_pd", "FlexPlanar-Hold-v0": "planar_hold_ppo_on_pd",
}  # fmt: skip
"""Environment -> its recipe."""
LASTS, GAMMA, ARMS = (
    0.1,
    0.95,
    256,
)  # action duration without a recipe, s; discount factor and number of arms of all recipes


def first(name: str) -> list[str]:
    """Return a table of recommended settings for training, with reasons and example code, as Markdown lines."""
    named = NAMED_ENVIRONMENTS[name]
    recipe = RECIPE.get(name)
    given = files.read_data(RECIPES / f"{recipe}.yaml")["environment"] if recipe else {}
    hold = given.get("action_repeat", round(LASTS / named.control_period))
    seconds = hold * named.control_period
    settings = {"base": "pd", "action_repeat": hold, "sensors": ("full", "fine")}
    rows = [
        ("`base`", '`"pd"`', "the agent adds to a controller that moves the arm close to its goal"),
        ("`action_repeat`", f"`{hold}`", f"an action lasts {seconds:g} s, so that exploration excites less vibration"),
        ("`sensors`", '`("full", "fine")`', "the state, and the state scaled to millimetres"),
    ]
    if isinstance(named.task, Slew):
        settings["task"] = {"kind": "slew", "reward": "distance", **_drawn(named.task)}
        rows.append(("`task`", '`"reward": "distance"`', "a gradient at every scale, from metres to millimetres"))
    horizon = seconds / (1.0 - GAMMA)
    rows += [
        ("discount of PPO or SAC", f"`{GAMMA}`", f"a horizon of {horizon:g} s, about the duration of a motion"),
        (
            "`log_std_init`",
            "`-1.6`, or `-1.3` decreasing to `-3.5`",
            "little exploration noise, since strong vibration prevents learning",
        ),
        ("number of arms", f"`{ARMS}`", "a batch costs little more than one arm"),
    ]
    known = "There is no recipe for this environment; the recipes of [learning.md](../learning.md) have these settings."
    if recipe:
        known = f"The recipe `{recipe}` has these settings; "
        known += "[learning.md](../learning.md) has its results."
    words = "".join(f"    {key}={value!r},\n" for key, value in settings.items()).replace("'", '"').splitlines()
    made = [f'arms = gym.make_vec("{name}", {ARMS}, "vector_entry_point", autoreset_mode="SameStep",', *words, ")"]
    return [
        *markdown_table(("setting", "value", "reason"), rows), "", "```python", *made, "```", "",
        f"{known} The README trains on such arms in a few lines of Stable-Baselines3.",
        *(["", *_curve(name)] if (DOCS / f"learning_{name}.png").is_file() else []),
    ]  # fmt: skip


def _curve(name: str) -> list[str]:
    """Return the learning curves of the recipes of an environment as Markdown lines, see `studies.learning.measure`."""
    return [
        f"![Reward while the recipes of {name} train](../learning_{name}.png)", "",
        "Lines are medians over the seeds, bands the range from the worst to the best seed.",
    ]  # fmt: skip


def _drawn(task: Slew) -> dict[str, float]:
    """Return the initial conditions of a slew task that differ from the default slew."""
    plain = Slew()
    return {name: getattr(task, name) for name in ("start", "slew") if getattr(task, name) != getattr(plain, name)}

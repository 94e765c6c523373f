"""Run a demonstration: simulation, training, evaluation and plots.

It simulates the three cases of the paper, trains a policy with PPO for about 1.5 minutes on one core, and evaluates it
and four controllers on 100 episodes. The plots are written to the folder out.
"""

import argparse
import shutil
import time
from collections.abc import Mapping
from pathlib import Path

import numpy as np

import flexman_gym as fm
from flexman_agents.settings import find_recipe
from flexman_agents.training import train
from flexman_gym import draw
from flexman_gym.commands import CommandLine
from flexman_gym.commands.paper import simulate_cases
from flexman_gym.evaluation.agents import common_environment, find_agent
from flexman_gym.evaluation.rollouts import TEST_SEEDS, rollout
from flexman_gym.evaluation.tables import metrics_table
from flexman_gym.kernels.first_use import compile_when_needed
from flexman_gym.model.model import scene_model
from flexman_gym.toolbox.view.trajectories import draw_episodes

OUTPUT_FOLDER = Path("out")
RECIPE = "ppo_on_pd_minute"


def _arguments(parser: argparse.ArgumentParser) -> None:
    """Add no arguments."""


def _run(options: argparse.Namespace) -> int:
    """Run the demonstration; return 0."""
    started = time.perf_counter()
    compile_when_needed()  # no single arm is stepped, and the method is another: 11 s less work
    print("1. The paper's scene: 2 s under 400 N m at each joint, by the adaptive reference method.")
    _draw_cases(simulate_cases())
    print(f"2. Training: the recipe {RECIPE}, PPO on a PD controller of the motors.")
    shutil.rmtree(OUTPUT_FOLDER / "ppo", ignore_errors=True)
    train(find_recipe(RECIPE), OUTPUT_FOLDER / "ppo")
    print(f"3. Evaluation: {len(TEST_SEEDS)} test episodes of FlexRRR-v0, the same for all agents.")
    _compare()
    print(f"Done in {time.perf_counter() - started:.0f} s.")
    return 0


def _draw_cases(trajectories: Mapping[str, fm.Trajectory]) -> None:
    """Draw Figures 6 to 11, and the arm at the time of the largest deflection of its flexible links."""
    rigid, trajectory, flexible_both = trajectories.values()
    paths = draw.paper_figures(rigid, trajectory, flexible_both, OUTPUT_FOLDER)
    model = scene_model(fm.catalog.paper_scene("fr"))
    row = np.linalg.norm(trajectory.deflection, axis=1).argmax()
    draw.write_picture(draw.arm_frame(model, trajectory.states[row], size=(960, 720)), OUTPUT_FOLDER / "arm.png")
    print(f"   Figures 6 to 11 are in {OUTPUT_FOLDER}/, together in {paths[-1]}.")
    print(f"   {OUTPUT_FOLDER}/arm.png shows the arm at {trajectory.time[row]:.2f} s, at its largest deflection.")


def _compare() -> None:
    """Evaluate all agents, print their metrics, and draw the first test episode of each agent."""
    agents = {"PPO on PD": find_agent(str(OUTPUT_FOLDER / "ppo"))}
    agents |= {name: find_agent(name) for name in ("lqr-tracking", "lqr", "pd", "zero")}
    environment = common_environment(list(agents.values()), None)
    records = {name: rollout(each, environment, TEST_SEEDS).records for name, each in agents.items()}
    print(metrics_table(records, environment))
    draw_episodes({name: each[0] for name, each in records.items()}, OUTPUT_FOLDER / "episode.png")
    print(f"   {OUTPUT_FOLDER}/episode.png shows the first episode: tip error over time, and the torques.")


EXAMPLES = ("flexman demo  # ten minutes; plots in the folder out",)
COMMAND = CommandLine(_arguments, _run, EXAMPLES)

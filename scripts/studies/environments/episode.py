"""Episode: what baselines do on a named environment, and pictures of one episode."""

from pathlib import Path

import numpy as np

from flexman_gym.draw.side import side_by_side
from flexman_gym.draw.style import BLUE, LIGHT, MIDDLE, ORANGE, RED, new_figure
from flexman_gym.draw.video import write_video
from flexman_gym.evaluation.rollout import Rollout, rollout
from flexman_gym.evaluation.seeds import TEST

BASES = {None: "no torque", "pd": "PD", "lqr-tracking": "tracking LQR"}  # the latter knows the arm and its state
SEEDS = TEST[:20]
SIZE, BROADER, LEAST = (280, 210), 1.5, 1e-5


def run(name: str, base: str | None) -> Rollout:
    """Run an episode of a baseline from each of the seeds."""
    return rollout(base or "zero", name, SEEDS)


def draw(runs: dict[str | None, Rollout], path: Path) -> None:
    """Draws tip error and torques of an episode under each baseline, and films it under the tracking LQR (GIF)."""
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

"""Episode: what baselines do on a named environment, and a picture of one episode."""

from dataclasses import dataclass
from pathlib import Path

import gymnasium as gym
import numpy as np

from flexman_gym.arrays import Array
from flexman_gym.draw.frames import FramePainter
from flexman_gym.draw.style import BLUE, LIGHT, MIDDLE, ORANGE, RED, new_figure
from flexman_gym.envs.episodes import Episodes
from flexman_gym.evaluation import rollout
from flexman_gym.metrics import rms
from flexman_gym.model.curves import curves

BASES = {None: "no torque", "pd": "PD", "lqr-tracking": "tracking LQR"}  # the latter knows the arm and its state
SEEDS = tuple(range(9000, 9008))
FRAMES, SIZE, BROADER, LEAST = 3, (420, 420), 1.5, 1e-5


@dataclass(frozen=True, eq=False)
class Run:
    """Episodes of one baseline: errors (T + 1, b) m, nan after an end; those of the first one also as below.

    states: (T + 1, 2 d). targets: (T + 1, 3) m. actions: (T, n) parts of the torque limits. failed: part of the
    episodes that ended early.
    """

    errors: Array
    states: Array
    targets: Array
    actions: Array
    failed: float

    @property
    def rms_error(self) -> float:
        """Root mean square of the tip error (m) over all control periods of all episodes."""
        return float(rms(self.errors[np.isfinite(self.errors)]))


def run(name: str, base: str | None) -> Run:
    """Runs an episode from each of the seeds."""
    states, targets = [], []

    def watch(episodes: Episodes) -> None:
        """Keeps what the first arm does."""
        states.append(episodes.view.state[0].copy())
        targets.append(episodes.view.target[0].copy())

    result = rollout(base or "zero", name, SEEDS, watch)
    end = result.lengths[0] + (result.failures[0] == "")  # of one that failed the last state is beyond the limits
    failed = np.array([failure != "" for failure in result.failures])
    errors = result.errors.T.copy()
    errors[result.lengths[failed], np.flatnonzero(failed)] = np.nan
    actions = result.actions[0, : end - 1]
    return Run(errors, np.array(states)[:end], np.array(targets)[:end], actions, failed=float(failed.mean()))


def draw(name: str, runs: dict[str | None, Run], path: Path) -> None:
    """Draws an episode: the arm under the tracking LQR, and tip error and torques under each baseline."""
    env = gym.make(name).unwrapped
    period, model = env.setup.control_period, env.simulator.model  # type: ignore[attr-defined]
    figure = new_figure((11.0, 6.4), 110.0, layout="constrained")
    upper, lower = figure.subfigures(2, 1, height_ratios=(1.2, 1.0))
    shown, painter = runs["lqr-tracking"], FramePainter(model, SIZE)
    rows = np.linspace(0, len(shown.states) - 1, FRAMES + 1).astype(int)[:FRAMES] + (len(shown.states) > FRAMES)
    shot = painter.shot(np.vstack([curves(model, shown.states, 4).positions.reshape(-1, 3), shown.targets]))
    pictures = [painter.paint(shown.states[row], shown.targets[row], shot=shot) for row in rows]
    for axes, row, picture in zip(upper.subplots(1, FRAMES), rows, pictures, strict=True):
        axes.imshow(picture)
        axes.set_title(f"{row * period:.1f} s, tracking LQR", fontsize=10)
        axes.set_axis_off()
    left, right = lower.subplots(1, 2)
    looks = {None: (MIDDLE, "-"), "pd": (BLUE, "-"), "lqr-tracking": (RED, "-")}
    for base, each in runs.items():
        colour, style = looks[base]
        times = period * np.arange(len(each.states))
        left.semilogy(
            times, 1e3 * np.maximum(each.errors[: len(times), 0], LEAST), style, color=colour, label=BASES[base]
        )
        if base is not None:
            torques = np.abs(each.actions).max(axis=1)
            right.plot(times[1:], torques, style, color=colour, linewidth=BROADER, label=BASES[base])
    left.set(xlabel="time (s)", ylabel="tip error (mm)")
    right.set(xlabel="time (s)", ylabel="largest torque / its limit", ylim=(0.0, 1.05))
    right.axhline(1.0, color=ORANGE, linewidth=0.8)
    for axes in (left, right):
        axes.grid(color=LIGHT, linewidth=0.6)
        axes.spines[["top", "right"]].set_visible(False)
        axes.legend(frameon=False, fontsize=9, ncols=3, loc="lower left", bbox_to_anchor=(0.0, 1.0))
    figure.savefig(path)

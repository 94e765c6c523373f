"""Episodes: one of several controllers and policies, error of the tip on a logarithmic scale, and torques."""

from collections.abc import Mapping
from pathlib import Path
from typing import Protocol

import numpy as np

from flexman_gym.arrays import Array
from flexman_gym.draw.style import BLUE, DARK, GREEN, LIGHT, MIDDLE, ORANGE, RED, SKY, new_figure

COLOURS = (BLUE, RED, ORANGE, GREEN, SKY, MIDDLE)
LEAST = 1e-5  # m, what the picture shows at least


class Recorded(Protocol):
    """What a picture needs of an episode: a Record of `evaluation`, or an Episode."""

    @property
    def errors(self) -> Array:
        """(T + 1,) m."""

    @property
    def actions(self) -> Array:
        """(T, n) parts of the torque limits."""

    @property
    def period(self) -> float:
        """Of control, s."""

    @property
    def band(self) -> float:
        """In which a tip has settled, m."""


def draw_episodes(records: Mapping[str, Recorded], path: Path) -> None:
    """Draws one episode of each policy.

    Args:
        records: name of a policy -> its episode.
        path: of the PNG file.

    Raises:
        ImportError: without Matplotlib.
    """
    first = next(iter(records.values()))
    joints, band = first.actions.shape[1], first.band
    figure = new_figure((10.0, 3.6 + 1.3 * joints), 110.0, layout="constrained")
    axes = figure.subplots(1 + joints, 1, sharex=True, height_ratios=[3.0, *[1.0] * joints])
    for (name, record), colour in zip(records.items(), COLOURS, strict=False):
        times = record.period * np.arange(len(record.errors))
        axes[0].semilogy(times, np.maximum(record.errors, LEAST), color=colour, linewidth=1.5, label=name)
        for joint in range(joints):
            axes[1 + joint].step(times[1:], record.actions[:, joint], color=colour, linewidth=1.0, where="pre")
    axes[0].axhline(band, color=DARK, linewidth=0.8, linestyle="--")
    axes[0].text(0.1, 1.15 * band, f"{1e3 * band:.3g} mm", fontsize=8, color=DARK)
    axes[0].set_ylim(bottom=LEAST)
    axes[0].set_ylabel("distance of the tip from its target (m)")
    axes[0].legend(frameon=False, ncols=6, fontsize=9, loc="lower right", bbox_to_anchor=(1.0, 1.0))
    for joint in range(joints):
        axes[1 + joint].set(ylabel=f"motor {joint + 1}", ylim=(-1.08, 1.08))
    axes[-1].set_xlabel("time (s); torques as parts of their limits")
    for each in axes:
        each.grid(color=LIGHT, linewidth=0.6)
        each.spines[["top", "right"]].set_visible(False)
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path)

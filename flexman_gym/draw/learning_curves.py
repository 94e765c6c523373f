"""Learning curves of training runs, and plots of episodes."""

import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Protocol

import numpy as np

from flexman_gym.common.arrays import Array
from flexman_gym.common.checks import short_path, value_error
from flexman_gym.common.time_series import read_csv_rows
from flexman_gym.draw.style import BLUE, DARK, GREEN, LIGHT, LINK_COLOURS, MIDDLE, ORANGE, RED, SKY, new_figure

COLOURS = (BLUE, RED, ORANGE, GREEN, SKY, MIDDLE)
MIN_ERROR = 1e-5  # m, what the picture shows at least


class _RecordedEpisode(Protocol):
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


def draw_episodes(records: Mapping[str, _RecordedEpisode], path: Path) -> None:
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
        axes[0].semilogy(times, np.maximum(record.errors, MIN_ERROR), color=colour, linewidth=1.5, label=name)
        for joint in range(joints):
            axes[1 + joint].step(times[1:], record.actions[:, joint], color=colour, linewidth=1.0, where="pre")
    axes[0].axhline(band, color=DARK, linewidth=0.8, linestyle="--")
    axes[0].text(0.1, 1.15 * band, f"{1e3 * band:.3g} mm", fontsize=8, color=DARK)
    axes[0].set_ylim(bottom=MIN_ERROR)
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


STEPS_COLUMN = "time/total_timesteps"
REWARD_COLUMNS = ("selection/reward", "rollout/ep_rew_mean")  # the first of them that a run has


def read_progress(folder: str | Path, column: str | None = None) -> tuple[Array, Array, str]:
    """Reads steps (k,) and values (k,) of a column of a run's progress*.csv, and the name of the column.

    Args:
        folder: of the run.
        column: None takes the reward on selection seeds, or else that of the training.

    Raises:
        FileNotFoundError: without such files.
        ValueError: one line, for a column that there is not.
    """
    rows: list[dict[str, str]] = []
    for path in sorted(Path(folder).glob("progress*.csv")) if os.path.isdir(folder) else ():
        lines = read_csv_rows(path)
        names = next(lines, [])
        rows += [dict(zip(names, line, strict=False)) for line in lines]
    if not rows:
        raise FileNotFoundError(f"{short_path(folder)}: no progress.csv with rows; give the folder of a training run")
    heads = [name for name in rows[0] if any(row.get(name) for row in rows)]
    name = column or next((each for each in REWARD_COLUMNS if each in heads), "")
    if name not in heads:
        raise value_error("column", name, f"one of {', '.join(sorted(heads))}")
    try:
        points = [
            (float(row[STEPS_COLUMN]), float(row[name])) for row in rows if row.get(name) and row.get(STEPS_COLUMN)
        ]
    except ValueError:
        raise ValueError(f"{short_path(folder)}: {name} is not a number in each row; give another column") from None
    steps, values = np.array(sorted(points)).reshape(-1, 2).T
    return steps, values, name


def draw_learning_curves(runs: Mapping[str, Sequence[tuple[Array, Array]]], path: str | Path, label: str) -> Path:
    """Draws the median over seeds of each recipe, and a band from the worst to the best of them.

    Args:
        runs: name -> steps (k,) and values (k,) of each seed.
        path: of the picture.
        label: of the values.

    Raises:
        ImportError: without Matplotlib.
    """
    path, figure = Path(path), new_figure((7.4, 4.6), 120.0, layout="constrained")
    axes = figure.add_subplot()
    for (name, seeds), colour in zip(runs.items(), LINK_COLOURS, strict=False):
        steps = np.unique(np.concatenate([each for each, _ in seeds]))
        inside = [np.interp(steps, *each, left=np.nan, right=np.nan) for each in seeds]
        known = np.array(inside)[:, np.isfinite(inside).all(axis=0)]
        common = steps[np.isfinite(inside).all(axis=0)]
        axes.plot(common, np.median(known, axis=0), color=colour, label=f"{name} ({len(seeds)})")
        if len(seeds) > 1:
            axes.fill_between(common, known.min(axis=0), known.max(axis=0), color=colour, alpha=0.2, linewidth=0.0)
    axes.set(xlabel="steps", ylabel=label)
    axes.ticklabel_format(axis="x", scilimits=(-3, 4), useMathText=True)
    axes.grid(color=LIGHT, linewidth=0.6)
    axes.spines[["top", "right"]].set_visible(False)
    axes.legend(frameon=False, title="recipe (seeds)", fontsize=9)
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path)
    return path

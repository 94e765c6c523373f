"""Learning: how trainings go, a line for each recipe and a band over its seeds."""

import os
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from flexman_gym.arrays import Array
from flexman_gym.checks import refusal, shown_path
from flexman_gym.draw.style import LIGHT, LINK_COLOURS, new_figure
from flexman_gym.scene.record import table_lines

STEPS = "time/total_timesteps"
CURVES = ("selection/reward", "rollout/ep_rew_mean")  # the first of them that a run has


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
        lines = table_lines(path)
        names = next(lines, [])
        rows += [dict(zip(names, line, strict=False)) for line in lines]
    if not rows:
        raise FileNotFoundError(f"{shown_path(folder)}: no progress.csv with rows; give the folder of a training run")
    heads = [name for name in rows[0] if any(row.get(name) for row in rows)]
    name = column or next((each for each in CURVES if each in heads), "")
    if name not in heads:
        raise refusal("column", name, f"one of {', '.join(sorted(heads))}")
    try:
        points = [(float(row[STEPS]), float(row[name])) for row in rows if row.get(name) and row.get(STEPS)]
    except ValueError:
        raise ValueError(f"{shown_path(folder)}: {name} is not a number in each row; give another column") from None
    steps, values = np.array(sorted(points)).reshape(-1, 2).T
    return steps, values, name


def learning_curves(runs: Mapping[str, Sequence[tuple[Array, Array]]], path: str | Path, label: str) -> Path:
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

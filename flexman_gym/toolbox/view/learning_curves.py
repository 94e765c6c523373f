"""Learning curves of training runs: reading of the progress files, and plots."""

import os
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from flexman_gym.common.arrays import Array
from flexman_gym.common.errors import short_path, suggestion, value_error
from flexman_gym.common.plot_style import LIGHT, LINK_COLOURS, new_figure, save_figure
from flexman_gym.common.tables import read_csv_rows

STEPS_COLUMN = "time/total_timesteps"  # environment steps of the training
REWARD_COLUMNS = ("selection/reward", "rollout/ep_rew_mean")  # mean return; the first one in a run is the default


def read_progress(folder: str | Path, column: str | None = None) -> tuple[Array, Array, str]:
    """Return environment steps (k,), values (k,) and name of a column of the files progress*.csv of a training run.

    Args:
        folder: folder of the run.
        column: name of the column; None for the mean return on the selection seeds or, if a run was not evaluated,
            in the training.

    Raises:
        FileNotFoundError: without files progress*.csv.
        ValueError: for an unknown column, and for entries that are no numbers.
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
        raise value_error("column", name, f"one of {', '.join(sorted(heads))}{suggestion(name, heads)}")
    try:
        points = [
            (float(row[STEPS_COLUMN]), float(row[name])) for row in rows if row.get(name) and row.get(STEPS_COLUMN)
        ]
    except ValueError:
        raise ValueError(f"{short_path(folder)}: {name} is not a number in each row; give another column") from None
    steps, values = np.array(sorted(points)).reshape(-1, 2).T
    return steps, values, name


def draw_learning_curves(runs: Mapping[str, Sequence[tuple[Array, Array]]], path: str | Path, label: str) -> Path:
    """Plot the median over seeds of each recipe, with a band from the smallest to the largest value; return the path.

    Args:
        runs: name of a recipe -> environment steps (k,) and values (k,) of each seed.
        path: path of the picture.
        label: label of the values.

    Raises:
        ImportError: without Matplotlib.
    """
    path, figure = Path(path), new_figure((7.4, 4.6), 120.0, layout="constrained")
    axes = figure.add_subplot()
    for (name, seeds), colour in zip(runs.items(), LINK_COLOURS, strict=False):
        steps = np.unique(np.concatenate([each for each, _ in seeds]))
        inside = [np.interp(steps, *each, left=np.nan, right=np.nan) for each in seeds]
        common_values = np.array(inside)[:, np.isfinite(inside).all(axis=0)]
        common = steps[np.isfinite(inside).all(axis=0)]
        axes.plot(common, np.median(common_values, axis=0), color=colour, label=f"{name} ({len(seeds)})")
        if len(seeds) > 1:
            axes.fill_between(
                common, common_values.min(axis=0), common_values.max(axis=0), color=colour, alpha=0.2, linewidth=0.0
            )
    axes.set(xlabel="steps", ylabel=label)
    axes.ticklabel_format(axis="x", scilimits=(-3, 4), useMathText=True)
    axes.grid(color=LIGHT, linewidth=0.6)
    axes.spines[["top", "right"]].set_visible(False)
    axes.legend(frameon=False, title="recipe (seeds)", fontsize=9)
    save_figure(figure, path)
    return path

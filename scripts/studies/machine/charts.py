"""Machine, charts: measured deflections of runs that were not fitted, and ours."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from flexman_gym.draw.style import BLUE, LIGHT, MIDDLE, new_figure
from studies.machine.measure import HALF

STAGE_1_PICTURE, STAGES_PICTURE = "machine_stage_1.png", "machine_stages.png"
MILLI = 1e3


def draw(lines: Mapping[str, Sequence[Any]], told: Sequence[Any], folder: Path) -> None:
    """Draws the runs of the first stage, each by the fit that did not see it, and the record of both stages."""
    rows = (len(lines) + 2) // 3
    figure = new_figure((13.0, 2.3 * rows), 100.0, layout="constrained")
    grid = figure.subplots(rows, 3, squeeze=False).ravel()
    for axes, (name, (times, measured, shown)) in zip(grid, sorted(lines.items()), strict=False):
        _compare(axes, times, MILLI * measured, MILLI * shown)
        axes.set(title=name, xlabel="time (s)", ylabel="deflection (mrad)")
    for axes in grid[len(lines) :]:
        axes.set_visible(False)
    figure.savefig(folder / STAGE_1_PICTURE)
    times, measured, shown = told
    figure = new_figure((13.0, 5.0), 100.0, layout="constrained")
    for axes, name in zip(figure.subplots(len(shown), 1), shown, strict=True):
        _compare(axes, times, MILLI * np.asarray(measured[name]), MILLI * shown[name])
        axes.axvline(HALF, color=LIGHT, linewidth=3.0)
        axes.set(title=f"{name}: fitted on the left, predicted on the right", xlabel="time (s)", ylabel="mm")
    figure.savefig(folder / STAGES_PICTURE)


def _compare(axes: Any, times: Any, measured: Any, shown: Any) -> None:
    axes.plot(times, measured, color=MIDDLE, linewidth=2.5, label="measured")
    axes.plot(times, shown, color=BLUE, linewidth=1.0, label="our model")
    axes.legend(frameon=False, fontsize=8)
    axes.spines[["top", "right"]].set_visible(False)

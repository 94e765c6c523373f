"""Work-precision charts."""

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from flexman_gym.common.plot_style import save_figure
from flexman_gym.toolbox.precision.runs import OK, PrecisionRow
from studies.charts import new_chart
from studies.methods import line_styles
from studies.precision.measure import Floor

COST = "CPU seconds per simulated second"
LARGEST_ERROR = 30.0  # m; larger than the arm: larger errors are not shown
PICTURE = "work_precision.svg"
SCENE, MODEL = "paper_ff", "2 elements a link, foreshortening"  # scene and model of the chart
SHOWN = ("midpoint_corrected_3", "midpoint_3", "gauss_3", "extrapolated_euler_6", "ros2", "generalised_alpha")


def new_panel(title: str) -> tuple[Any, Any]:
    """Return a figure and its log-log panel."""
    figure, ((axes,),) = new_chart((7.6, 4.6))
    axes.set(xscale="log", yscale="log", xlabel=COST)
    axes.set_title(title, fontsize=11)
    return figure, axes


def _shown_error(row: PrecisionRow, column: str) -> float:
    """Return the plotted error (m); infinite if the run failed or the error is too large."""
    value = getattr(row, column)
    return math.inf if value is None or row.status != OK or value > LARGEST_ERROR else float(value)


def draw_runs(axes: Any, rows: Sequence[PrecisionRow], column: str, label: str, look: dict[str, Any]) -> None:
    """Plot the runs that did not fail."""
    good = [row for row in rows if math.isfinite(_shown_error(row, column)) and _shown_error(row, column) > 0.0]
    if good:
        values = [row.cpu for row in good], [_shown_error(row, column) for row in good]
        axes.plot(*values, **{"markersize": 5.0, "linewidth": 1.1, "label": label} | look)


def finish(figure: Any, path: Path) -> None:
    """Add the legend and save the figure."""
    figure.legend(loc="outside lower center", frameon=False, fontsize=9, ncols=3)
    save_figure(figure, path)


def draw(rows: Sequence[PrecisionRow], floors: Sequence[Floor], folder: Path) -> None:
    """Plot the time error over the cost of a few methods, for one scene and model of the rows.

    Raises:
        ImportError: without Matplotlib.
    """
    timed = [floor for floor in floors if floor.model]
    chosen = next((floor for floor in timed if (floor.scene, floor.model) == (SCENE, MODEL)), timed[0])
    figure, axes = new_panel(f"{chosen.title}\n{chosen.model}".capitalize())
    mine = [row for row in rows if (row.scene, row.model) == (chosen.scene, chosen.model) and row.rtol is None]
    for method, look in line_styles(SHOWN).items():
        draw_runs(axes, [row for row in mine if row.method == method], "time_error", method, look)
    axes.set_ylabel("largest distance of the tip\nfrom the converged solution (m)")
    finish(figure, folder / PICTURE)

"""Axes of error over cost: what the charts of precision and of peers share."""

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from flexman_gym.draw.style import DARK, LIGHT, MIDDLE, new_figure
from studies.precision.measure import OK, Row, pareto_front

COST = "CPU seconds per simulated second"
TOTAL_ERROR = "total error: largest distance of the tip from the truth (m)"
TRUTHS = "how well finest models agree"
LARGEST_ERROR = 30.0  # m; the arm is smaller, so what is above says no more than that


def new_panels(count: int, title: str, height: float = 5.4) -> tuple[Any, list[Any]]:
    """A figure with panels side by side and its title; both axes are logarithmic."""
    figure = new_figure((5.6 + 4.4 * count, height), 110.0, layout="constrained")
    panels = list(figure.subplots(1, count, sharey=True, squeeze=False)[0])
    figure.suptitle(title, fontsize=13)
    for axes in panels:
        axes.set(xscale="log", yscale="log", xlabel=COST)
        axes.tick_params(which="minor", labelbottom=False)
        axes.grid(color=LIGHT, linewidth=0.6)
        axes.spines[["top", "right"]].set_visible(False)
    return figure, panels


def shown_error(row: Row, column: str) -> float:
    """The error, or infinity where there is none to show."""
    value = getattr(row, column)
    return math.inf if value is None or row.status != OK or value > LARGEST_ERROR else float(value)


def draw_runs(axes: Any, rows: Sequence[Row], column: str, label: str, look: dict[str, Any]) -> None:
    """Runs of one kind; those that failed are small crosses at the upper edge."""
    good = [row for row in rows if math.isfinite(shown_error(row, column)) and shown_error(row, column) > 0.0]
    if good:
        values = [row.cpu for row in good], [shown_error(row, column) for row in good]
        axes.plot(*values, **{"markersize": 5.0, "linewidth": 1.1, "label": label} | look)
    judged = [row for row in rows if getattr(row, column) is not None]
    failed = [row.cpu for row in judged if not math.isfinite(shown_error(row, column))]
    if failed:
        upper = axes.get_xaxis_transform()
        axes.plot(failed, [0.985] * len(failed), "x", color=look["color"], markersize=6.0, transform=upper)


def draw_front(axes: Any, rows: Sequence[Row], column: str, floor: float = 0.0) -> list[Row]:
    """A broad pale line along the best runs, which it returns; errors below the floor (m) are all the same."""
    front = [rows[i] for i in pareto_front([(row.cpu, max(floor, shown_error(row, column))) for row in rows])]
    values = [row.cpu for row in front], [shown_error(row, column) for row in front]
    look = {"color": "#b9bec7", "linewidth": 7.0, "alpha": 0.6, "zorder": 0, "solid_joinstyle": "round"}
    axes.plot(*values, drawstyle="steps-post", label="Pareto front", **look)
    return front


def draw_floor(axes: Any, floor: float, label: str) -> None:
    """A dashed line at the error (m) of what judges the runs."""
    axes.axhline(floor, color=DARK, linewidth=1.0, linestyle="--", label=label, zorder=1)


def finish(figure: Any, panels: Sequence[Any], path: Path) -> None:
    """One legend for all panels, outside; a cross in it says what failed. Each axis shows at least a decade."""
    panels[-1].plot([], [], "x", color=MIDDLE, label="failed, at the upper edge")
    for axes in panels:
        low, high = axes.get_xlim()
        axes.set_xlim(10.0 ** math.floor(math.log10(low)), 10.0 ** math.ceil(math.log10(high)))
    entries: dict[str, Any] = {}
    for axes in panels:
        for handle, label in zip(*axes.get_legend_handles_labels(), strict=True):
            entries.setdefault(label, handle)
    figure.legend(entries.values(), entries.keys(), loc="outside right center", frameon=False, fontsize=8)
    figure.savefig(path)

"""Work-precision charts."""

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from flexman_gym.common.plot_style import BLUE, DARK, LIGHT, MIDDLE, ORANGE, RED, SKY, new_figure
from studies.methods import line_styles, methods_of
from studies.precision.measure import OK, PrecisionRow, pareto_front

COST = "CPU seconds per simulated second"
TOTAL_ERROR = "total error: largest distance of the tip from the reference (m)"
AGREEMENT = "agreement of the finest models"
LARGEST_ERROR = 30.0  # m; larger than the arm: larger errors are not shown


def new_panels(count: int, title: str, height: float = 5.4) -> tuple[Any, list[Any]]:
    """Return a figure with a title and log-log panels side by side."""
    figure = new_figure((5.6 + 4.4 * count, height), 110.0, layout="constrained")
    panels = list(figure.subplots(1, count, sharey=True, squeeze=False)[0])
    figure.suptitle(title, fontsize=13)
    for axes in panels:
        axes.set(xscale="log", yscale="log", xlabel=COST)
        axes.tick_params(which="minor", labelbottom=False)
        axes.grid(color=LIGHT, linewidth=0.6)
        axes.spines[["top", "right"]].set_visible(False)
    return figure, panels


def _shown_error(row: PrecisionRow, column: str) -> float:
    """Return the plotted error (m); infinite if the run failed or the error is too large."""
    value = getattr(row, column)
    return math.inf if value is None or row.status != OK or value > LARGEST_ERROR else float(value)


def draw_runs(axes: Any, rows: Sequence[PrecisionRow], column: str, label: str, look: dict[str, Any]) -> None:
    """Plot runs; failed runs are small crosses at the upper edge."""
    good = [row for row in rows if math.isfinite(_shown_error(row, column)) and _shown_error(row, column) > 0.0]
    if good:
        values = [row.cpu for row in good], [_shown_error(row, column) for row in good]
        axes.plot(*values, **{"markersize": 5.0, "linewidth": 1.1, "label": label} | look)
    evaluated = [row for row in rows if getattr(row, column) is not None]
    failed = [row.cpu for row in evaluated if not math.isfinite(_shown_error(row, column))]
    if failed:
        upper = axes.get_xaxis_transform()
        axes.plot(failed, [0.985] * len(failed), "x", color=look["color"], markersize=6.0, transform=upper)


def draw_front(axes: Any, rows: Sequence[PrecisionRow], column: str, floor: float = 0.0) -> list[PrecisionRow]:
    """Plot the Pareto front as a broad pale line and return its runs; errors below the floor (m) count as equal."""
    front = [rows[i] for i in pareto_front([(row.cpu, max(floor, _shown_error(row, column))) for row in rows])]
    values = [row.cpu for row in front], [_shown_error(row, column) for row in front]
    look = {"color": "#b9bec7", "linewidth": 7.0, "alpha": 0.6, "zorder": 0, "solid_joinstyle": "round"}
    axes.plot(*values, drawstyle="steps-post", label="Pareto front", **look)
    return front


def draw_floor(axes: Any, floor: float, label: str) -> None:
    """Plot a dashed line at the error (m) of the reference."""
    axes.axhline(floor, color=DARK, linewidth=1.0, linestyle="--", label=label, zorder=1)


def finish(figure: Any, panels: Sequence[Any], path: Path) -> None:
    """Add a common legend, extend each axis to at least a decade, and save the figure."""
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


GAIN = 0.9  # a run of the front is labelled if its error is below this share of the previously labelled error
MODEL_STYLES = {
    "rigid links": (MIDDLE, "o"),
    "modes": (ORANGE, "^"),
    "modes, foreshortening": (RED, "^"),
    "elements": (SKY, "s"),
    "elements, foreshortening": (BLUE, "s"),
}


def _family(model: str) -> str:
    """Return the key of `MODEL_STYLES` for a model name."""
    if model.startswith("rigid"):
        return "rigid links"
    kind = "modes" if "mode" in model else "elements"
    return f"{kind}, foreshortening" if "foreshortening" in model else kind


def time_error_chart(rows: Sequence[PrecisionRow], floors: dict[str, float], title: str, path: Path) -> None:
    """Plot time error against cost: a panel per model in `floors` (error of its reference, m), a line per method."""
    figure, panels = new_panels(len(floors), title)
    known = line_styles()
    for axes, (model, floor) in zip(panels, floors.items(), strict=True):
        chosen = [row for row in rows if row.model == model and row.time_error is not None]
        for method in methods_of(chosen):
            colour, marker = known[method]
            for adaptive in (False, True):
                line = [row for row in chosen if row.method == method and (row.rtol is not None) == adaptive]
                label = f"{method}, adaptive" if adaptive else method
                look = {"color": colour, "marker": marker, "markerfacecolor": "white" if adaptive else colour}
                draw_runs(axes, line, "time_error", label, look | {"linestyle": ":" if adaptive else "-"})
        draw_front(axes, chosen, "time_error")
        draw_floor(axes, floor, "error of the reference")
        axes.set_title(model, fontsize=11)
    panels[0].set_ylabel("time error: largest distance of the tip\nfrom the converged solution of the same model (m)")
    finish(figure, panels, path)


def total_error_chart(rows: Sequence[PrecisionRow], floor: float, title: str, path: Path) -> None:
    """Plot total error against cost: a dot per run, a colour per kind of model, and the labelled Pareto front."""
    figure, (axes,) = new_panels(1, title, 7.0)
    for name, (colour, marker) in MODEL_STYLES.items():
        line = [row for row in rows if _family(row.model) == name]
        draw_runs(axes, line, "total_error", name, {"color": colour, "marker": marker, "linestyle": ""})
    front = draw_front(axes, rows, "total_error", floor)
    draw_floor(axes, floor, AGREEMENT)
    _name(axes, front)
    axes.set_ylabel(TOTAL_ERROR)
    finish(figure, [axes], path)


def _name(axes: Any, front: Sequence[PrecisionRow]) -> None:
    """Number the runs of the front with a clear gain and describe them in the legend."""
    changes: list[PrecisionRow] = []
    for row in front:
        if not changes or _shown_error(row, "total_error") < GAIN * _shown_error(changes[-1], "total_error"):
            changes.append(row)
    for number, row in enumerate(changes, start=1):
        place = {"xytext": (-5, -5), "textcoords": "offset points", "ha": "right", "va": "top"}
        axes.annotate(str(number), (row.cpu, row.total_error), fontsize=9, color=DARK, **place)
        text = f"{row.model},\n{row.method}, {row.setting}"
        axes.plot([], [], linestyle="", marker=f"${number}$", color=DARK, label=text)

"""Precision charts: error of the tip over cost, from rows of a study of work and precision."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from flexman_gym.draw.style import BLUE, DARK, MIDDLE, ORANGE, RED, SKY
from studies.looks import looks
from studies.methods import methods_of
from studies.precision.axes import (
    TOTAL_ERROR,
    TRUTHS,
    draw_floor,
    draw_front,
    draw_runs,
    finish,
    new_panels,
    shown_error,
)
from studies.precision.measure import Row

GAIN = 0.9  # a run on the front is named when its error is less than this part of that of the one named before
MODEL_STYLES = {
    "rigid links": (MIDDLE, "o"),
    "modes": (ORANGE, "^"),
    "modes, foreshortening": (RED, "^"),
    "elements": (SKY, "s"),
    "elements, foreshortening": (BLUE, "s"),
}


def family(model: str) -> str:
    """The kind of model that a name belongs to, a key of `MODEL_STYLES`."""
    if model.startswith("rigid"):
        return "rigid links"
    kind = "modes" if "mode" in model else "elements"
    return f"{kind}, foreshortening" if "foreshortening" in model else kind


def time_error_chart(rows: Sequence[Row], floors: dict[str, float], title: str, path: Path) -> None:
    """Time error over cost, a panel for each model in `floors` (its truth's own error, m), a line for each method."""
    figure, panels = new_panels(len(floors), title)
    known = looks()
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
        draw_floor(axes, floor, "error of the truth itself")
        axes.set_title(model, fontsize=11)
    panels[0].set_ylabel("time error: largest distance of the tip\nfrom the converged solution of the same model (m)")
    finish(figure, panels, path)


def total_error_chart(rows: Sequence[Row], floor: float, title: str, path: Path) -> None:
    """Total error over cost, one dot a run, coloured by the kind of model; the Pareto front names its models."""
    figure, (axes,) = new_panels(1, title, 7.0)
    for name, (colour, marker) in MODEL_STYLES.items():
        line = [row for row in rows if family(row.model) == name]
        draw_runs(axes, line, "total_error", name, {"color": colour, "marker": marker, "linestyle": ""})
    front = draw_front(axes, rows, "total_error", floor)
    draw_floor(axes, floor, TRUTHS)
    _name(axes, front)
    axes.set_ylabel(TOTAL_ERROR)
    finish(figure, [axes], path)


def _name(axes: Any, front: Sequence[Row]) -> None:
    """Numbers the runs on the front that gain much; the legend says what they are."""
    changes: list[Row] = []
    for row in front:
        if not changes or shown_error(row, "total_error") < GAIN * shown_error(changes[-1], "total_error"):
            changes.append(row)
    for number, row in enumerate(changes, start=1):
        place = {"xytext": (-5, -5), "textcoords": "offset points", "ha": "right", "va": "top"}
        axes.annotate(str(number), (row.cpu, row.total_error), fontsize=9, color=DARK, **place)
        text = f"{row.model},\n{row.method}, {row.setting}"
        axes.plot([], [], linestyle="", marker=f"${number}$", color=DARK, label=text)

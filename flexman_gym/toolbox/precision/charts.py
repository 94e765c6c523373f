"""Charts of error against computing time: one panel for each scene."""

import math
from collections.abc import Iterable, Sequence
from itertools import accumulate
from pathlib import Path
from textwrap import wrap
from typing import Any

from flexman_gym.common.plot_style import BLUE, BROWN, GREEN, LIGHT, PURPLE, RED, SLATE, new_figure, save_figure
from flexman_gym.toolbox.precision.runs import PrecisionRow, pareto_front

CHOSEN = "chosen for "  # begins the name of a model of `choose_model`, before its tolerance
DPI = 100.0  # pixels per inch of a chart in a page
PANEL = (4.4, 3.9)  # inches; width and height of a panel
COST, ERROR = "computing time, CPU ms per simulated second", "largest error of the tip, mm"
PEERS = {  # words in the name of the model -> label, colour, marker; the first that fits
    "MuJoCo, rods": ("MuJoCo, rods", PURPLE, "h"), "MuJoCo, rigid": ("MuJoCo, rigid", BROWN, "X"),
    "MuJoCo": ("MuJoCo, rigid pieces", RED, "o"), "Exudyn": ("Exudyn, floating frame", SLATE, "P"),
    "Pinocchio": ("Pinocchio, rigid", BROWN, "s"), "SoRoMoX": ("SoRoMoX", GREEN, "v"),
}  # fmt: skip
PLACES = {  # words as above -> offset of the label, points, its end there, and whether it is that of the cheapest run
    "MuJoCo, rods": ((6, 6), "left", True), "MuJoCo, rigid": ((0, 7), "right", True),
    "MuJoCo": ((12, -15), "right", False), "Exudyn": ((9, -2), "left", True), "Pinocchio": ((0, 7), "left", True),
    "SoRoMoX": ((7, 1), "left", False),
}  # fmt: skip
TITLE_WIDTH = 46  # characters of a line of the title of a panel
LEFTMOST = 0.06  # left end of the axis of costs / cost of the cheapest run
HIGHEST = 3.0  # largest error in a panel / that of the cheapest of our runs
EDGE = 0.85  # largest error of a shown run / upper end of the axis, which cuts no marker


def family_of(row: PrecisionRow) -> str | None:
    """Return the first words of `PEERS` in the model of a row; None for our rows."""
    return next((words for words in PEERS if row.model.startswith(words)), None)


def lasting_errors(rows: Iterable[PrecisionRow], floor: float = 0.0) -> dict[PrecisionRow, float]:
    """Return the largest error of model and method of each of our runs, at its step and all shorter ones, m.

    Errors of model and method that cancel at one step by chance do not count, and those below the floor (m) are equal.
    """
    errors: dict[tuple[str, str], float] = {}
    result = {}
    for row in sorted((row for row in rows if family_of(row) is None), key=lambda row: row.step or 0.0):
        key = row.model, row.method
        errors[key] = result[row] = max(floor, errors.get(key, 0.0), row.error)
    return result


def front_of(rows: Iterable[PrecisionRow], floor: float = 0.0) -> list[PrecisionRow]:
    """Return our runs on the Pareto front of cost and lasting error, by increasing cost."""
    errors = lasting_errors(rows, floor)
    ours = [*errors]
    return [ours[i] for i in pareto_front([(row.cpu, errors[row]) for row in ours])]


def _flexible_peers(rows: Sequence[PrecisionRow]) -> list[PrecisionRow]:
    """Return the runs of other simulators with flexible links."""
    return [row for row in rows if family_of(row) is not None and "rigid" not in row.model.split(", ")[-1]]


def cheapest_equal(rows: Sequence[PrecisionRow]) -> PrecisionRow | None:
    """Return the cheapest run of another simulator with at most the error of the default, the first row, or None."""
    equal = [row for row in _flexible_peers(rows) if row.error <= rows[0].error]
    return min(equal, key=lambda row: row.cpu, default=None)


def conclusion(rows: Sequence[PrecisionRow]) -> str:
    """Return a sentence on the default of the environments, the first row, and the other simulators with its error."""
    default = rows[0]
    if not math.isfinite(default.error):
        return f"The default is {default.status}"
    reached = f"The default: {1e3 * default.error:.2g} mm at {1e3 * default.cpu:.2g} ms per s"
    if not _flexible_peers(rows):
        return reached
    equal = cheapest_equal(rows)
    if equal is None:
        return f"{reached}; no other simulator has a smaller error"
    return f"{reached}; {equal.model.split(',')[0]} takes {ratio_text(equal, default)} times as long for the same error"


def ratio_text(one: PrecisionRow, other: PrecisionRow) -> str:
    """Return the cost of a run / that of another one, with two digits."""
    return f"{float(f'{one.cpu / other.cpu:.2g}'):g}"


def draw_panel(axes: Any, rows: Sequence[PrecisionRow], floor: float, title: str) -> None:
    """Draw the runs of a scene: the front of ours as a line, the default with a ring, others with a label.

    A run of a model of `choose_model` has a diamond.

    Args:
        axes: axes of Matplotlib.
        rows: runs of one scene; the first is the default of the environments.
        floor: error of the reference, m; a dashed line.
        title: title of the panel.
    """
    axes.set(xscale="log", yscale="log")
    lines = [part for line in title.split("\n") for part in wrap(line, TITLE_WIDTH)]
    axes.set_title("\n".join(lines), fontsize=10, loc="left", color=SLATE)
    front = front_of(rows, floor)
    costs, errors = _points(front)
    axes.plot(costs, [*accumulate(errors, min)], color=BLUE, linewidth=2.0, drawstyle="steps-post", marker=".")
    if front:
        _label(axes, front[-1], "flexman_gym", BLUE, (4, 4), "left")
    highest = HIGHEST * max([row.error for row in front] or [floor])
    for words, (label, colour, marker) in PEERS.items():
        mine = [row for row in rows if family_of(row) == words and row.error < EDGE * highest]
        if mine:
            axes.plot(*_points(mine), marker, color=colour, markersize=6.0)
            offset, end, cheapest = PLACES[words]
            named = min(mine, key=lambda row: row.cpu) if cheapest else min(mine, key=lambda row: row.error)
            _label(axes, named, label, colour, offset, end)
    for row in rows:
        if row.model.startswith(CHOSEN):
            axes.plot(*_points([row]), "D", markersize=8.0, markerfacecolor="none", color=BLUE, markeredgewidth=1.5)
            tolerance = row.model.removeprefix(CHOSEN).partition(":")[0]
            _label(axes, row, f"chosen, {tolerance}", BLUE, (-7, -9), "right")
    default = rows[0]
    axes.plot(*_points([default]), "o", markersize=12.0, markerfacecolor="none", color=BLUE, markeredgewidth=2.0)
    _label(axes, default, "default", BLUE, (9, 5), "left")
    axes.axhline(1e3 * floor, color=SLATE, linewidth=1.0, linestyle="--", zorder=1)
    place = {"xycoords": ("axes fraction", "data"), "textcoords": "offset points"}
    axes.annotate("error of the reference", (0.01, 1e3 * floor), (0, -3), va="top", fontsize=8, color=SLATE, **place)
    axes.set_ylim(300.0 * floor, 1e3 * highest)


def _points(rows: Sequence[PrecisionRow]) -> tuple[list[float], list[float]]:
    """Return computing times (ms per s) and errors (mm)."""
    return [1e3 * row.cpu for row in rows], [1e3 * row.error for row in rows]


def _label(axes: Any, row: PrecisionRow, text: str, colour: str, offset: tuple[float, float], end: str) -> None:
    """Write a label beside a run; its left or right end is at an offset, points."""
    place = 1e3 * row.cpu, 1e3 * row.error
    axes.annotate(text, place, xytext=offset, textcoords="offset points", fontsize=9.5, color=colour, ha=end)


def draw_scenes(scenes: Sequence[tuple[Sequence[PrecisionRow], float, str]], path: Path, columns: int = 2) -> Path:
    """Draw a panel for each scene, and return the path of the picture.

    Args:
        scenes: arguments of `draw_panel` after the axes, for each scene.
        path: path of the picture; its suffix decides the format.
        columns: largest number of panels side by side.

    Raises:
        ImportError: without Matplotlib.
    """
    columns = min(columns, len(scenes))
    lines = math.ceil(len(scenes) / columns)
    figure = new_figure((PANEL[0] * columns, PANEL[1] * lines), DPI, layout="constrained")
    every = figure.subplots(lines, columns, squeeze=False, sharex=len(scenes) > 1)
    for axes, each in zip(every.flat, scenes, strict=False):
        draw_panel(axes, *each)
        axes.grid(color=LIGHT, linewidth=0.6)
        axes.spines[["top", "right"]].set_visible(False)
        axes.margins(x=0.12)
        axes.set_xlim(left=LEFTMOST * axes.dataLim.minposx)
    for axes in every.flat[len(scenes) :]:
        axes.set_visible(False)
    figure.supxlabel(COST, fontsize=10, color=SLATE)
    figure.supylabel(ERROR, fontsize=10, color=SLATE)
    return save_figure(figure, path)

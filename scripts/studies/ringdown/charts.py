"""Ring-down, charts: errors of energy and tip over cost, and the energy that is left."""

from collections.abc import Sequence
from math import isclose
from pathlib import Path
from typing import Any

import numpy as np

from flexman_gym.draw.style import DARK, LIGHT, MIDDLE, new_figure
from studies.looks import looks
from studies.methods import methods_of
from studies.ringdown.cases import RELEASE, UNDAMPED
from studies.ringdown.measure import Row

COST = "CPU seconds per simulated second of one arm"
GREYS = {"Euler": "x", "RK4": "d", "implicitfast": "+", "discrete": "."}  # markers of MuJoCo's integrators
PICTURE = "ring_down.png"


def draw(rows: Sequence[Row], folder: Path, default: tuple[str, float]) -> None:
    """Draws the picture of the study; `default` is method and step (s) of the environments, which gets a ring."""
    figure = new_figure((13.0, 5.2), 110.0, layout="constrained")
    panels = figure.subplots(1, 3)
    released = [row for row in rows if row.kind == RELEASE]
    _lines(panels[0], released, "energy_median", default)
    panels[0].set(title="Energy after 3 s", ylabel="median error, as a part of what should be left")
    _lines(panels[1], released, "tip_median", default)
    panels[1].set(title="Tip after 3 s", ylabel="median distance from the converged one (m)")
    undamped = [row for row in rows if row.kind == UNDAMPED]
    _lines(panels[2], undamped, "energy_median", default)
    panels[2].set(title="Energy of an arm without damping, after 3 s", ylabel="median error, as a part of the start")
    figure.suptitle("Released from up to 5 cm of deflection: what is left after 3 s, for what it costs", fontsize=13)
    entries: dict[str, Any] = {}
    for axes in panels:
        axes.set(xscale="log", yscale="log", xlabel=COST)
        axes.grid(color=LIGHT, linewidth=0.6)
        axes.spines[["top", "right"]].set_visible(False)
        entries |= {label: handle for handle, label in zip(*axes.get_legend_handles_labels(), strict=True)}
    figure.legend(entries.values(), entries.keys(), loc="outside right center", frameon=False, fontsize=8)
    figure.savefig(folder / PICTURE)


def _lines(axes: Any, rows: Sequence[Row], column: str, default: tuple[str, float]) -> None:
    ours = [row for row in rows if row.code == "flexman_gym"]
    for name in methods_of(ours):
        look = looks()[name]
        _line(axes, [row for row in ours if row.method == name], column, name, look.colour, look.marker)
    for row in ours:
        if row.method == default[0] and isclose(row.step, default[1], rel_tol=1e-4):
            ring = {"markersize": 15.0, "markerfacecolor": "none", "markeredgecolor": DARK, "markeredgewidth": 1.6}
            axes.plot(row.cpu, getattr(row, column), "o", **ring, linestyle="", label="default of the environments")
    for name, marker in GREYS.items():
        theirs = [row for row in rows if row.code != "flexman_gym" and row.method == name]
        label = f"{theirs[0].code}, {name}" if theirs else name
        _line(axes, theirs, column, label, MIDDLE, marker)


def _line(axes: Any, rows: Sequence[Row], column: str, label: str, colour: str, marker: str) -> None:
    """Runs of one method over their cost; those of which most failed are left out."""
    good = [row for row in rows if np.isfinite(getattr(row, column)) and row.failed < 0.5]
    if good:
        values = [row.cpu for row in good], [getattr(row, column) for row in good]
        axes.plot(*values, marker=marker, color=colour, linewidth=1.0, markersize=6.0, label=label)

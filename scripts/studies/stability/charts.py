"""Charts of the stability study: step limits of explicit methods, and a map of where each method fails."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from flexman_gym.common.plot_style import BLUE, ORANGE, RED, SLATE, save_figure
from flexman_gym.simulation.methods import DEFAULT_METHOD
from studies.charts import new_chart
from studies.methods import explicit_methods, line_styles, methods_of
from studies.stability.measure import (
    DIVERGED,
    FULL_MODES,
    INACCURATE,
    MODES,
    NOT_CONVERGED,
    OK,
    PAYLOAD,
    SPIN_STIFFENED,
    SPRINGS,
    StabilityRow,
    select,
)
from studies.stability.rows import ERROR, LIMIT, LIMIT_STUDIES

PICTURE, MAP = "stability_step_limit.svg", "stability_map.svg"
MAPPED = (SPRINGS, MODES, PAYLOAD, SPIN_STIFFENED)  # studies whose runs are on the map
SHARES = {
    OK: (BLUE, "accurate to 1 mm"), INACCURATE: (ORANGE, "less accurate"), DIVERGED: (RED, "diverged"),
    NOT_CONVERGED: (SLATE, "iterations did not converge"),
}  # fmt: skip
LABELS = {
    SPRINGS: "stiffness of every joint spring (N m/rad)", MODES: "loaded modes per link", PAYLOAD: "payload (kg)",
}  # fmt: skip


def draw(rows: Sequence[StabilityRow], folder: Path) -> None:
    """Draw the step limits and the map.

    Raises:
        ImportError: without Matplotlib.
    """
    draw_limits(rows, folder)
    draw_map(rows, folder)


def draw_limits(rows: Sequence[StabilityRow], folder: Path) -> None:
    """Plot the longest stable step against the parameter of each study: lines predicted, markers measured.

    Raises:
        ImportError: without Matplotlib.
    """
    figure, (panels,) = new_chart((7.6, 4.0), columns=3)
    for axes, study in zip(panels, LIMIT_STUDIES, strict=True):
        axes.sharey(panels[0])
        result = select(rows, study=study, quantity=LIMIT)
        places = sorted({row.parameter for row in result})
        for name in methods_of(result):
            own = select(result, method=name)
            x = [places.index(row.parameter) for row in own]
            look = line_styles(explicit_methods())[name]
            predicted = [1e3 * (row.expected or np.nan) for row in own]
            axes.semilogy(x, predicted, color=look["color"], label=name)
            axes.semilogy(x, [1e3 * row.value for row in own], **look, linestyle="", label="measured")
        axes.set_xticks(range(len(places)), [_tick(study, value) for value in places])
        axes.set_xlabel(LABELS[study], fontsize=9)
        axes.tick_params(labelsize=8)
    figure.get_axes()[0].set_ylabel("largest stable step (ms)")
    figure.suptitle("Explicit methods: predicted limit (lines), and measured over 2000 steps (markers)", fontsize=11)
    handles = [each for each in zip(*axes.get_legend_handles_labels(), strict=True) if each[1] != "measured"]
    figure.legend(*zip(*handles, strict=True), loc="outside lower center", ncols=3, frameon=False, fontsize=9)
    save_figure(figure, folder / PICTURE)


def mapped_rows(rows: Sequence[StabilityRow]) -> list[StabilityRow]:
    """Return the runs of the map: the tip errors of all methods and steps, over springs, modes, payloads and spin."""
    return [row for row in rows if row.quantity == ERROR and row.study in MAPPED]


def draw_map(rows: Sequence[StabilityRow], folder: Path) -> None:
    """Draw a cell for each method and step, divided by the shares of accurate, inaccurate and diverged runs."""
    shown = mapped_rows(rows)
    steps, names = sorted({row.step for row in shown}), methods_of(shown)[::-1]
    figure, ((axes,),) = new_chart((7.6, 5.2))
    axes.grid(visible=False)
    for i, name in enumerate(names):
        for k, step in enumerate(steps):
            verdicts = [row.verdict for row in select(shown, method=name, step=step)]
            left = float(k)
            for verdict, (colour, _) in SHARES.items():
                width = 0.92 * verdicts.count(verdict) / max(len(verdicts), 1)
                axes.barh(i, width, 0.8, left, color=colour)
                left += width
    axes.set_xticks(0.46 + np.arange(len(steps)), [f"{1e3 * step:.2g}" for step in steps])
    axes.set_yticks(range(len(names)), [f"{name} (default)" if name == DEFAULT_METHOD else name for name in names])
    axes.tick_params(labelsize=8, length=0)
    axes.set_xlabel("step (ms)")
    axes.spines[["left", "bottom"]].set_visible(False)
    patches = [axes.barh(0, 0, color=colour, label=label) for colour, label in SHARES.values()]
    figure.legend(handles=patches, loc="outside lower center", ncols=4, frameon=False, fontsize=9, labelcolor=SLATE)
    save_figure(figure, folder / MAP)


def _tick(study: str, value: float) -> str:
    if study == MODES and value == FULL_MODES:
        return "full"
    if study == SPRINGS:  # half powers have no room
        power = np.log10(value)
        return f"$10^{{{power:.0f}}}$" if abs(power - round(power)) < 0.01 else ""
    return f"{value:g}"

"""Chart of the stability study: step limits of explicit methods."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from flexman_gym.common.plot_style import save_figure
from studies.charts import new_chart
from studies.methods import explicit_methods, line_styles, methods_of
from studies.stability.measure import FULL_MODES, MODES, PAYLOAD, SPRINGS, StabilityRow, select
from studies.stability.rows import LIMIT, LIMIT_STUDIES

PICTURE = "stability_step_limit.svg"
LABELS = {
    SPRINGS: "stiffness of every joint spring (N m/rad)", MODES: "loaded modes per link", PAYLOAD: "payload (kg)",
}  # fmt: skip


def draw(rows: Sequence[StabilityRow], folder: Path) -> None:
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


def _tick(study: str, value: float) -> str:
    if study == MODES and value == FULL_MODES:
        return "full"
    if study == SPRINGS:  # half powers have no room
        power = np.log10(value)
        return f"$10^{{{power:.0f}}}$" if abs(power - round(power)) < 0.01 else ""
    return f"{value:g}"

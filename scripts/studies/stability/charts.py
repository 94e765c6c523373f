"""Chart of the stability study (PNG): step limits of explicit methods."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from flexman_gym.common.plot_style import LIGHT, new_figure
from studies.methods import explicit_methods, line_styles, methods_of
from studies.stability.measure import FULL_MODES, MODES, PAYLOAD, SPRINGS, StabilityRow, select
from studies.stability.rows import LIMIT, LIMIT_STUDIES

PICTURE = "stability_step_limit.png"
LABELS = {
    SPRINGS: "stiffness of every joint spring (N m/rad)", MODES: "loaded modes per link", PAYLOAD: "payload (kg)",
}  # fmt: skip


def draw(rows: Sequence[StabilityRow], folder: Path) -> None:
    """Plot the longest stable step against the parameter of each study: lines predicted, markers measured.

    Raises:
        ImportError: without Matplotlib.
    """
    figure = new_figure((12.0, 4.6), 110.0, layout="constrained")
    for axes, study in zip(figure.subplots(1, 3, sharey=True), LIMIT_STUDIES, strict=True):
        result = select(rows, study=study, quantity=LIMIT)
        places = sorted({row.parameter for row in result})
        for name in methods_of(result):
            own = select(result, method=name)
            x = [places.index(row.parameter) for row in own]
            look = line_styles(explicit_methods())[name]
            predicted = [1e3 * (row.expected or np.nan) for row in own]
            axes.semilogy(x, predicted, color=look["color"], label=f"{name}, predicted")
            axes.semilogy(x, [1e3 * row.value for row in own], **look, linestyle="", label="measured")
        axes.set_xticks(range(len(places)), [_tick(study, value) for value in places])
        axes.set_xlabel(LABELS[study])
        _frame(axes)
    figure.get_axes()[0].set_ylabel("largest stable step (ms)")
    figure.suptitle(
        "Explicit limits: predicted c / highest natural frequency, and measured over 2000 steps", fontsize=13
    )
    figure.legend(*axes.get_legend_handles_labels(), loc="outside lower center", ncols=6, frameon=False)
    figure.savefig(folder / PICTURE)


def _tick(study: str, value: float) -> str:
    if study == MODES and value == FULL_MODES:
        return "full"
    return f"$10^{{{np.log10(value):.3g}}}$" if study == SPRINGS else f"{value:g}"


def _frame(axes: Any) -> None:
    axes.grid(color=LIGHT, linewidth=0.6)
    axes.spines[["top", "right"]].set_visible(False)

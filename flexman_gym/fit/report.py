"""Report: a fit as a page, a picture and an arm file."""

from pathlib import Path
from typing import Any

import numpy as np

PAGE = """# An arm fitted to measurements

{explanation}

| number | value | deviation |
| --- | --- | --- |
{numbers}

{compared}
{warnings}
![measured and computed](fit.png)

The arm is in `arm.yaml`.
"""
MEASURED, COMPUTED = "#8a8f98", "#0072B2"


def write_report(found: Any, folder: Path) -> None:
    """Writes fit.md, fit.png and arm.yaml of a Fit into a folder.

    Raises:
        ImportError: without Matplotlib.
    """
    folder.mkdir(parents=True, exist_ok=True)
    found.save(folder / "arm.yaml")
    _draw(found, folder / "fit.png")
    lines = [
        f"| {name} | {', '.join(f'{each:.5g}' for each in np.ravel(found.values[name]))} "
        f"| {', '.join(f'{each:.2g}' for each in np.ravel(found.deviations[name]))} |"
        for name in found.values
    ]
    lines += [f"| gain of {name} | {gain:.5g} | {deviation:.2g} |" for name, (gain, deviation) in found.gains.items()]
    compared = [f"- {name}: R2 {score:.4f}" for name, score in found.scores.items()]
    compared += [f"- measured {row[0]:.5g}, computed {row[1]:.5g} ({row[2]:.2g})" for row in found.frequencies]
    warnings = [f"- **{line}**" for line in found.warnings]
    text = PAGE.format(
        explanation=found.explanation, numbers="\n".join(lines), compared="\n".join(compared) + "\n",
        warnings="\n".join(warnings) + "\n" * bool(warnings),
    )  # fmt: skip
    (folder / "fit.md").write_text(text, encoding="utf-8")


def _draw(found: Any, file: Path) -> None:
    """Each output of each record, measured and computed."""
    try:
        from matplotlib.backends.backend_agg import FigureCanvasAgg
        from matplotlib.figure import Figure
    except ImportError as error:
        raise ImportError("pictures need Matplotlib: pip install 'flexman_gym[render]'") from error
    panels = [(i, record, name) for i, record in enumerate(found.records) for name in record.outputs]
    shown = [found.predicted(record) for record in found.records]
    figure = Figure(figsize=(9.0, 2.4 * max(1, len(panels))), dpi=100, layout="constrained")
    FigureCanvasAgg(figure)
    grid = figure.subplots(max(1, len(panels)), 1, squeeze=False)[:, 0]
    for axes, (i, record, name) in zip(grid, panels, strict=False):
        axes.plot(record.times, record.outputs[name], color=MEASURED, linewidth=2.0, label="measured")
        axes.plot(record.times, shown[i][name], color=COMPUTED, linewidth=1.0, label="computed")
        axes.set(title=f"record {i}, {name}", xlabel="time (s)")
        axes.legend(frameon=False)
    if not panels:
        grid[0].errorbar(*found.frequencies.T[:2], xerr=found.frequencies[:, 2], fmt="o", color=COMPUTED)
        grid[0].set(xlabel="measured (Hz, or damping ratio)", ylabel="computed")
    figure.savefig(file)

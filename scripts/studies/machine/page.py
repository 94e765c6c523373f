"""Page and plot of the identification of a real arm."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from flexman_gym.common.plot_style import BLUE, MIDDLE, new_figure
from studies.machine.measure import COUPLED, CURRENT, FIT, SCORE, FitRow
from studies.screen import picture, screen

STAGE_1_PICTURE = "machine_stage_1.png"
MILLI = 1e3


def draw(lines: Mapping[str, Sequence[Any]], folder: Path) -> None:
    """Plot the runs of the first stage with held-out predictions."""
    rows = (len(lines) + 2) // 3
    figure = new_figure((13.0, 2.3 * rows), 100.0, layout="constrained")
    grid = figure.subplots(rows, 3, squeeze=False).ravel()
    for axes, (name, (times, measured, shown)) in zip(grid, sorted(lines.items()), strict=False):
        _compare(axes, times, MILLI * measured, MILLI * shown)
        axes.set(title=name, xlabel="time (s)", ylabel="deflection (mrad)")
    for axes in grid[len(lines) :]:
        axes.set_visible(False)
    figure.savefig(folder / STAGE_1_PICTURE)


def _compare(axes: Any, times: Any, measured: Any, shown: Any) -> None:
    axes.plot(times, measured, color=MIDDLE, linewidth=2.5, label="measured")
    axes.plot(times, shown, color=BLUE, linewidth=1.0, label="our model")
    axes.legend(frameon=False, fontsize=8)
    axes.spines[["top", "right"]].set_visible(False)


QUESTION = "Does the model predict measurements of a real arm that were not used for the fit?"
ANSWER = """**In {count} runs of one stage, each predicted with parameters fitted to the other half of the runs, the
median R2 of the tip deflection is {median:.3f}, and at least {large:.3f} for steps of 20 and 30 degrees.** The
fitted stiffness is {stiffness:.2f} times that of the data sheet."""
BODY = """{picture}

Measured deflections of a Quanser 2-DoF serial flexible link (two steel strips, geared motors) and held-out
predictions. The input is the measured hub angle. R2 is the explained share of the variance.

| held-out records | stage 1 | stage 2 |
| --- | --- | --- |
| one stage, hub angle given: median R2 | {median:.3f} | |
| both stages, hub angles given: R2 | {first:.3f} | {second:.3f} |
| both stages, motor currents given: R2 of the hub angle | {hub_1:.3f} | {hub_2:.3f} |

With currents alone the second hub drifts away: gear friction takes most of the torque, and its error is integrated
twice. In runs of 5 degrees friction stalls the hub. The logged deflections passed a low-pass filter of 2 Hz, so that
faster vibrations cannot be compared.

The arm is `fm.catalog.quanser_2dsfl()`. Records of the Czech Technical University in Prague, with their licence
(MIT): `scripts/studies/machine/data`."""


def page(rows: Sequence[FitRow], files: Mapping[str, str]) -> str:
    """Return the page as Markdown; `files` is the file of the rows with its comment."""
    scores = {row.run: row.value for row in rows if row.part == SCORE}
    factors = [row.value for row in rows if row.part == FIT and row.what == "EI factor"]
    coupled, driven = ({row.run: row.value for row in rows if row.part == part and row.what == "R2"}
                       for part in (COUPLED, CURRENT))  # fmt: skip
    median = float(np.median(list(scores.values())))
    large = [value for run, value in scores.items() if "20deg" in run or "30deg" in run]
    answer = ANSWER.format(count=len(scores), median=median, large=min(large), stiffness=np.mean(factors))
    body = BODY.format(
        picture=picture("Measured and predicted deflection of the strip over time, one panel per run", STAGE_1_PICTURE),
        median=median, first=coupled["link_deflection_1_y"], second=coupled["link_deflection_2_y"],
        hub_1=driven["motor_angle_1"], hub_2=driven["motor_angle_2"],
    )  # fmt: skip
    return screen("Comparison with a real arm", QUESTION, answer, body, files, "machine")

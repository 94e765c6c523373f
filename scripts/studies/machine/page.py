"""Page and plot of the identification of a real arm."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from flexman_gym.common.plot_style import BLUE, SLATE, save_figure
from studies.charts import new_chart
from studies.machine.measure import COUPLED, CURRENT, FIT, SCORE, FitRow
from studies.screen import picture, screen

STAGE_1_PICTURE = "machine_stage_1.svg"
SHOWN = {  # run in the plot -> step of the hub angle (degrees) and controller
    "hinf_30deg": (30, "H-infinity"),
    "lqg_20deg": (20, "LQG"),
    "hinf_10deg": (10, "H-infinity"),
    "lqg_neg_10deg": (-10, "LQG"),
    "lqg_neg_5deg": (-5, "LQG"),
    "hinf_neg_5deg": (-5, "H-infinity"),
}
MILLI = 1e3


def draw(lines: Mapping[str, Sequence[Any]], folder: Path) -> None:
    """Plot runs of the first stage with held-out predictions: from good ones to the worst, of a small step."""
    figure, panels = new_chart((7.6, 4.4), 2, 3)
    for axes, run in zip(panels.flat, [name for name in SHOWN if name in lines], strict=False):
        times, measured, shown = lines[run]
        axes.plot(times, MILLI * measured, color=SLATE, linewidth=2.5, alpha=0.6, label="measured")
        axes.plot(times, MILLI * shown, color=BLUE, linewidth=1.2, label="computed, with parameters of other runs")
        axes.set_title("Step of {}\N{DEGREE SIGN}, {} control".format(*SHOWN[run]), fontsize=9)
        axes.tick_params(labelsize=8)
    figure.supxlabel("time (s)", fontsize=9)
    figure.supylabel("deflection of the strip (mrad)", fontsize=9)
    figure.legend(*axes.get_legend_handles_labels(), loc="outside upper center", ncols=2, frameon=False, fontsize=9)
    save_figure(figure, folder / STAGE_1_PICTURE)


MESSAGE = "The computed deflection follows the measured one, except in the smallest step"
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
        picture=picture(MESSAGE, STAGE_1_PICTURE),
        median=median, first=coupled["link_deflection_1_y"], second=coupled["link_deflection_2_y"],
        hub_1=driven["motor_angle_1"], hub_2=driven["motor_angle_2"],
    )  # fmt: skip
    return screen("Comparison with a real arm", QUESTION, answer, body, files, "machine")

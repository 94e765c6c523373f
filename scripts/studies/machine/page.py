"""Page and plots of the identification of a real arm."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from flexman_gym.common.markdown import markdown_table
from flexman_gym.draw.style import BLUE, LIGHT, MIDDLE, new_figure
from studies.machine.measure import COUPLED, CURRENT, FIT, HALF, MUJOCO, SCORE, SHEET, FitRow

STAGE_1_PICTURE, STAGES_PICTURE = "machine_stage_1.png", "machine_stages.png"
MILLI = 1e3


def draw(lines: Mapping[str, Sequence[Any]], record: Sequence[Any], folder: Path) -> None:
    """Plot the runs of the first stage with held-out predictions, and the record of both stages."""
    rows = (len(lines) + 2) // 3
    figure = new_figure((13.0, 2.3 * rows), 100.0, layout="constrained")
    grid = figure.subplots(rows, 3, squeeze=False).ravel()
    for axes, (name, (times, measured, shown)) in zip(grid, sorted(lines.items()), strict=False):
        _compare(axes, times, MILLI * measured, MILLI * shown)
        axes.set(title=name, xlabel="time (s)", ylabel="deflection (mrad)")
    for axes in grid[len(lines) :]:
        axes.set_visible(False)
    figure.savefig(folder / STAGE_1_PICTURE)
    times, measured, shown = record
    figure = new_figure((13.0, 5.0), 100.0, layout="constrained")
    for axes, name in zip(figure.subplots(len(shown), 1), shown, strict=True):
        _compare(axes, times, MILLI * np.asarray(measured[name]), MILLI * shown[name])
        axes.axvline(HALF, color=LIGHT, linewidth=3.0)
        axes.set(title=f"{name}: fitted on the left, predicted on the right", xlabel="time (s)", ylabel="mm")
    figure.savefig(folder / STAGES_PICTURE)


def _compare(axes: Any, times: Any, measured: Any, shown: Any) -> None:
    axes.plot(times, measured, color=MIDDLE, linewidth=2.5, label="measured")
    axes.plot(times, shown, color=BLUE, linewidth=1.0, label="our model")
    axes.legend(frameon=False, fontsize=8)
    axes.spines[["top", "right"]].set_visible(False)


PAGE = """# Our model against a machine

A real arm with flexible links was measured elsewhere, and our model predicts records that it was not fitted to. It
explains nearly all of what the tip of one stage does, and the stiffness of the data sheet was nearly right. The worst
are small steps, which stall in friction. From motor currents alone the second hub drifts away, as friction takes most
of the torque. A low-pass in the records hides fast vibrations, so nothing here speaks of them.

A Quanser 2-DoF serial flexible link was measured at the Czech Technical University in Prague: two steel strips in a
horizontal plane, driven through gears. The records and their licence (MIT) are in `scripts/studies/machine/data`. The
arm is `fm.catalog.quanser_2dsfl()`. `python scripts/machine.py --folder docs` writes this page, its pictures and its
rows ([machine.csv](machine.csv)) anew. `--data` takes another folder of runs.

R2 is the part of the variance of a deflection that the model explains. The logged deflections passed a low-pass of 2 Hz
and damping ratio 0.9; so do ours, before they are compared.

## One stage

The measured hub angle goes in, the tip deflection comes out. `fm.fit` finds a factor on the bending stiffness of the
data sheet, a damping ratio and the gain of the strain gauge from half of the runs. The other half is predicted, then
the halves change places.

{fits}

- Held-out R2 is {median:.3f} in the median of {count} runs. It is {large:.3f} at least for steps of 20 and 30 degrees.
- **The data sheet is nearly right.** Its stiffness gives {sheet_frequency:.3g} Hz, with the load behind the strip. With
  our damping it explains {sheet:.2f} of a run in the median. The maker's model is a rigid bar on a hinge spring of
  3 EI / L, with 2.44 Hz. It leaves out that the load turns the end of the strip.
- **From hub to gauge** the amplitude factor is {amplitude:.2f}: the deflection is so many times that of a bar on a
  hinge. The model says {model_amplitude:.2f} for w(L) / L; what is between them is the calibration of the gauge.
- Runs of 5 degrees stall in the friction of the gear. Their deflection is a tenth of a degree.

{scores}

![runs of one stage]({stage_1})

## Both stages

Both hub angles go in, and both links are coupled. The first 5 s are fitted, and the rest is predicted.

{coupled}

- R2 of the second half is {first:.3f} for the first stage and {second:.3f} for the second.
- What the data cannot tell well: behind a low-pass of 2 Hz little is left of vibrations above 4 Hz. So stiffness and
  gain of each strip go together: the runs of one stage tell those of strip 1 better.
- What stands in the way of more: both deflections swing at 2 Hz while the hubs stand still within the friction of
  their gears. The elasticity of the gears, and what the controller does there, are not in the record.

![both stages]({stages})

## Currents in, angles out

The motor currents go in, torque constants, gears and their efficiency are those of the data sheet. Viscous and Coulomb
friction are fitted on the first 5 s. Nothing holds the hub angles to the measured ones.

{currents}

Friction of the gears takes most of the torque, and what is left is integrated twice. So an error of a few percent of
the friction grows to the size of the motion within seconds.

Computed with {computer}, one core.
"""


def page(rows: Sequence[FitRow], computer: str) -> str:
    """Return the page as Markdown."""
    scores = [row for row in rows if row.part == SCORE]
    sheet = {row.run: row.value for row in rows if row.part == SHEET}
    theirs = {row.run: row.value for row in rows if row.part == MUJOCO and row.what == "R2"}
    large = [row.value for row in scores if "20deg" in row.run or "30deg" in row.run]
    fits = {label: {row.what: row.value for row in rows if row.part == FIT and row.run == label} for label in "AB"}
    names = list(fits["A"])
    coupled = {row.run: row.value for row in rows if row.part == COUPLED and row.what == "R2"}
    fitted = [[name, *(f"{fits[label][name]:.4g}" for label in "AB")] for name in names]
    table = [
        [row.run, row.what, f"{row.value:.3f}", f"{sheet[row.run]:.3f}", f"{theirs[row.run]:.3f}" if theirs else "-"]
        for row in sorted(scores, key=lambda row: row.run)
    ]
    return PAGE.format(
        fits=_table(("", "fit A", "fit B"), fitted), median=float(np.median([row.value for row in scores])),
        count=len(scores), large=min(large, default=float("nan")), sheet=float(np.median(list(sheet.values()))),
        sheet_frequency=_mean(fits, "natural frequency, Hz") / np.sqrt(_mean(fits, "EI factor")),
        amplitude=_mean(fits, "amplitude factor, measured"),
        model_amplitude=_mean(fits, "amplitude factor of the model"),
        scores=_table(("run", "fit that predicts it", "R2", "data sheet alone", "MuJoCo's pieces, our numbers"), table),
        stage_1=STAGE_1_PICTURE, stages=STAGES_PICTURE, coupled=_values(rows, COUPLED),
        first=coupled["link_deflection_1_y"], second=coupled["link_deflection_2_y"], currents=_values(rows, CURRENT),
        computer=computer,
    )  # fmt: skip


def _mean(fits: dict[str, dict[str, float]], name: str) -> float:
    return float(np.mean([fit[name] for fit in fits.values()]))


def _values(rows: Sequence[FitRow], part: str) -> str:
    """Return the table of fitted values with their standard deviations, followed by the scores."""
    own = [row for row in rows if row.part == part]
    spread = {row.run: row.value for row in own if row.what == "deviation"}
    lines = [[row.run, f"{row.value:.3g}", f"{spread[row.run]:.2g}"] for row in own if row.what == "value"]
    lines += [[f"R2 of {row.run}, second half", f"{row.value:.3f}", ""] for row in own if row.what == "R2"]
    return _table(("", "value", "deviation"), lines)


def _table(heads: Sequence[str], lines: Sequence[Sequence[str]]) -> str:
    return "\n".join(markdown_table(heads, lines))

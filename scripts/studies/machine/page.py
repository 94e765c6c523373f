"""Page and plots of the identification of a real arm."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from flexman_gym.common.markdown import markdown_table
from flexman_gym.common.plot_style import BLUE, LIGHT, MIDDLE, new_figure
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


PAGE = """# Comparison with a real arm

The model is compared with published measurements of a real arm with flexible links and predicts records that were not
used for the fit. It explains nearly all of the tip motion of a single stage, and the stiffness of the data sheet is
nearly correct. Predictions are worst for small steps, in which friction stalls the hub. From motor currents alone the
second hub drifts away, since friction takes most of the torque. The records are low-pass filtered, so fast vibrations
cannot be compared.

A Quanser 2-DoF serial flexible link was measured at the Czech Technical University in Prague: two steel strips in a
horizontal plane, driven through gears. The records and their licence (MIT) are in `scripts/studies/machine/data`. The
arm is `fm.catalog.quanser_2dsfl()`. `python scripts/machine.py --folder docs/evidence` rewrites this page, its plots
and its rows ([machine.csv](machine.csv)). `--data` selects another folder of runs.

R2 is the share of the variance of a deflection explained by the model. The logged deflections passed a low-pass filter
of 2 Hz and damping ratio 0.9; the computed deflections pass the same filter before the comparison.

## One stage

The input is the measured hub angle, the output the tip deflection. `fm.fit` estimates a factor of the bending stiffness
of the data sheet, a damping ratio and the gain of the strain gauge from half of the runs. The other half is predicted,
then the halves are exchanged.

{fits}

- The median held-out R2 of {count} runs is {median:.3f}. It is at least {large:.3f} for steps of 20 and 30 degrees.
- **The data sheet is nearly correct.** Its stiffness yields {sheet_frequency:.3g} Hz, with the load behind the strip.
  With the fitted damping it explains {sheet:.2f} of the variance in the median. The manufacturer's model is a rigid bar
  on a hinge spring of 3 EI / L, with 2.44 Hz. It neglects the rotation of the end of the strip by the load.
- **From hub to gauge** the measured amplitude factor is {amplitude:.2f}, relative to the deflection of a bar on a
  hinge. The model predicts {model_amplitude:.2f} for w(L) / L; the difference is the calibration of the gauge.
- In runs of 5 degrees the friction of the gear stalls the hub. Their deflection is a tenth of a degree.

{scores}

![runs of one stage]({stage_1})

## Both stages

The inputs are both hub angles, and both links are coupled. The first 5 s are fitted, and the rest is predicted.

{coupled}

- R2 of the second half is {first:.3f} for the first stage and {second:.3f} for the second.
- Stiffness and gain of each strip are strongly correlated, since the low-pass filter of 2 Hz removes most of the
  vibration above 4 Hz. The runs of one stage determine both better for strip 1.
- The accuracy is limited by oscillations of both deflections at 2 Hz while friction holds the hubs. The elasticity of
  the gears and the action of the controller during these times are not recorded.

![both stages]({stages})

## Currents in, angles out

The inputs are the motor currents; torque constants, gear ratios and efficiencies are those of the data sheet. Viscous
and Coulomb friction are fitted to the first 5 s. The measured hub angles are not used as inputs.

{currents}

Friction of the gears takes most of the torque, and the remaining torque is integrated twice. Therefore an error of a
few percent of the friction grows to the size of the motion within seconds.

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
        scores=_table(("run", "predicted by fit", "R2", "data sheet alone", "MuJoCo's pieces, fitted values"), table),
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

"""Pages and plot of the ring-down study: methods and steps, and the accuracy of the default."""

from collections.abc import Mapping, Sequence
from math import isclose
from pathlib import Path
from typing import Any

import numpy as np

from flexman_gym.common.markdown import markdown_table
from flexman_gym.common.plot_style import SLATE, save_figure
from flexman_gym.evaluation.shares import share_text
from studies.charts import new_chart
from studies.methods import line_styles
from studies.ringdown.measure import (
    BENT,
    DURATION,
    EARLY,
    IMPULSE,
    KINDS,
    RELEASE,
    SLEW,
    UNDAMPED,
    WITHIN,
    Errors,
    RingDownRow,
)
from studies.screen import picture, screen

OURS, LOSSY = "flexman_gym", "discrete"  # our code, and the integrator of MuJoCo with numerical damping
SHOWN = ("midpoint_corrected_3", "midpoint_3", "gauss_3", "extrapolated_euler_5", "ros2")  # methods of the plot
COST = "CPU s per simulated s of one arm"
PICTURE = "ring_down.svg"
TITLES = {RELEASE: "Release", IMPULSE: "Impulse at the tip", SLEW: "Slews", UNDAMPED: "Release without damping"}


def draw(rows: Sequence[RingDownRow], folder: Path, default: tuple[str, float]) -> None:
    """Plot a few methods, without steps at which most arms failed; a ring marks the method and step (s) `default`."""
    figure, (panels,) = new_chart((7.6, 4.2), columns=2)
    released = [row for row in rows if row.kind == RELEASE]
    texts = {"energy_median": "error of the energy, relative", "tip_median": "distance of the tip (m)"}
    for axes, (column, text) in zip(panels, texts.items(), strict=True):
        _lines(axes, released, column, default)
        axes.set(xscale="log", yscale="log", xlabel=COST, ylabel=f"median {text}")
    figure.suptitle("Released from deflections up to 5 cm: errors after 3 s against cost", fontsize=11)
    legend = {"loc": "outside lower center", "ncols": 3, "frameon": False, "fontsize": 9}
    figure.legend(*panels[0].get_legend_handles_labels(), **legend)
    save_figure(figure, folder / PICTURE)


def _lines(axes: Any, rows: Sequence[RingDownRow], column: str, default: tuple[str, float]) -> None:
    ours = [row for row in rows if row.code == OURS]
    for name, look in line_styles(SHOWN).items():
        own = [row for row in ours if row.method == name and np.isfinite(getattr(row, column)) and row.failed < 0.5]
        values = [row.cpu for row in own], [getattr(row, column) for row in own]
        axes.plot(*values, **look, linewidth=1.3, markersize=6.0, label=name)
    for row in ours:
        if row.method == default[0] and isclose(row.step, default[1], rel_tol=1e-4):
            ring = {"markersize": 15.0, "markerfacecolor": "none", "markeredgecolor": SLATE, "markeredgewidth": 1.6}
            axes.plot(row.cpu, getattr(row, column), "o", **ring, linestyle="", label="default of the environments")


MESSAGE = "Errors of five methods over cost, after a release; a ring marks the default"
QUESTION = "How well does an integration method preserve the vibration of an arm that is released, at what cost?"
ANSWER = """**The default, `{method}` at {step:.3g} ms, has a median energy error of {energy:.2g} % and a median tip
error of {tip:.2g} mm three seconds after a release ({arms:g} arms); `ros2` at 5 ms has {old_energy:.2g} % and
{old_tip:.3g} mm.**"""
BODY = """{picture}

{arms:g} arms of `FlexRRR-v0` ({few:g} for methods without batch kernels) start in random postures, motors free, tips
of all links deflected by up to 5 cm. The reference is `dop853` at a tolerance of 1e-8 with the same model. The energy
error is relative to the energy of the reference at the end or, if this is larger, to 2 % of the energy at the start.

- Without damping of the arm the median energy error of the default is {free:.2g} %, that of `ros2` {old_free:.2g} %.
- Explicit methods fail on {failed} released arms at every tested step.{mujoco}

[Accuracy](accuracy.md) has more arms, other medians, and the bound of the energy error."""
MUJOCO = """
- MuJoCo's `{name}` at {step:.3g} ms retains {kept:.2g} of the energy of an undamped arm of rigid pieces (exact: 1;
  {arms:g} arms)."""


def page(rows: Sequence[RingDownRow], default: tuple[str, float], files: Mapping[str, str]) -> str:
    """Return the page of all methods as Markdown; `files` is the file of the rows with its comment."""

    def of(kind: str, method: str, step: float) -> RingDownRow:
        named = [row for row in rows if (row.kind, row.method) == (kind, method)]
        return next(row for row in named if isclose(row.step, step, rel_tol=1e-4))

    now, before = of(RELEASE, *default), of(RELEASE, "ros2", 0.005)
    explicit = [row for row in rows if row.kind == RELEASE and row.method in ("semi_implicit_euler", "rk4", "dopri5")]
    lossy = min((row for row in rows if row.method == LOSSY and row.failed == 0.0), key=_kept, default=None)
    answer = ANSWER.format(method=default[0], step=1e3 * default[1], energy=1e2 * now.energy_median,
                           tip=1e3 * now.tip_median, old_energy=1e2 * before.energy_median,
                           old_tip=1e3 * before.tip_median, arms=now.arms)  # fmt: skip
    share = min(row.failed for row in explicit)
    body = BODY.format(
        picture=picture(MESSAGE, PICTURE),
        free=1e2 * of(UNDAMPED, *default).energy_median, old_free=1e2 * of(UNDAMPED, "ros2", 0.005).energy_median,
        failed="all" if share == 1.0 else f"at least {share:.0%} of the",
        arms=now.arms, few=min(row.arms for row in explicit),
        mujoco="" if lossy is None else MUJOCO.format(name=lossy.method, step=1e3 * lossy.step, kept=lossy.kept,
                                                      arms=lossy.arms),
    )  # fmt: skip
    return screen("Released vibrations", QUESTION, answer, body, files, "ring_down")


def _kept(row: RingDownRow) -> float:
    return row.kept


ACCURACY_QUESTION = "How accurate are the method and the step that an environment uses by default?"
ACCURACY_ANSWER = """**With `{method}` at {step:.3g} ms the tip of half of the arms is within {slew:.2g} mm after a
slew and within {impulse:.2g} mm after an impulse; a strong release costs {released:.2g} to {bent:.2g} mm ({arms:g}
arms each).** Of released arms the energy is within {limit:.0%} for {least:.0%} or more after 3 s, and for {early:.0%}
to {early_most:.0%} after 1 s."""
ACCURACY_BODY = """{table}

{arms:g} arms of `FlexRRR-v0` for each motion. *Release*: the tips of all links from up to 5 cm, in any posture.
*Both planes*: up to 5 cm in each plane, nearly stretched. *Impulse*: up to 50 N s. *Slew*: random torques up to 300
N m. The errors are those of the method alone; the reference is `dop853` with the same model.

The method has no numerical damping: the amplitude of an undamped vibration of the linear arm neither decays nor
grows, but oscillates by at most (omega h)^2 / 12, its energy by at most (omega h)^2 / 6 ([stability](stability.md)).
Its correction of the phase error does not contain Coulomb friction or centrifugal softening. `gym.make("FlexRRR-v0",
step=0.005)` shortens the step, and `fidelity="auto"` with a tolerance chooses anew: [choices](fidelity.md). Rows of
{others} more methods and steps are stored."""
ACCURACY_HEADS = ("motion", "after", "energy within 2 % (95 % interval)", "tip, half of the arms", "90 %", "95 %")


def accuracy_page(rows: Sequence[Errors], files: Mapping[str, str]) -> str:
    """Return the page of the default as Markdown; `files` is the file of the rows with its comment."""
    first, names = rows[0], {(row.method, row.step) for row in rows}
    own = {(row.kind, row.time): row for row in rows if (row.method, row.step) == (first.method, first.step)}
    cells = [_accuracy(own[kind, time]) for kind in KINDS for time in (EARLY, DURATION[kind])
             if kind in (RELEASE, BENT) or time > EARLY]  # fmt: skip
    slew, impulse, released, bent = (own[kind, DURATION[kind]] for kind in (SLEW, IMPULSE, RELEASE, BENT))
    early = [own[kind, EARLY].within for kind in (RELEASE, BENT)]
    answer = ACCURACY_ANSWER.format(
        method=first.method, step=1e3 * first.step, slew=1e3 * slew.tip_median, impulse=1e3 * impulse.tip_median,
        released=1e3 * released.tip_median, bent=1e3 * bent.tip_median, limit=WITHIN,
        least=min(released.within, bent.within), arms=min(row.arms for row in own.values()),
        early=min(early), early_most=max(early),
    )  # fmt: skip
    table = "\n".join(markdown_table(ACCURACY_HEADS, cells))
    body = ACCURACY_BODY.format(table=table, arms=first.arms, others=len(names) - 1)
    return screen("Accuracy of the default", ACCURACY_QUESTION, answer, body, files, "accuracy")


def _accuracy(row: Errors) -> tuple[str, ...]:
    tips = (f"{1e3 * tip:.2g} mm" for tip in (row.tip_median, row.tip_90, row.tip_95))
    return row.kind, f"{row.time:g} s", share_text(row.within, row.arms), *tips

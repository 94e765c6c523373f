"""Page and plot of the ring-down study."""

from collections.abc import Sequence
from math import isclose
from pathlib import Path
from typing import Any

import numpy as np

from flexman_gym.common.markdown import markdown_table
from flexman_gym.common.plot_style import DARK, LIGHT, MIDDLE, new_figure
from studies.methods import line_styles, methods_of
from studies.ringdown.measure import IMPULSE, RELEASE, SLEW, UNDAMPED, RingDownRow

COST = "CPU seconds per simulated second of one arm"
GREYS = {"Euler": "x", "RK4": "d", "implicitfast": "+", "discrete": "."}  # markers of MuJoCo's integrators
PICTURE = "ring_down.png"


def draw(rows: Sequence[RingDownRow], folder: Path, default: tuple[str, float]) -> None:
    """Plot the study; `default` is the method and step (s) of the environments, marked with a ring."""
    figure = new_figure((13.0, 5.2), 110.0, layout="constrained")
    panels = figure.subplots(1, 3)
    released = [row for row in rows if row.kind == RELEASE]
    _lines(panels[0], released, "energy_median", default)
    panels[0].set(title="Energy after 3 s", ylabel="median error, relative to the reference energy")
    _lines(panels[1], released, "tip_median", default)
    panels[1].set(title="Tip after 3 s", ylabel="median distance from the reference (m)")
    undamped = [row for row in rows if row.kind == UNDAMPED]
    _lines(panels[2], undamped, "energy_median", default)
    panels[2].set(title="Energy of an arm without damping, after 3 s", ylabel="median error, relative to the start")
    figure.suptitle("Released from deflections up to 5 cm: errors after 3 s against cost", fontsize=13)
    entries: dict[str, Any] = {}
    for axes in panels:
        axes.set(xscale="log", yscale="log", xlabel=COST)
        axes.grid(color=LIGHT, linewidth=0.6)
        axes.spines[["top", "right"]].set_visible(False)
        entries |= {label: handle for handle, label in zip(*axes.get_legend_handles_labels(), strict=True)}
    figure.legend(entries.values(), entries.keys(), loc="outside right center", frameon=False, fontsize=8)
    figure.savefig(folder / PICTURE)


def _lines(axes: Any, rows: Sequence[RingDownRow], column: str, default: tuple[str, float]) -> None:
    ours = [row for row in rows if row.code == "flexman_gym"]
    for name in methods_of(ours):
        look = line_styles()[name]
        _line(axes, [row for row in ours if row.method == name], column, name, look.colour, look.marker)
    for row in ours:
        if row.method == default[0] and isclose(row.step, default[1], rel_tol=1e-4):
            ring = {"markersize": 15.0, "markerfacecolor": "none", "markeredgecolor": DARK, "markeredgewidth": 1.6}
            axes.plot(row.cpu, getattr(row, column), "o", **ring, linestyle="", label="default of the environments")
    for name, marker in GREYS.items():
        theirs = [row for row in rows if row.code != "flexman_gym" and row.method == name]
        label = f"{theirs[0].code}, {name}" if theirs else name
        _line(axes, theirs, column, label, MIDDLE, marker)


def _line(axes: Any, rows: Sequence[RingDownRow], column: str, label: str, colour: str, marker: str) -> None:
    """Plot the runs of one method over their cost, without those in which most arms failed."""
    good = [row for row in rows if np.isfinite(getattr(row, column)) and row.failed < 0.5]
    if good:
        values = [row.cpu for row in good], [getattr(row, column) for row in good]
        axes.plot(*values, marker=marker, color=colour, linewidth=1.0, markersize=6.0, label=label)


PAGE = """# Ring-down: energy errors of integration methods

Arms are released from a deflection, hit or driven, and after a few seconds each method is compared with a reference
solution. The default preserves the energy of a released vibration to a few percent in most cases. `ros2` at 5 ms has
large errors, and MuJoCo's `discrete` integrator dissipates nearly all of the energy. Explicit methods fail on released
arms at every tested step.

`python scripts/ring_down.py --folder docs/evidence` rewrites this page, its plot and its rows
([ring_down.csv](ring_down.csv)).

Arms of `FlexRRR-v0` start in random postures with free motors. In a *release* the tips of all links are deflected by up
to 5 cm. An *impulse* of up to 50 N s acts on the tip. A *slew* has random torques up to 300 N m. The reference is
`dop853` at a tolerance of 1e-8 with the same model, so that the method alone causes the errors. The energy error is
relative to the reference energy at the end or, if this is larger, to 2 % of the energy at the start.

![energy and tip over cost]({picture})

{conclusion}

{tables}
"""
CONCLUSION = """- **The default, `{method}` at {step:.3g} ms,** is evaluated on more arms in [accuracy.md](accuracy.md).
  The number of arms here is too small for the worst 10 %.
- **`ros2` at 5 ms** has median errors of {old:.3g} mm at the tip and {old_energy:.3g} % in the energy after a release.
- **Without damping** the median energy error of the default is {free:.2g} %, and {failed:.0%} of its arms fail.
  With `ros2` at 5 ms it is {old_free:.2g} %, and {old_failed:.0%} fail.{mujoco}"""
MUJOCO = """
- **MuJoCo's `{name}`** at {step:.3g} ms retains {kept:.2g} of the energy of its arm of rigid pieces (exact: 1)."""
HEADS = (
    "method",
    "step, ms",
    "CPU, us",
    "energy, %",
    "90 %",
    "99 %",
    "tip, mm",
    "90 %",
    "95 %",
    "99 %",
    "kept",
    "failed",
)
TITLES = {
    RELEASE: "Release", IMPULSE: "Impulse at the tip", SLEW: "Slews", UNDAMPED: "Release without damping",
}  # fmt: skip


def page(rows: Sequence[RingDownRow], computer: str, default: tuple[str, float]) -> str:
    """Return the page as Markdown."""
    tables = [
        f"Computed with {computer}, one core. CPU is the CPU time of one arm per simulated second. That of the "
        "corrected midpoint rules is the CPU time of the midpoint rules times 1.18, the ratio measured in turns."
    ]
    for kind, title in TITLES.items():
        result = [_cells(row) for row in rows if row.kind == kind]
        tables += [f"## {title}", "\n".join(markdown_table(HEADS, result))]
    return PAGE.format(picture=PICTURE, conclusion=_conclusion(rows, default), tables="\n\n".join(tables))


def _conclusion(rows: Sequence[RingDownRow], default: tuple[str, float]) -> str:
    """Return the conclusions about the default, ros2 and MuJoCo's integrators."""

    def of(kind: str, method: str, step: float) -> RingDownRow:
        named = [row for row in rows if (row.kind, row.method) == (kind, method)]
        return next(row for row in named if isclose(row.step, step, rel_tol=1e-4))

    now = {kind: of(kind, *default) for kind in TITLES}
    before, worn = of(RELEASE, "ros2", 0.005), of(UNDAMPED, "ros2", 0.005)
    lossy = min((row for row in rows if row.method == "discrete" and row.failed == 0.0), key=_kept, default=None)
    mujoco = "" if lossy is None else MUJOCO.format(name=lossy.method, step=1e3 * lossy.step, kept=lossy.kept)
    return CONCLUSION.format(
        method=default[0], step=1e3 * default[1],
        old=1e3 * before.tip_median, old_energy=1e2 * before.energy_median,
        free=1e2 * now[UNDAMPED].energy_median, failed=now[UNDAMPED].failed,
        old_free=1e2 * worn.energy_median, old_failed=worn.failed, mujoco=mujoco,
    )  # fmt: skip


def _kept(row: RingDownRow) -> float:
    return row.kept


def _cells(row: RingDownRow) -> list[str]:
    name = row.method if row.code == "flexman_gym" else f"{row.code}, {row.method}"
    energies = [f"{1e2 * value:.3g}" for value in (row.energy_median, row.energy_90, row.energy_99)]
    tips = [f"{1e3 * value:.3g}" for value in (row.tip_median, row.tip_90, row.tip_95, row.tip_99)]
    return [
        name,
        f"{1e3 * row.step:.3g}",
        f"{1e6 * row.cpu:.4g}",
        *energies,
        *tips,
        f"{row.kept:.4g}",
        f"{row.failed:.0%}",
    ]

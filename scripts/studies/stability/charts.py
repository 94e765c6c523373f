"""Stability charts (PNG): maps, step limits, numerical damping and energy drift."""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from flexman_gym.common.plot_style import DARK, LIGHT, MIDDLE, RED, SKY, YELLOW, new_figure
from flexman_gym.simulation.methods import METHODS
from studies.methods import line_styles, methods_of
from studies.stability.measure import (
    CASES,
    DIVERGED,
    FULL_MODES,
    INACCURATE,
    MODES,
    NOT_CONVERGED,
    OK,
    PAYLOAD,
    SPIN,
    SPIN_STIFFENED,
    SPRINGS,
    StabilityRow,
    select,
)
from studies.stability.rows import DAMPING, DRIFT, ERROR, KEPT, LIMIT, LIMIT_STUDIES, THRESHOLD

COLUMNS = 3  # columns of panels in a map
CROSS = "\u00d7"
COLOURS = {OK: SKY, INACCURATE: YELLOW, DIVERGED: RED, NOT_CONVERGED: MIDDLE}
MARKS = {OK: "", INACCURATE: "~", DIVERGED: CROSS, NOT_CONVERGED: "?"}
LABELS = {
    SPRINGS: "stiffness of every joint spring (N m/rad)",
    MODES: "loaded modes per link",
    PAYLOAD: "payload (kg)",
    SPIN: "spin rate (rad/s)",
    SPIN_STIFFENED: "spin rate (rad/s)",
}
TITLES = {
    SPRINGS: "The paper's arm, 4 loaded modes a link, 0.2 s from rest under 400 N m a joint",
    MODES: "The paper's arm on springs of 5000 N m/rad, 0.2 s from rest under 400 N m a joint",
    PAYLOAD: "The paper's arm with a payload, 4 loaded modes a link, 0.2 s from rest under 400 N m a joint",
    SPIN: "One link spun at a constant rate for 1 s, bent by 1 cm: linear frame, without stiffening",
    SPIN_STIFFENED: "One link spun at a constant rate for 1 s, bent by 1 cm: with stiffening",
}
VERDICTS = {
    OK: f"tip within {1e3 * THRESHOLD:g} mm",
    INACCURATE: f"~ tip more than {1e3 * THRESHOLD:g} mm off",
    DIVERGED: f"{CROSS} diverged",
    NOT_CONVERGED: "? iteration not converged",
}


def picture(study: str) -> str:
    """Return the file name of the chart of a study."""
    return f"stability_{study.replace(' ', '_')}.png"


def draw(rows: Sequence[StabilityRow], folder: Path) -> list[Path]:
    """Plot all charts into a folder; return the paths.

    Raises:
        ImportError: without Matplotlib.
    """
    paths = []
    for study, chart in CHARTS.items():
        path = folder / picture(study.split(",")[0])
        chart(study, rows).savefig(path)
        paths.append(path)
    return paths


def _map(study: str, rows: Sequence[StabilityRow]) -> Any:
    """Plot a stability map: a panel per method, a column per parameter value, a row per step."""
    cells = select(rows, study=study, quantity=ERROR)
    parameters = sorted({row.parameter for row in cells})
    steps = sorted({row.step for row in cells})
    names = methods_of(cells)
    lines = -(-len(names) // COLUMNS)
    figure = new_figure((12.0, 3.5 * lines), 110.0, layout="constrained")
    panels = list(figure.subplots(lines, COLUMNS, sharex=True, sharey=True, squeeze=False).flat)
    for axes in panels[len(names) :]:
        axes.set_visible(False)
    for axes in panels[max(0, len(names) - COLUMNS) : len(names)]:  # panels without a panel below
        axes.tick_params(labelbottom=True)
    for axes, name in zip(panels, names, strict=False):
        for row in select(cells, method=name):
            x, y = parameters.index(row.parameter), steps.index(row.step)
            axes.add_patch(_cell(x, y, COLOURS[row.verdict]))
            axes.text(x, y, MARKS[row.verdict], ha="center", va="center", fontsize=9, color=DARK)
        for row in select(rows, study=study, method=name, quantity=LIMIT):
            x, unit = parameters.index(row.parameter), np.log2(np.array([row.expected, row.value]) / steps[0])
            axes.plot([x - 0.5, x + 0.5], [unit[0]] * 2, color=DARK, linewidth=2.2)
            axes.plot(x, unit[1], "o", color="white", markeredgecolor=DARK, markersize=6)
        axes.set_title(f"{name} ({METHODS[name].kind}, order {METHODS[name].order})", fontsize=10)
        axes.set(xlim=(-0.5, len(parameters) - 0.5), ylim=(-0.5, len(steps) - 0.5))
        axes.set_xticks(range(len(parameters)), [_tick(study, value) for value in parameters], fontsize=8)
        axes.set_yticks(range(len(steps)), [f"{1e3 * step:.3g}" for step in steps], fontsize=8)
    middle = panels[1 : len(names) : COLUMNS] or panels
    middle[-1].set_xlabel(LABELS[study], fontsize=12)
    figure.supylabel("step (ms)")
    figure.suptitle(TITLES[study], fontsize=13)
    figure.legend(handles=_keys(study), loc="outside lower center", ncols=6, frameon=False)
    return figure


def _cell(x: float, y: float, colour: str) -> Any:
    from matplotlib.patches import Rectangle

    return Rectangle((x - 0.5, y - 0.5), 1.0, 1.0, facecolor=colour, edgecolor="white", linewidth=1.0)


def _keys(study: str) -> list[Any]:
    """Return the legend entries of a map."""
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    keys: list[Any] = [Patch(facecolor=COLOURS[verdict], label=text) for verdict, text in VERDICTS.items()]
    if study in LIMIT_STUDIES:
        keys.append(Line2D([], [], color=DARK, linewidth=2.2, label="predicted limit"))
        keys.append(Line2D([], [], marker="o", color="white", markeredgecolor=DARK, label="measured limit"))
    return keys


def _tick(study: str, value: float) -> str:
    if study == MODES and value == FULL_MODES:
        return "full"
    return f"$10^{{{np.log10(value):.3g}}}$" if study == SPRINGS else f"{value:g}"


def _limits(_: str, rows: Sequence[StabilityRow]) -> Any:
    """Plot the largest stable step against the parameter of each study: lines predicted, markers measured."""
    known = line_styles()
    figure = new_figure((12.0, 4.6), 110.0, layout="constrained")
    for axes, study in zip(figure.subplots(1, 3, sharey=True), LIMIT_STUDIES, strict=True):
        result = select(rows, study=study, quantity=LIMIT)
        places = sorted({row.parameter for row in result})
        for name in methods_of(result):
            own = select(result, method=name)
            x = [places.index(row.parameter) for row in own]
            colour, marker = known[name]
            axes.semilogy(x, [1e3 * (row.expected or np.nan) for row in own], color=colour, label=f"{name}, predicted")
            axes.semilogy(x, [1e3 * row.value for row in own], marker, color=colour, label="measured")
        axes.set_xticks(range(len(places)), [_tick(study, value) for value in places])
        axes.set_xlabel(LABELS[study])
        _frame(axes)
    figure.get_axes()[0].set_ylabel("largest stable step (ms)")
    figure.suptitle(
        "Explicit limits: predicted c / highest natural frequency, and measured over 2000 steps", fontsize=13
    )
    figure.legend(*axes.get_legend_handles_labels(), loc="outside lower center", ncols=6, frameon=False)
    return figure


def _damping(_: str, rows: Sequence[StabilityRow]) -> Any:
    """Plot tables of the remaining amplitude: methods by steps, for two arms and three modes."""
    from matplotlib.colors import LinearSegmentedColormap

    shades = LinearSegmentedColormap.from_list("kept", [YELLOW, "#ffffff", SKY])
    names = methods_of(select(rows, quantity=KEPT))
    figure = new_figure((16.0, 2.3 + 0.7 * len(names)), 100.0, layout="constrained")
    panels = figure.subplots(2, 3, sharex=True, sharey=True)
    for line, inertia in zip(panels, ("1", "10"), strict=True):
        for axes, mode in zip(line, (1.0, 2.0, 3.0), strict=True):
            result = select(rows, study=f"{DAMPING} {inertia}", parameter=mode, quantity=KEPT)
            steps = sorted({row.step for row in result})
            for row in result:
                x, y = steps.index(row.step), names.index(row.method)
                shade: Any = LIGHT if np.isnan(row.value) else shades(np.clip(0.5 * row.value, 0.0, 1.0))
                axes.add_patch(_cell(x, y, shade))
                axes.text(x, y, _share(row), ha="center", va="center", fontsize=9, color=DARK)
            axes.set_title(f"rotors {inertia} kg m², mode {mode:g}", fontsize=11)
            axes.set_xticks(range(len(steps)), [f"{1e3 * step:g}" for step in steps])
            axes.set_yticks(range(len(names)), names)
            axes.set(xlim=(-0.5, len(steps) - 0.5), ylim=(len(names) - 0.5, -0.5))
    figure.supxlabel("step (ms)")
    figure.suptitle(
        f"Amplitude (%) left after 10 s of an undamped vibration, exact: 100; {CROSS}: the run diverged", fontsize=13
    )
    return figure


def _share(row: StabilityRow) -> str:
    if np.isnan(row.value):
        return CROSS
    percent = 100.0 * row.value
    if percent < 0.1:
        text = "< 0.1"
    elif percent > 1000.0:
        text = "> 1000"
    else:
        text = f"{percent:.1f}" if percent < 99.95 or percent >= 100.05 else "100"
    return text + f" {CROSS}" * (row.verdict == DIVERGED)


def _drift(_: str, rows: Sequence[StabilityRow]) -> Any:
    """Plot the largest energy error against the number of steps."""
    figure = new_figure((8.5, 5.4), 110.0, layout="constrained")
    axes = figure.subplots()
    result, known = select(rows, study=DRIFT), line_styles()
    for name in methods_of(result):
        own = select(result, method=name)
        colour, marker = known[name]
        axes.loglog([row.parameter for row in own], [row.value for row in own], marker + "-", color=colour, label=name)
    axes.set(xlabel="steps of 1 ms", ylabel="largest energy error so far (relative)")
    axes.set_title("Energy of the free, undamped arm in a long run (lines that end early failed)")
    axes.legend(loc="center left", bbox_to_anchor=(1.0, 0.5), frameon=False)
    _frame(axes)
    return figure


def _frame(axes: Any) -> None:
    axes.grid(color=LIGHT, linewidth=0.6)
    axes.spines[["top", "right"]].set_visible(False)


CHARTS: dict[str, Callable[[str, Sequence[StabilityRow]], Any]] = {study: _map for study in CASES}
CHARTS |= {LIMIT: _limits, DAMPING: _damping, DRIFT: _drift}

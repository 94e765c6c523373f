"""Charts of a league: heat map of agents and scenarios, and the settled share over the values of each sweep."""

from pathlib import Path
from textwrap import fill
from typing import Any, NamedTuple

import numpy as np

from flexman_gym.common.arrays import Array
from flexman_gym.common.plot_style import BLUE, DARK, GREEN, LIGHT, PURPLE, RED, SLATE, new_figure, save_figure
from flexman_gym.evaluation.agent_info import INFORMATION, describe_agent
from flexman_gym.evaluation.agent_spec import SIMPLE_AGENTS
from flexman_gym.evaluation.metrics import METRICS
from flexman_gym.toolbox.league.details import short_name, sweep_text
from flexman_gym.toolbox.league.rows import REFERENCE_AGENTS
from flexman_gym.toolbox.league.scenarios import GIVEN, find_scenario
from flexman_gym.toolbox.league.standings import Standings

CHART, SWEEP_CHART = "league.svg", "sweeps.svg"
ORDER = [*reversed(INFORMATION)]  # information given to the agents, from the least
CELL_COLOURS, CELL_INK = ("#d5dde6", "#7fb2d3", BLUE), "#1b2430"  # from no to all episodes; text on light cells
LINE_COLOURS = (SLATE, BLUE, RED, GREEN, PURPLE)  # contrast of at least 3 on white and on the dark page
LINE_WIDTHS = (4.2, 3.4, 2.6, 1.8, 1.0)  # points; lines that coincide remain visible
COLUMNS, DPI = 2, 100.0  # panels side by side; pixels per inch of a raster image
LABEL_DISTANCE = 0.1  # fraction of the height of a panel between two labels


def draw_charts(standings: Standings, folder: Path, sweeps_only: bool = False) -> list[Path]:
    """Draw the heat map and the sweeps, as far as there are rows; return the paths of the pictures.

    Args:
        standings: comparison of the agents.
        folder: folder of the pictures.
        sweeps_only: True to leave out the heat map.

    Raises:
        ImportError: without Matplotlib.
    """
    paths = []
    if standings.scenarios and not sweeps_only and set(standings.agents) - set(SIMPLE_AGENTS):
        paths.append(_draw_heat_map(standings, folder / CHART))
    if standings.sweeps:
        paths.append(_draw_sweeps(standings, folder / SWEEP_CHART))
    return paths


def _draw_heat_map(standings: Standings, path: Path) -> Path:
    """Draw the settled shares of all agents in all scenarios, and RMS errors of moving goals; return the path."""
    from matplotlib.colors import LinearSegmentedColormap

    names, agents = standings.scenarios, agents_by_information(standings)
    figure = new_figure((2.2 + 0.38 * len(names), 1.1 + 0.34 * len(agents)), DPI, layout="constrained")
    axes, shades = figure.add_subplot(), LinearSegmentedColormap.from_list("shares", CELL_COLOURS)
    for i, agent in enumerate(agents):
        for j, name in enumerate(names):
            cell = result_cell(standings, agent, name)
            if not cell.number:
                continue
            colour = CELL_INK if cell.shade < 0.6 else "white"
            axes.bar(j, 0.92, 0.94, bottom=i - 0.46, color=shades(cell.shade))
            axes.text(j, i - 0.2 * bool(cell.time), cell.number, ha="center", va="center", fontsize=9, color=colour)
            axes.text(j, i + 0.24, cell.time, ha="center", va="center", fontsize=7.5, color=colour)
    labels = [short_name(name) + ("" if find_scenario(name).has_settling else " (mm)") for name in names]
    axes.set_xticks(range(len(names)), labels, rotation=50, ha="left", rotation_mode="anchor", fontsize=8.5)
    axes.set_yticks(range(len(agents)), agents, fontsize=9)
    axes.set(xlim=(-0.5, len(names) - 0.5), ylim=(len(agents) - 0.5, -0.5))
    axes.tick_params(which="both", length=0, top=False, bottom=False, labeltop=True, labelbottom=False)
    axes.spines[:].set_visible(False)
    groups = [describe_agent(each).kind for each in agents]
    for group in dict.fromkeys(groups):
        own = [i for i, each in enumerate(groups) if each == group]
        axes.axhline(own[0] - 0.5, color=DARK, linewidth=0.8)
        axes.text(len(names) - 0.4, np.mean(own), fill(group, 13), va="center", fontsize=8, color=DARK)
    return save_figure(figure, path)


def agents_by_information(standings: Standings) -> list[str]:
    """Return the agents, without the simple ones, in the order of the information given to them."""
    agents = [each for each in standings.agents if each not in SIMPLE_AGENTS]
    return sorted(agents, key=lambda each: ORDER.index(describe_agent(each).kind))


class ResultCell(NamedTuple):
    """Result of an agent in a scenario.

    Attributes:
        shade: share of settled episodes; for a moving goal the RMS error of the reference agent divided by that of the
            agent, at most 1; nan without rows.
        number: settled episodes, %, or median RMS error, mm; "" without rows.
        time: median settling time, s; "" if it is infinite and for a moving goal.
    """

    shade: float
    number: str
    time: str


def result_cell(standings: Standings, agent: str, scenario: str) -> ResultCell:
    """Return the result of an agent in a scenario."""
    if standings.why(agent, scenario):
        return ResultCell(np.nan, "", "")
    if find_scenario(scenario).has_settling:
        settled, time = standings.settled(agent, scenario)
        return ResultCell(settled, f"{100.0 * settled:.0f}", f"{-time:.2f}" if np.isfinite(time) else "")
    own, best = (_rms_error(standings, each, scenario) for each in (agent, REFERENCE_AGENTS[1]))
    shade = 1.0 if own <= best else best / own
    return ResultCell(shade, f"{1e3 * own:.2g}" if own < 0.1 else f"{1e3 * own:.0f}", "")


def _rms_error(standings: Standings, agent: str, scenario: str) -> float:
    """Return the median RMS error of an agent, m."""
    values = [*standings.values(agent, scenario, "rms_error").values()]
    return METRICS["rms_error"].aggregate(np.array(values)) if values else np.nan


def _draw_sweeps(standings: Standings, path: Path) -> Path:
    """Draw a panel for each sweep, with a labelled line for each agent; return the path."""
    agents, sweeps = standings.swept_agents(), standings.sweeps
    rows = -(-len(sweeps) // COLUMNS)
    figure = new_figure((7.6, 1.9 * rows), DPI, layout="constrained")
    panels = np.atleast_1d(figure.subplots(rows, COLUMNS, squeeze=False)).ravel()
    for axes, (name, values) in zip(panels, sweeps.items(), strict=False):
        lines = {agent: _shares(standings, agent, values) for agent in agents}
        _draw_sweep(axes, np.array([*values.values()]), lines)
        given = "given" if name.endswith(GIVEN) else ""
        where = short_name(name.removesuffix(GIVEN)).rpartition("/")[0]
        axes.set_title(", ".join(filter(None, [sweep_text(name), where, given])), fontsize=9, loc="left", color=SLATE)
    for axes in panels[len(sweeps) :]:
        axes.set_visible(False)
    figure.supylabel("settled episodes, %", fontsize=9)
    return save_figure(figure, path)


def _shares(standings: Standings, agent: str, scenarios: dict[str, float]) -> Array:
    """Return the settled shares of an agent in percent, (k,); nan without rows."""
    return np.array(
        [np.nan if standings.why(agent, each) else 100.0 * standings.settled(agent, each)[0] for each in scenarios]
    )


def _draw_sweep(axes: Any, values: Array, lines: dict[str, Array]) -> None:
    """Draw settled shares (k,) of agents over values (k,), each line with its label at its right end."""
    places = np.arange(len(values))  # equidistant: values of noise differ by factors
    for (agent, shares), colour, width in zip(lines.items(), LINE_COLOURS, LINE_WIDTHS, strict=False):
        if np.isfinite(shares).any():
            axes.plot(places, shares, color=colour, marker="o", markersize=width + 1.0, linewidth=width, label=agent)
    drawn = axes.get_lines()
    ends = np.array([line.get_ydata()[np.isfinite(line.get_ydata())][-1] for line in drawn])
    for line, height in zip(drawn, _spread_labels(ends / 100.0, LABEL_DISTANCE), strict=True):
        place = {"transform": axes.get_yaxis_transform(), "va": "center", "fontsize": 8}
        axes.text(1.02, 100.0 * height, line.get_label(), color=line.get_color(), **place)
    axes.set(ylim=(-4.0, 104.0), xlim=(-0.2, len(values) - 0.8))
    axes.set_xticks(places, [f"{value:g}" for value in values], fontsize=8.5)
    axes.tick_params(axis="y", labelsize=8.5)
    axes.grid(color=LIGHT, linewidth=0.6)
    axes.spines[["top", "right"]].set_visible(False)


def _spread_labels(heights: Array, distance: float) -> Array:
    """Return heights (k,) between 0 and 1 at least a distance apart, near the given heights (k,) and in their order."""
    order = np.lexsort((-np.arange(len(heights)), heights))  # of equal heights, the first is at the top
    result, top = np.array(heights, dtype=float), 1.0
    for i in order[::-1]:
        result[i] = top = min(result[i], top)
        top -= distance
    bottom = 0.0
    for i in order:
        result[i] = max(result[i], bottom)
        bottom = result[i] + distance
    return result

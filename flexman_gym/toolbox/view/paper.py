"""Figures 6 to 11 of the paper: differences between the flexible and the rigid arm, as curves and as plots.

The paper is "Dynamic modeling and simulation of spatial manipulator with flexible links and joints".
"""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from flexman_gym.common.arrays import Array
from flexman_gym.common.errors import value_error
from flexman_gym.common.files import write_csv
from flexman_gym.common.plot_style import BLUE, LIGHT, MIDDLE, RED, new_figure, save_figure
from flexman_gym.simulation.trajectory import Trajectory

PAPER_CASES = {  # case of `fm.catalog.paper_scene` -> its name
    "rr": "rigid links, rigid joints",
    "fr": "flexible links, rigid joints",
    "ff": "flexible links and joints",
}
FLEXIBLE_CASES = ("fr", "ff")
FIGURES = range(6, 12)  # numbers of the figures with results; 6 to 8 are of the tip, 9 to 11 of the joints


def paper_curves(trajectories: Mapping[str, Trajectory], figure: int) -> dict[str, tuple[Array, Array]]:
    """Return the curves of a figure of the paper: flexible case -> times (T,), s, and differences (T,).

    The difference is that between the flexible and the rigid arm: of the tip position along x, y or z in Figures 6 to
    8, m; of the link-side angle of joint 1, 2 or 3 in Figures 9 to 11, rad. A curve ends where one of its two
    simulations ended.

    Args:
        trajectories: simulations of the cases "rr", "fr" and "ff", at the same output times.
        figure: number of the figure, 6 to 11.
    """
    rigid, column = trajectories["rr"], FIGURES.index(figure)
    result = {}
    for case in FLEXIBLE_CASES:
        rows = min(len(rigid.time), len(trajectories[case].time))
        difference = _column(trajectories[case], column)[:rows] - _column(rigid, column)[:rows]
        result[case] = rigid.time[:rows], difference
    return result


def figure_name(figure: int) -> str:
    """Return number and quantity of a figure of the paper, such as "Figure 6: tip, x"."""
    column = FIGURES.index(figure)
    return f"Figure {figure}: " + (f"tip, {'xyz'[column]}" if column < 3 else f"joint angle {column - 2}")


def figure_unit(figure: int) -> str:
    """Return the unit of the curves of a figure of the paper, m or rad."""
    return "m" if FIGURES.index(figure) < 3 else "rad"


def paper_figures(
    rigid: Trajectory,
    flexible_links: Trajectory,
    flexible_both: Trajectory,
    folder: str | Path,
    figures: Sequence[int] = FIGURES,
) -> list[Path]:
    """Plot Figures 6 to 11 of the paper, each as a PNG, and all in `paper_figures.png`; return the paths of the plots.

    The curves of a plot are in a CSV file beside it, with a column of times and one of each flexible case. A simulation
    that ended early is plotted up to its end, with its status in the legend; the table has the rows of both curves.

    Args:
        rigid: simulation of the case "rr" of the paper: rigid links and joints.
        flexible_links: simulation of the case "fr", at the same output times.
        flexible_both: simulation of the case "ff", at the same output times.
        folder: folder of the files; it is created if it does not exist.
        figures: numbers of the figures, 6 to 11; `paper_figures.png` is written if all six are among them.

    Raises:
        ImportError: without Matplotlib.
        ValueError: for other numbers of figures, for different output times, and for arms with a number of joints other
            than 3.
    """
    trajectories = {"rr": rigid, "fr": flexible_links, "ff": flexible_both}
    for name, trajectory in (("flexible_links", flexible_links), ("flexible_both", flexible_both)):
        rows = min(len(rigid.time), len(trajectory.time))
        if not np.allclose(trajectory.time[:rows], rigid.time[:rows], rtol=0.0, atol=1e-9):
            raise value_error(f"{name}.time", trajectory.time[:3], "the output times of the rigid case")
        joints = rigid.joint_angles.shape[1], trajectory.joint_angles.shape[1]
        if joints != (3, 3):
            raise value_error(f"{name}.joint_angles", joints, "3 joints, in the rigid case and in this one")
    for figure in figures:
        if figure not in FIGURES:
            raise value_error("figures", figure, "numbers from 6 to 11")
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    paths = [folder / f"figure_{figure:02d}.png" for figure in figures]
    for figure, path in zip(figures, paths, strict=True):
        plot = new_figure((6.4, 4.0), 120.0, layout="constrained")
        axes = plot.add_subplot()
        _difference(axes, trajectories, figure)
        axes.set_title(f"{axes.get_title()}, under 400 N m at every joint")
        axes.set(xlabel="time (s)", ylabel=f"difference to the rigid arm ({figure_unit(figure)})")
        plot.legend(*axes.get_legend_handles_labels(), loc="outside upper center", ncols=2, frameon=False)
        save_figure(plot, path)
        _write_curves(paper_curves(trajectories, figure), figure_unit(figure), path.with_suffix(".csv"))
    return [*paths, _all_figures(trajectories, folder / "paper_figures.png")] if {*FIGURES} <= {*figures} else paths


def _all_figures(trajectories: Mapping[str, Trajectory], path: Path) -> Path:
    plot = new_figure((10.5, 6.0), 120.0, layout="constrained")
    grid = plot.subplots(2, 3, sharex=True, sharey="row")
    for figure, axes in zip(FIGURES, grid.flat, strict=True):
        _difference(axes, trajectories, figure)
    for figure, axes in zip((FIGURES[0], FIGURES[3]), grid[:, 0], strict=True):
        axes.set_ylabel(f"difference to the rigid arm ({figure_unit(figure)})")
    for axes in grid[1]:
        axes.set_xlabel("time (s)")
    plot.suptitle("Difference between the flexible and the rigid arm under 400 N m at every joint", fontsize=13)
    plot.legend(*axes.get_legend_handles_labels(), loc="outside lower center", ncols=2, frameon=False, fontsize=11)
    save_figure(plot, path)
    return path


def _difference(axes: Any, trajectories: Mapping[str, Trajectory], figure: int) -> None:
    """Plot the curves of a figure, and set its title."""
    axes.axhline(0.0, color=MIDDLE, linewidth=0.8)
    curves = paper_curves(trajectories, figure)
    for (case, curve), colour, style in zip(curves.items(), (BLUE, RED), ("-", "--"), strict=True):
        status, end = trajectories[case].status, trajectories[case].time[-1]
        ended = "" if status == "ok" else f" ({status} after {end:g} s)"
        axes.plot(*curve, style, color=colour, linewidth=1.6, label=PAPER_CASES[case] + ended)
    axes.set_title(figure_name(figure), fontsize=11)
    axes.set_xlim(trajectories["rr"].time[0], trajectories["rr"].time[-1])
    axes.grid(color=LIGHT, linewidth=0.6)
    axes.spines[["top", "right"]].set_visible(False)


def _write_curves(curves: Mapping[str, tuple[Array, Array]], unit: str, path: Path) -> None:
    """Write the curves of a figure to a CSV file, up to the end of the shortest."""
    times = min((time for time, _ in curves.values()), key=len)
    differences = {f"{case} - rr ({unit})": values[: len(times)] for case, (_, values) in curves.items()}
    write_csv(path, {"time (s)": times} | differences)


def _column(trajectory: Trajectory, column: int) -> Array:
    """Return a column of the tip position (0 to 2) and joint angles (3 to 5)."""
    return np.hstack([trajectory.tip, trajectory.joint_angles])[:, column]

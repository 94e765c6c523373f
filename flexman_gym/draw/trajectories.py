"""Figures of trajectories: one simulation, and Figures 6 to 11 of the paper."""

from pathlib import Path
from typing import Any

import numpy as np

from flexman_gym.common.arrays import Array
from flexman_gym.common.checks import value_error
from flexman_gym.draw.style import BLUE, DARK, LIGHT, LINK_COLOURS, MIDDLE, RED, new_figure
from flexman_gym.simulation.trajectory import Trajectory


def trajectory_figure(trajectory: Trajectory, path: str | Path | None = None) -> Path | None:
    """Draw the tip, joint and motor angles, the springs' wind-up, and the energy residual.

    The residual is a part of the energy turned over until the end, as `Trajectory.energy_alarm` judges it; in J where
    nothing was. A solution that ended early is drawn to its end, and the title says so.

    Args:
        trajectory: what is drawn.
        path: of the picture; its suffix says the kind of file. Its folder is created where it does not exist. None
            shows the figure in a window or in a notebook, by Matplotlib's `pyplot.show`.

    Returns:
        The path of the picture, None where it was shown.

    Raises:
        ImportError: without Matplotlib.
        ValueError: for a suffix that Matplotlib does not know.
    """
    figure = new_figure((8.4, 8.0), 120.0, window=path is None, layout="constrained")
    _draw(figure, trajectory)
    if path is None:
        from matplotlib import pyplot

        pyplot.show()
        return None
    file = Path(path)
    file.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(file)
    return file


def _draw(figure: Any, trajectory: Trajectory) -> None:
    """Draw the four axes."""
    time = trajectory.time
    tip, angles, twists, energy = figure.subplots(4, 1, sharex=True, height_ratios=(3, 3, 2, 2))
    for i, name in enumerate("xyz"):
        tip.plot(time, trajectory.tip[:, i], color=LINK_COLOURS[i], label=name)
    motors = trajectory.motor_angles
    for i, joint in enumerate(trajectory.joint_angles.T):
        colour = LINK_COLOURS[i % len(LINK_COLOURS)]
        angles.plot(time, joint, color=colour, label=f"joint {i + 1}")
        twists.plot(time, motors[:, i] - joint, color=colour)
    angles.plot(time, motors, ":", color=DARK, linewidth=1.0, label=["motors", *[""] * (motors.shape[1] - 1)])
    residual, unit = _residual(trajectory)
    energy.plot(time, residual, color=DARK)
    tip.set_ylabel("tip (m)")
    angles.set_ylabel("angle (rad)")
    twists.set_ylabel("motor - joint (rad)")
    energy.set(ylabel=f"energy residual\n({unit})", xlabel="time (s)")
    for axes in (tip, angles, twists, energy):
        _plain(axes, time)
    for axes in (tip, angles):
        axes.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0), frameon=False)
    if trajectory.status != "ok":
        figure.suptitle(f"{trajectory.status} after {time[-1]:g} s")


def _residual(trajectory: Trajectory) -> tuple[Array, str]:
    """The residual and its unit."""
    turned = float(trajectory.energy_turnover[-1])
    if turned > 0.0:
        return trajectory.energy_residual / turned, "part of the turnover"
    return trajectory.energy_residual, "J"


def _plain(axes: Any, time: Array) -> None:
    axes.axhline(0.0, color=MIDDLE, linewidth=0.8, zorder=0)
    axes.set_xlim(time[0], np.nextafter(time[-1], np.inf))  # a single time has a width, too
    axes.grid(color=LIGHT, linewidth=0.6)
    axes.spines[["top", "right"]].set_visible(False)
    axes.ticklabel_format(axis="y", scilimits=(-3, 4), useMathText=True)


def paper_figures(
    rigid: Trajectory, flexible_links: Trajectory, flexible_both: Trajectory, folder: str | Path
) -> list[Path]:
    """Draws Figures 6 to 11 of the paper, each as a PNG, and all of them in `paper_figures.png`.

    A solution that ended early is drawn to its end, and its label says so.

    Args:
        rigid: solution of the paper's case "rr".
        flexible_links: of its case "fr", at the same output times.
        flexible_both: of its case "ff", at the same output times.
        folder: for the files; it is created where it does not exist.

    Returns:
        The paths of the files.

    Raises:
        ImportError: without Matplotlib.
        ValueError: for other output times or another number of joints than 3.
    """
    cases = {"flexible links, rigid joints": flexible_links, "flexible links and joints": flexible_both}
    for name, trajectory in (("flexible_links", flexible_links), ("flexible_both", flexible_both)):
        rows = min(len(rigid.time), len(trajectory.time))
        if not np.allclose(trajectory.time[:rows], rigid.time[:rows], rtol=0.0, atol=1e-9):
            raise value_error(f"{name}.time", trajectory.time[:3], "the output times of the rigid case")
        joints = rigid.joint_angles.shape[1], trajectory.joint_angles.shape[1]
        if joints != (3, 3):
            raise value_error(f"{name}.joint_angles", joints, "3 joints, in the rigid case and in this one")
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    paths = [folder / f"figure_{number:02d}.png" for number in range(6, 12)]
    for column, path in enumerate(paths):
        figure = new_figure((6.4, 4.0), 120.0, layout="constrained")
        axes = figure.add_subplot()
        _difference(axes, column, rigid, cases)
        axes.set_title(f"{axes.get_title()}, under 400 N m at every joint")
        axes.set(xlabel="time (s)", ylabel=f"difference to the rigid arm ({_unit(column)})")
        figure.legend(*axes.get_legend_handles_labels(), loc="outside upper center", ncols=2, frameon=False)
        figure.savefig(path)
    return [*paths, _all_figures(rigid, cases, folder / "paper_figures.png")]


def _all_figures(rigid: Trajectory, cases: dict[str, Trajectory], path: Path) -> Path:
    figure = new_figure((10.5, 6.0), 120.0, layout="constrained")
    grid = figure.subplots(2, 3, sharex=True, sharey="row")
    for column, axes in enumerate(grid.flat):
        _difference(axes, column, rigid, cases)
    for row in range(2):
        grid[row, 0].set_ylabel(f"difference to the rigid arm ({_unit(3 * row)})")
    for axes in grid[1]:
        axes.set_xlabel("time (s)")
    figure.suptitle("How far the flexible arm departs from the rigid one under 400 N m at every joint", fontsize=13)
    figure.legend(*axes.get_legend_handles_labels(), loc="outside lower center", ncols=2, frameon=False, fontsize=11)
    figure.savefig(path)
    return path


def _difference(axes: Any, column: int, rigid: Trajectory, cases: dict[str, Trajectory]) -> None:
    """Draws column 0 to 2 (tip x, y, z) or 3 to 5 (joint angles) of each case minus the rigid one over time."""
    axes.axhline(0.0, color=MIDDLE, linewidth=0.8)
    for (label, case), colour, style in zip(cases.items(), (BLUE, RED), ("-", "--"), strict=True):
        rows = min(len(rigid.time), len(case.time))
        ended = "" if case.status == "ok" else f" ({case.status} after {case.time[-1]:g} s)"
        difference = _column(case, column)[:rows] - _column(rigid, column)[:rows]
        axes.plot(case.time[:rows], difference, style, color=colour, linewidth=1.6, label=label + ended)
    name = f"tip, {'xyz'[column]}" if column < 3 else rf"joint angle $\theta_{column - 2}$"
    axes.set_title(f"Figure {6 + column}: {name}", fontsize=11)
    axes.set_xlim(rigid.time[0], rigid.time[-1])
    axes.grid(color=LIGHT, linewidth=0.6)
    axes.spines[["top", "right"]].set_visible(False)


def _column(trajectory: Trajectory, column: int) -> Array:
    return np.hstack([trajectory.tip, trajectory.joint_angles])[:, column]


def _unit(column: int) -> str:
    return "m" if column < 3 else "rad"

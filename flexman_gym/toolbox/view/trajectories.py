"""Plots of motions over time: a simulation, episodes of agents, and Figures 6 to 11 of the paper.

The paper is "Dynamic modeling and simulation of spatial manipulator with flexible links and joints".
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from flexman_gym.common.arrays import Array
from flexman_gym.common.errors import value_error
from flexman_gym.common.plot_style import BLUE, DARK, LIGHT, LINK_COLOURS, MIDDLE, RED, new_figure, save_figure
from flexman_gym.simulation.trajectory import Trajectory


def trajectory_figure(trajectory: Trajectory, path: str | Path | None = None) -> Path | None:
    """Plot tip position, joint and motor angles, joint twists and energy residual of a simulation over time.

    Joint twists are the elastic deflections of the joints: motor angles minus link-side angles, rad. The energy
    residual is divided by the energy turnover, the largest of kinetic + elastic energy, |work| and |dissipation|,
    unless it is 0. A simulation that ended early is plotted up to its end, with its status in the title.

    Args:
        trajectory: result of the simulation.
        path: path of the picture, whose suffix selects the format; its folder is created if it does not exist. None
            shows the figure in a window or in a notebook, by Matplotlib's `pyplot.show`.

    Returns:
        The path of the picture; None if the figure was shown.

    Raises:
        ImportError: without Matplotlib.
        ValueError: for a suffix that Matplotlib does not support.
    """
    figure = new_figure((8.4, 8.0), 120.0, window=path is None, layout="constrained")
    draw_panels(figure, trajectory)
    if path is None:
        from matplotlib import pyplot

        pyplot.show()
        return None
    file = Path(path)
    save_figure(figure, file)
    return file


def draw_panels(figure: Any, trajectory: Trajectory) -> None:
    """Draw the four panels of `trajectory_figure`."""
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
    """Return the energy residual (T,) and its unit for the axis: divided by the energy turnover if positive, else J."""
    turned = float(trajectory.energy_turnover[-1])
    if turned > 0.0:
        return trajectory.energy_residual / turned, "of the turnover"
    return trajectory.energy_residual, "J"


def _plain(axes: Any, time: Array) -> None:
    axes.axhline(0.0, color=MIDDLE, linewidth=0.8, zorder=0)
    axes.set_xlim(time[0], np.nextafter(time[-1], np.inf))  # a positive width also for a single time
    axes.grid(color=LIGHT, linewidth=0.6)
    axes.spines[["top", "right"]].set_visible(False)
    axes.ticklabel_format(axis="y", scilimits=(-3, 4), useMathText=True)


def paper_figures(
    rigid: Trajectory, flexible_links: Trajectory, flexible_both: Trajectory, folder: str | Path
) -> list[Path]:
    """Plot Figures 6 to 11 of the paper, each as a PNG, and all in `paper_figures.png`; return the paths of the files.

    A simulation that ended early is plotted up to its end, with its status in the legend.

    Args:
        rigid: simulation of the case "rr" of the paper: rigid links and joints.
        flexible_links: simulation of the case "fr", at the same output times.
        flexible_both: simulation of the case "ff", at the same output times.
        folder: folder of the files; it is created if it does not exist.

    Raises:
        ImportError: without Matplotlib.
        ValueError: for different output times, and for arms with a number of joints other than 3.
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
        save_figure(figure, path)
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
    figure.suptitle("Difference between the flexible and the rigid arm under 400 N m at every joint", fontsize=13)
    figure.legend(*axes.get_legend_handles_labels(), loc="outside lower center", ncols=2, frameon=False, fontsize=11)
    save_figure(figure, path)
    return path


def _difference(axes: Any, column: int, rigid: Trajectory, cases: dict[str, Trajectory]) -> None:
    """Plot the difference between each case and the rigid arm: tip x, y, z (columns 0 to 2), joint angles (3 to 5)."""
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


COLOURS = LINK_COLOURS  # colours of the agents
MIN_ERROR = 1e-5  # m; lower end of the logarithmic axis of tip errors


class _RecordedEpisode(Protocol):
    """Plotted signals of an episode: an `evaluation.EpisodeRecord` or an `fm.Episode`."""

    @property
    def errors(self) -> Array:
        """Distances of the tip from its target (T + 1,), m."""

    @property
    def actions(self) -> Array:
        """Commanded motor torques (T, n) as fractions of the torque limits."""

    @property
    def period(self) -> float:
        """Control period, s."""

    @property
    def band(self) -> float:
        """Distance from the target within which a tip counts as settled, m."""


def draw_episodes(records: Mapping[str, _RecordedEpisode], path: Path) -> None:
    """Plot tip error and commanded torques of one episode of each agent over time.

    Args:
        records: name of an agent -> its episode.
        path: path of the picture.

    Raises:
        ImportError: without Matplotlib.
    """
    first = next(iter(records.values()))
    joints, band = first.actions.shape[1], first.band
    figure = new_figure((10.0, 3.6 + 1.3 * joints), 110.0, layout="constrained")
    axes = figure.subplots(1 + joints, 1, sharex=True, height_ratios=[3.0, *[1.0] * joints])
    for (name, record), colour in zip(records.items(), COLOURS, strict=False):
        times = record.period * np.arange(len(record.errors))
        axes[0].semilogy(times, np.maximum(record.errors, MIN_ERROR), color=colour, linewidth=1.5, label=name)
        for joint in range(joints):
            axes[1 + joint].step(times[1:], record.actions[:, joint], color=colour, linewidth=1.0, where="pre")
    axes[0].axhline(band, color=DARK, linewidth=0.8, linestyle="--")
    axes[0].text(0.1, 1.15 * band, f"{1e3 * band:.3g} mm", fontsize=8, color=DARK)
    axes[0].set_ylim(bottom=MIN_ERROR)
    axes[0].set_ylabel("distance of the tip from its target (m)")
    axes[0].legend(frameon=False, ncols=6, fontsize=9, loc="lower right", bbox_to_anchor=(1.0, 1.0))
    for joint in range(joints):
        axes[1 + joint].set(ylabel=f"motor {joint + 1}", ylim=(-1.08, 1.08))
    axes[-1].set_xlabel("time (s); torques as fractions of their limits")
    for each in axes:
        each.grid(color=LIGHT, linewidth=0.6)
        each.spines[["top", "right"]].set_visible(False)
    save_figure(figure, path)

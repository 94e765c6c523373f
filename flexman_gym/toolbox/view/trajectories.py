"""Plots of motions over time: a simulation, and episodes of agents."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from flexman_gym.common.arrays import Array
from flexman_gym.common.plot_style import DARK, LIGHT, LINK_COLOURS, MIDDLE, new_figure, save_figure
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

    Motors without a torque in all episodes, such as passive joints, have no panel.

    Args:
        records: name of an agent -> its episode.
        path: path of the picture.

    Raises:
        ImportError: without Matplotlib.
    """
    first = next(iter(records.values()))
    band, every = first.band, range(first.actions.shape[1])
    driven = [joint for joint in every if any(each.actions[:, joint].any() for each in records.values())] or [*every]
    figure = new_figure((10.0, 3.6 + 1.3 * len(driven)), 110.0, layout="constrained")
    axes = figure.subplots(1 + len(driven), 1, sharex=True, height_ratios=[3.0, *[1.0] * len(driven)])
    for (name, record), colour in zip(records.items(), COLOURS, strict=False):
        times = record.period * np.arange(len(record.errors))
        axes[0].semilogy(times, np.maximum(record.errors, MIN_ERROR), color=colour, linewidth=1.5, label=name)
        for panel, joint in zip(axes[1:], driven, strict=True):
            panel.step(times[1:], record.actions[:, joint], color=colour, linewidth=1.0, where="pre")
    axes[0].axhline(band, color=DARK, linewidth=0.8, linestyle="--")
    axes[0].text(0.1, 1.15 * band, f"{1e3 * band:.3g} mm", fontsize=8, color=DARK)
    axes[0].set_ylim(bottom=MIN_ERROR)
    axes[0].set_ylabel("distance of the tip from its target (m)")
    axes[0].legend(frameon=False, ncols=6, fontsize=9, loc="lower right", bbox_to_anchor=(1.0, 1.0))
    for panel, joint in zip(axes[1:], driven, strict=True):
        panel.set(ylabel=f"motor {joint + 1}", ylim=(-1.08, 1.08))
    axes[-1].set_xlabel("time (s); torques as fractions of their limits")
    for each in axes:
        each.grid(color=LIGHT, linewidth=0.6)
        each.spines[["top", "right"]].set_visible(False)
    save_figure(figure, path)

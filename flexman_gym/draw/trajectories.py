"""Trajectories: where the tip, the joints and the motors of a trajectory were, and what its integrator invented."""

from pathlib import Path
from typing import Any

import numpy as np

from flexman_gym.arrays import Array
from flexman_gym.draw.style import DARK, LIGHT, LINK_COLOURS, MIDDLE, new_figure
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

"""Pictures of arms, trajectories and episodes for their method `_repr_png_`, which IPython calls in a notebook."""

from io import BytesIO

import numpy as np

from flexman_gym.common.plot_style import new_figure
from flexman_gym.model.deformation import curves
from flexman_gym.model.model import build_model
from flexman_gym.scene.arm import Arm
from flexman_gym.simulation.episode import Episode
from flexman_gym.simulation.trajectory import Trajectory
from flexman_gym.toolbox.view.frames import FramePainter, arm_frame, grid
from flexman_gym.toolbox.view.overlay import Caption
from flexman_gym.toolbox.view.trajectories import draw_panels
from flexman_gym.toolbox.view.video import encode_picture

SIZE = (320, 240)  # pixels; width and height of a frame of an episode
MOMENTS = (0.0, 0.15, 1.0)  # times of the frames as fractions of an episode; a slew is under way in the second one
POINTS = 4  # points of the curve of a link, for the choice of the camera


def arm_picture(arm: Arm) -> bytes:
    """Return a PNG of an undeformed arm at zero joint angles."""
    model = build_model(arm, elements=1)
    return encode_picture(arm_frame(model, np.zeros(2 * model.n_dof)))


def trajectory_picture(trajectory: Trajectory) -> bytes | None:
    """Return a PNG with the plots of a trajectory; None for one without outputs, and without Matplotlib."""
    if not len(trajectory.time):
        return None
    try:
        figure = new_figure((8.4, 8.0), 72.0, layout="constrained")
    except ImportError:
        return None
    draw_panels(figure, trajectory)
    file = BytesIO()
    figure.savefig(file, format="png")
    return file.getvalue()


def episode_picture(episode: Episode) -> bytes:
    """Return a PNG with three frames of an episode: at its start, during its motion and at its end."""
    rows = (np.array(MOMENTS) * (len(episode.time) - 1)).round().astype(int)
    bases, tips = episode.base_positions, episode.tips + episode.base_positions
    targets = [each if np.isfinite(each).all() else None for each in (episode.targets + bases)[rows]]
    positions = curves(episode.model, episode.states[rows], POINTS).positions + bases[rows, None, None]
    painter = FramePainter(episode.model, SIZE)
    points = [positions.reshape(-1, 3), *(each for each in targets if each is not None)]
    shot = painter.shot(np.vstack(points), bases[rows])
    errors = [float(each) if np.isfinite(each) else None for each in episode.errors[rows]]
    captions = [Caption(episode.name, float(time), each) for time, each in zip(episode.time[rows], errors, strict=True)]
    return encode_picture(grid([
        painter.paint(episode.states[row], target, words, tips[: row + 1], shot, bases[row])
        for row, target, words in zip(rows, targets, captions, strict=True)
    ], len(rows)))  # fmt: skip

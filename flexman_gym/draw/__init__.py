"""Pictures and plots: frames of an arm, videos, and Matplotlib plots; Matplotlib is imported by the first plot."""

from flexman_gym.draw import notebook  # noqa: F401 (adds the display methods of IPython)
from flexman_gym.draw.frames import FramePainter, arm_frame, grid
from flexman_gym.draw.overlay import Caption
from flexman_gym.draw.trajectories import paper_figures, trajectory_figure
from flexman_gym.draw.video import write_picture, write_video

__all__ = [
    "Caption",
    "FramePainter",
    "arm_frame",
    "grid",
    "paper_figures",
    "trajectory_figure",
    "write_picture",
    "write_video",
]

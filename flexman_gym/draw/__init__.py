"""Pictures: frames of an arm and the paper's figures, in Matplotlib, which is imported when something is drawn."""

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

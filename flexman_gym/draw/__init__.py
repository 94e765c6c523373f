"""Pictures: frames of an arm and the paper's figures, in Matplotlib, which is imported when something is drawn."""

from flexman_gym.draw.figures import paper_figures
from flexman_gym.draw.frames import FramePainter, arm_frame, arm_lines
from flexman_gym.draw.trajectories import trajectory_figure

__all__ = ["FramePainter", "arm_frame", "arm_lines", "paper_figures", "trajectory_figure"]

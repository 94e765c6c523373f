"""Pictures and plots: frames of an arm, videos, and Matplotlib plots; Matplotlib is imported by the first plot."""

from typing import TYPE_CHECKING

from flexman_gym.common.lazy import lazy_names

if TYPE_CHECKING:
    from flexman_gym.toolbox.view.frames import FramePainter, arm_frame, grid
    from flexman_gym.toolbox.view.overlay import Caption
    from flexman_gym.toolbox.view.paper import paper_figures
    from flexman_gym.toolbox.view.trajectories import trajectory_figure
    from flexman_gym.toolbox.view.video import write_picture, write_video

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

__getattr__, __dir__ = lazy_names(__name__)

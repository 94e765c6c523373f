"""Side: saved episodes side by side as a film, each arm with its numbers."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from flexman_gym.checks import refusal
from flexman_gym.draw.frames import FramePainter, grid
from flexman_gym.draw.overlay import Caption
from flexman_gym.model.curves import curves
from flexman_gym.simulation.episode import Episode

SMALL, LARGE = (480, 360), (1280, 720)  # pixels of a moving picture and of a film, all arms together
SECONDS, SMALL_RATE, RATE = 5.0, 10.0, 50.0  # of a moving picture; frames a second
TRAIL = 1.5  # s


def side_by_side(
    episodes: Sequence[Episode], small: bool = False, size: tuple[int, int] | None = None
) -> tuple[list[NDArray[np.uint8]], float]:
    """Paints frames of episodes side by side, from one camera direction and with one scale.

    Args:
        episodes: at least one.
        small: a moving picture of 5 s at 10 frames a second, instead of a film of the whole at 50.
        size: width and height of all together, pixels; None takes 480 x 360 or 1280 x 720.

    Returns:
        Frames (height, width, 3), and how many of them a second.

    Raises:
        ValueError: for no episode, and what a FramePainter refuses.
    """
    if not episodes:
        raise refusal("episodes", episodes, "at least one")
    whole = size or (SMALL if small else LARGE)
    cell, rate = (whole[0] // len(episodes), whole[1]), SMALL_RATE if small else RATE
    end = min(max(float(each.time[-1]) for each in episodes), SECONDS if small else np.inf)
    stage = np.concatenate([
        points for each in episodes
        for points in (curves(each.model, each.states[:: max(1, len(each.time) // 60)], 4).positions.reshape(-1, 3),
                       each.targets[np.isfinite(each.targets).all(axis=1)])
    ])  # fmt: skip
    painters = [FramePainter(each.model, cell, shadow=not small) for each in episodes]
    shots = [painter.shot(stage) for painter in painters]
    frames = []
    for time in np.arange(0.0, end - 0.5 / rate, 1.0 / rate):
        row = [min(round(time / each.period), len(each.time) - 1) for each in episodes]
        frames.append(grid([
            painter.paint(each.states[k], each.targets[k] if np.isfinite(each.targets[k]).all() else None,
                          _caption(each, k), each.tips[max(0, k - round(TRAIL / each.period)) : k + 1], shot)
            for painter, each, k, shot in zip(painters, episodes, row, shots, strict=True)
        ], len(episodes)))  # fmt: skip
    return frames, rate


def _caption(episode: Episode, row: int) -> Caption:
    """What is known at a row."""
    error, torques = float(episode.errors[row]), episode.actions[max(row - 1, 0)] if len(episode.actions) else None
    known = torques is not None and bool(np.isfinite(torques).all())
    return Caption(
        episode.name, float(episode.time[row]), error if np.isfinite(error) else None, None, torques if known else None
    )

"""Rendering: frames of arms during their episodes."""

import os
import sys
from typing import Any

import numpy as np
from numpy.typing import NDArray

from flexman_gym.common.arrays import Array
from flexman_gym.common.checks import one_of
from flexman_gym.draw.frames import FramePainter, Shot
from flexman_gym.draw.overlay import Caption
from flexman_gym.envs.episodes import Episodes
from flexman_gym.model.deformation import curves

RENDER_KEYWORDS = ("render_mode", "render_size", "render_camera", "render_gain", "render_overlays")
RENDER_MODES = ("human", "rgb_array")
TRAIL_DURATION = 1.5  # s; drawn part of the path of the tip
LINK_POINTS, POSTURES, TIMES = 5, 7, 24  # points on each link; postures from start to goal; times of a moving goal


class _Renderer:
    """Renderer of the arms of an environment, each with a camera that shows its whole task.

    Args:
        episodes: episodes of the arms.
        title: title of the frames.
        look: size, camera, gain and overlays, see `FramePainter`.

    Attributes:
        screen: window or page with the first arm; None before the first frame.
    """

    def __init__(self, episodes: Episodes, title: str, look: tuple[Any, ...]) -> None:
        self._episodes, self._title, self._painter = episodes, title, FramePainter(episodes.batch.model, *look)
        self.screen: Any = None
        arms = len(episodes.over)
        self._plans: list[object] = [None] * arms
        self._shots: list[Shot | None] = [None] * arms
        self._trails: list[list[tuple[float, Array]]] = [[] for _ in range(arms)]

    def frame(self, arm: int) -> NDArray[np.uint8]:
        """Return a frame (height, width, 3) uint8 of an arm, its target, error and reward, at the present time."""
        episodes, view = self._episodes, self._episodes.view
        if self._is_new(arm):
            self._trails[arm], self._shots[arm] = [], self._painter.shot(self.extent(arm))
        time = float(episodes.batch.time[arm])
        trail = [entry for entry in self._trails[arm] if time - TRAIL_DURATION <= entry[0] < time]
        self._trails[arm] = [*trail, (time, view.tip[arm].copy())]
        reward = float(episodes.rewards()[arm]) if time > 0.0 else None
        caption = Caption(self._title, time, float(view.tip_error[arm]), reward, view.action[arm].copy())
        path = np.array([tip for _, tip in self._trails[arm]])
        return self._painter.paint(view.state[arm], view.target[arm], caption, path, self._shots[arm])

    def _is_new(self, arm: int) -> bool:
        """Return True if a new episode has begun since the last call."""
        plan = {name: values[arm].tolist() for name, values in self._episodes.view.plan.items()}
        before, self._plans[arm] = self._plans[arm], plan
        return plan != before

    def show(self) -> None:
        """Show the first arm in a window, or on a local web page on a computer without a display."""
        from flexman_gym.draw.replay import LivePage
        from flexman_gym.draw.video import Window

        view, model = self._episodes.view, self._episodes.batch.model
        period = self._episodes.agent.action_repeat * view.control_period
        if self.screen is None:
            shown = self._painter
            self.screen = (
                Window(shown.size, self._title, period)
                if _has_display()
                else LivePage(model, self._title, period, shown.scale)
            )
        if isinstance(self.screen, Window):
            return self.screen.show(self.frame(0))
        if self._is_new(0) or self._episodes.batch.time[0] == 0.0:
            self.screen.begin(self.extent(0))
        self.screen.show(view.state[0, : model.n_dof], view.target[0], view.tip_error[0], view.action[0])

    def close(self) -> None:
        """Close the window or the page."""
        if self.screen is not None:
            self.screen.close()
            self.screen = None

    def extent(self, arm: int) -> Array:
        """Return the points (p, 3), m, that a frame must contain: the arm now, at the start and up to its goals."""
        episodes, view, model = self._episodes, self._episodes.view, self._episodes.batch.model
        times = np.linspace(0.0, episodes.max_periods * view.control_period, TIMES if episodes.task.moves else 1)
        plan = {name: np.repeat(values[arm : arm + 1], len(times), axis=0) for name, values in view.plan.items()}
        goal, start = episodes.task.goal(plan, times, view), plan["start"][0]
        postures = start + np.linspace(0.0, 1.0, POSTURES)[:, None] * (goal.angles[0] - start)
        states = [view.state[arm : arm + 1], view.rest_states(np.array([start, goal.angles[-1]]))]
        states += [model.at_rest(np.concatenate([postures, goal.angles]))]
        points = curves(model, np.concatenate(states), LINK_POINTS).positions.reshape(-1, 3)
        return np.concatenate([points, goal.target, view.target[arm : arm + 1]])


def make_renderer(
    mode: str | None, episodes: Episodes, title: str, look: tuple[Any, ...], modes: tuple[str, ...] = RENDER_MODES
) -> _Renderer | None:
    """Return the renderer of a render mode; None for none.

    Args:
        mode: render mode of Gymnasium.
        episodes: episodes of the arms.
        title: title of the frames.
        look: size, camera, gain and overlays, in the order of RENDER_KEYWORDS.
        modes: allowed render modes.
    """
    if mode is None:
        return None
    one_of("render_mode", mode, modes)
    return _Renderer(episodes, title, look)


def _has_display() -> bool:
    """Return whether a window can be opened: it needs pygame and, on Linux, a display."""
    from importlib.util import find_spec

    shown = any(os.environ.get(name) for name in ("DISPLAY", "WAYLAND_DISPLAY", "SDL_VIDEODRIVER"))
    return find_spec("pygame") is not None and (shown or not sys.platform.startswith("linux"))

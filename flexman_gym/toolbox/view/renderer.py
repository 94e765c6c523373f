"""Rendering of arms during their episodes: frames, or a local web page."""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from flexman_gym.common.arrays import Array
from flexman_gym.envs.episodes import Episodes
from flexman_gym.model.deformation import curves
from flexman_gym.toolbox.view.frames import FramePainter, limiting_strains
from flexman_gym.toolbox.view.overlay import Caption

if TYPE_CHECKING:
    from flexman_gym.toolbox.view.live_page import LiveScene

TRAIL_DURATION = 1.5  # s; length of the drawn trail of the tip
LINK_POINTS, POSTURES = 5, 7  # points on each link, and postures from start to goal, that a frame must contain
GOAL_TIMES = 24  # times during an episode at which the position of a moving goal must be in the frame


class Renderer:
    """Renderer of the arms of an environment; each arm has a camera that shows its start, goal and target.

    Args:
        episodes: episodes of the arms.
        title: title of the frames.
        look: frame size, camera, gains of the deflection and overlays, in the order of RENDER_KEYWORDS after the mode,
            see `FramePainter`.

    Attributes:
        page: web page that shows the first arm; None before the first frame.
    """

    def __init__(self, episodes: Episodes, title: str, look: tuple[Any, ...]) -> None:
        model, limits = episodes.batch.model, episodes.limits
        self._episodes, self._title, self._painter = episodes, title, FramePainter(model, *look)
        self._painter.workspace = limits.workspace or ()
        if model.n_elastic and not isinstance(limits.strain, str | None):
            self._painter.scale = limiting_strains(model, limits.strain)
        self.page: Any = None
        arms = len(episodes.over)
        self._last_parameters: list[object] = [None] * arms
        self._shots: list[Any] = [None] * arms
        self._trails: list[list[tuple[float, Array]]] = [[] for _ in range(arms)]

    def frame(self, arm: int) -> NDArray[np.uint8]:
        """Return a frame (height, width, 3) uint8 of the arm with the index `arm`, its target, tip error and reward.

        Raises:
            RuntimeError: before the first reset.
        """
        episodes, view = self._episodes, self._episodes.view
        if not view.episode_parameters:
            raise RuntimeError("render: there is no episode to be drawn: reset the environment first")
        if self._is_new(arm):
            points, base = self.extent(arm), self._bases()[arm]
            bases = base[None]
            if episodes.foundation is not None:  # its start and its goal
                bases = np.array([base, episodes.foundation.goals[arm]])
            points = np.concatenate([points + each for each in bases])
            self._trails[arm], self._shots[arm] = [], self._painter.shot(points, bases)
        time = float(episodes.batch.time[arm])
        trail = [entry for entry in self._trails[arm] if time - TRAIL_DURATION <= entry[0] < time]
        base = self._bases()[arm]
        self._trails[arm] = [*trail, (time, view.tip[arm] + base)]
        reward = float(episodes.rewards()[arm]) if time > 0.0 else None
        limits = episodes.limits
        strain = None if limits.strain is None else float(limits.strain_share(view)[arm])
        caption = Caption(self._title, time, float(view.tip_error[arm]), reward, view.action[arm].copy(), strain)
        path = np.array([tip for _, tip in self._trails[arm]])
        return self._painter.paint(view.state[arm], view.target[arm] + base, caption, path, self._shots[arm], base)

    def _bases(self) -> Array:
        """Return the positions of the bases (b, 3) in the world frame, m; zeros for fixed bases."""
        foundation = self._episodes.foundation
        return np.zeros((len(self._episodes.over), 3)) if foundation is None else foundation.displacements

    def _is_new(self, arm: int) -> bool:
        """Return True if a new episode of the arm with the index `arm` has begun since the last call."""
        parameters = {name: values[arm].tolist() for name, values in self._episodes.view.episode_parameters.items()}
        before, self._last_parameters[arm] = self._last_parameters[arm], parameters
        return parameters != before

    def show(self) -> None:
        """Show the first arm on a local web page, in real time."""
        from flexman_gym.toolbox.view.live_page import LivePage

        period = self._episodes.agent.action_repeat * self._episodes.view.control_period
        if self.page is None:
            self.page = LivePage()
        if self._is_new(0) or self._episodes.batch.time[0] == 0.0:
            self.page.begin(self.scene([self._title], period))
        self.page.show(live_row(self._episodes)[None, None])
        self.page.wait(period)

    def close(self) -> None:
        """Close the web page."""
        if self.page is not None:
            self.page.close()
            self.page = None

    def scene(self, names: Sequence[str], period: float, **more: Any) -> "LiveScene":
        """Return the scene of a live page with the first arm.

        Args:
            names: names of the agents.
            period: time between two rows, s.
            **more: gain and controls of the scene.
        """
        from flexman_gym.toolbox.view.live_page import LiveScene

        model, scale = self._episodes.batch.model, float(np.max(self._painter.scale))
        return LiveScene(model, self._title, names, period, self.extent(0), scale, **more)

    def extent(self, arm: int) -> Array:
        """Return points (p, 3), m, that a frame of the arm with this index must contain: motion and targets."""
        episodes, view, model = self._episodes, self._episodes.view, self._episodes.batch.model
        times = np.linspace(0.0, episodes.max_periods * view.control_period, GOAL_TIMES if episodes.task.moves else 1)
        own = {name: values[arm : arm + 1] for name, values in view.episode_parameters.items()}
        parameters = {name: np.repeat(values, len(times), axis=0) for name, values in own.items()}
        goal, start = episodes.task.goal(parameters, times, view), parameters["start"][0]
        postures = start + np.linspace(0.0, 1.0, POSTURES)[:, None] * (goal.angles[0] - start)
        states = [view.state[arm : arm + 1], view.rest_states(np.array([start, goal.angles[-1]]))]
        states += [model.at_rest(np.concatenate([postures, goal.angles]))]
        points = curves(model, np.concatenate(states), LINK_POINTS, *self._painter.gains).positions.reshape(-1, 3)
        return np.concatenate([points, goal.target, view.target[arm : arm + 1]])


def live_row(episodes: Episodes) -> Array:
    """Return the row of a live page, see `LivePage.show`, with the present state of the first arm."""
    view = episodes.view
    parts = view.state[0, : episodes.batch.model.n_dof], view.target[0], view.tip_error[:1], view.action[0]
    return np.concatenate([*parts, view.root_strains[0]])

"""Render modes of environments; the renderer is imported when an environment has one."""

from typing import TYPE_CHECKING, Any

from flexman_gym.common.checks import one_of
from flexman_gym.common.registry import load_entry

if TYPE_CHECKING:
    from flexman_gym.envs.episodes import Episodes
    from flexman_gym.toolbox.view.renderer import Renderer

RENDER_KEYWORDS = ("render_mode", "render_size", "render_camera", "render_gain", "render_overlays")
RENDER_MODES = ("human", "rgb_array")


def make_renderer(
    mode: str | None, episodes: "Episodes", title: str, look: tuple[Any, ...], modes: tuple[str, ...] = RENDER_MODES
) -> "Renderer | None":
    """Return the renderer for a render mode; None for the render mode None.

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
    renderer: Renderer = load_entry("flexman_gym.toolbox.view.renderer:Renderer")(episodes, title, look)
    return renderer

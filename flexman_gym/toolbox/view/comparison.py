"""Episodes side by side: frames of the arms, and a strip chart of their tip errors below."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from flexman_gym.common.arrays import Array, Vector
from flexman_gym.common.errors import value_error
from flexman_gym.common.plot_style import BLUE, DARK, GREEN, LIGHT, MIDDLE, RED, VIOLET, new_figure
from flexman_gym.model.deformation import curves
from flexman_gym.simulation.episode import Episode
from flexman_gym.toolbox.view.frames import MARGINS, FramePainter
from flexman_gym.toolbox.view.overlay import WARNING, describe_frame, font_size, write_text

COLOURS = (BLUE, RED, GREEN, VIOLET)
CROWDED = 3  # number of panels from which their heads have no room for the time and for words
MAX_FRAMES = 3000  # frames of a video, 8 GB of 1280 x 720 pixels
VIEW_STATES, LINK_POINTS = 120, 4  # number of states of an episode, and of points on a link, that the camera shows
STRIP_SHARE = 0.26  # height of the strip chart / height of the picture
TEXT_ROWS = 20  # height of the picture / height of its letters, at least; legible on a phone
PAPER = "#f3f6f9"  # background of the strip chart, the colour of the floor of a frame
VISIBLE_SAG, MAX_GAIN = 0.125, 100.0  # largest drawn sag of a link / its length; largest suggested gain
SAG_POINTS = 9  # number of points on a link between which its sag is searched
LINE = 1.45  # distance of two lines of text / height of the letters
DPI = 100.0  # pixels per inch of the strip chart
Picture = NDArray[np.uint8]


def side_by_side(
    episodes: Sequence[Episode],
    size: tuple[int, int] = (480, 360),
    rate: float = 10.0,
    seconds: float = np.inf,
    hold: float = 0.0,
    gain: float | Vector = 1.0,
) -> list[Picture]:
    """Return frames (height, width, 3), uint8, of episodes side by side, with equal camera directions and scales.

    The names of the agents and their tip errors stand above the arms. If the episodes have targets, a strip chart below
    shows the tip errors up to the time of the frame. The violet line is the path of the tip since the start; with a
    magnification the violet dot is the true tip.

    Args:
        episodes: at least one episode.
        size: width and height of the picture, pixels.
        rate: frames per second.
        seconds: duration of the motion that is shown, s.
        hold: time for which the last frame is repeated, s.
        gain: magnification of the deflection of the links, or of links and joints, see `FramePainter`.

    Raises:
        ImportError: for episodes with targets without Matplotlib.
        ValueError: for more than MAX_FRAMES frames.
    """
    if not 1 <= len(episodes) <= len(COLOURS):
        raise value_error("episodes", len(episodes), f"1 to {len(COLOURS)} of them")
    end = min(max(float(each.time[-1]) for each in episodes), seconds)
    if not end * rate <= MAX_FRAMES:
        raise value_error("seconds", end, f"at most {MAX_FRAMES / rate:g} (s), {MAX_FRAMES} frames")
    panels = _Panels(episodes, size, end, gain)
    times = np.append(np.arange(0.0, end - 0.5 / rate, 1.0 / rate), end)
    frames = [panels.paint(time) for time in times]
    return frames + frames[-1:] * round(hold * rate)


def suggested_gain(episodes: Sequence[Episode]) -> float:
    """Return a magnification at which the links are seen to bend.

    The largest sag of a link, the distance of its centreline from the chord between its ends, is drawn as at most
    VISIBLE_SAG of its length.

    Args:
        episodes: at least one episode.

    Returns:
        1, 2, 5, 10, ... up to MAX_GAIN; 1 for rigid links.
    """
    elastic = [each for each in episodes if each.model.n_elastic]
    return rounded_gain(VISIBLE_SAG / max(max(map(_largest_sag, elastic)), 1e-12)) if elastic else 1.0


def _largest_sag(episode: Episode) -> float:
    """Return the largest sag of a link of an episode, as a fraction of its length."""
    rows = np.unique(np.linspace(0, len(episode.time) - 1, VIEW_STATES).astype(int))
    points = curves(episode.model, episode.states[rows], SAG_POINTS).positions
    away = points - points[:, :, :1]
    along = away[:, :, -1:] / np.linalg.norm(away[:, :, -1:], axis=-1, keepdims=True)
    sags = np.linalg.norm(away - (away * along).sum(axis=-1, keepdims=True) * along, axis=-1).max(axis=-1)
    return float(np.nanmax(sags / episode.model.constants.length))


def rounded_gain(gain: float) -> float:
    """Return the largest of 1, 2, 5, 10, ... up to MAX_GAIN that is at most `gain`; 1 for smaller values."""
    steps = [step * 10.0**power for power in range(3) for step in (1, 2, 5) if step * 10.0**power <= MAX_GAIN]
    return max((step for step in steps if step <= gain), default=1.0)


class _Panels:
    """Painter of frames with one panel for each episode.

    Args:
        episodes: the episodes.
        size: width and height of the picture, pixels.
        end: last time of the strip chart, s.
        gain: magnification of the deflection.
    """

    def __init__(self, episodes: Sequence[Episode], size: tuple[int, int], end: float, gain: float | Vector) -> None:
        width, height = size
        self._episodes, self._size, self._font = episodes, size, font_size(round(33.0 / TEXT_ROWS * height))
        self._line, self._end = round(LINE * self._font), end
        has_errors = any(np.isfinite(each.errors).any() for each in episodes)
        strip = round(STRIP_SHARE * height) if has_errors else 0
        self._strip = _ErrorStrip(episodes, end, (width, strip), self._font) if has_errors else None
        room = width // len(episodes), height - strip
        self._painters = [
            FramePainter(each.model, room, gain=gain, overlays=False, shadow=False) for each in episodes
        ]  # fmt: skip
        points = np.concatenate([
            part for each in episodes for part in _extent(each, end, self._painters[0].gains)
        ])  # fmt: skip
        bases = np.concatenate([_outermost_bases(each, end) for each in episodes])
        top, bottom = self._font // 2 + 2 * self._line, self._line  # of names and errors, and of the scales
        margins = np.array([MARGINS[0], MARGINS[1], top / room[1], bottom / room[1]])
        self._shots = [painter.shot(points, bases, margins) for painter in self._painters]

    def paint(self, time: float) -> Picture:
        """Return the frame at a time (s)."""
        width, height = self._size
        picture = np.full((height, width, 3), 255, dtype=np.uint8)
        for k, (episode, painter, shot) in enumerate(zip(self._episodes, self._painters, self._shots, strict=True)):
            row = min(round(time / episode.period), len(episode.time) - 1)
            bases = episode.base_positions
            target = episode.targets[row] + bases[row] if np.isfinite(episode.targets[row]).all() else None
            left = k * painter.size[0]
            part = picture[: painter.size[1], left : left + painter.size[0]]
            trail = episode.tips[: row + 1] + bases[: row + 1]
            part[:] = painter.paint(episode.states[row], target, trail=trail, shot=shot, base=bases[row])
            self._write_head(picture, k, float(episode.errors[row]))
        if len(self._episodes) < CROWDED or self._strip is None:  # the strip chart has the time too
            write_text(picture, f"t {time:.2f} s", (-self._font, self._font // 2), self._font)
        self._write_note(picture)
        if self._strip is not None:
            strip = self._strip.at(time)
            picture[-len(strip) :] = strip
        return picture

    def _write_head(self, picture: Picture, k: int, error: float) -> None:
        """Write the name and the tip error (m) of episode k above its arm."""
        left, top = k * self._painters[k].size[0] + self._font, self._font // 2
        write_text(picture, self._episodes[k].name, (left, top), self._font, COLOURS[k])
        if np.isfinite(error):
            text = f"{error:.2f} m" if error >= 1.0 else f"{1e3 * error:.{1 if error < 0.1 else 0}f} mm"
            text = f"{'tip error ' * (len(self._episodes) < CROWDED)}{text}"
            write_text(picture, text, (left, top + self._line), self._font)

    def _write_note(self, picture: Picture) -> None:
        """Write the scales below the arms: that of the deflection in red, at the right."""
        painter, row = self._painters[0], self._painters[0].size[1] - self._line
        magnified, scales = describe_frame(painter.gains, painter.scale, painter.grid)
        write_text(picture, scales, (self._font, row), self._font)
        if magnified:
            write_text(picture, magnified, (-self._font, row), self._font, WARNING)


def _extent(episode: Episode, end: float, gains: tuple[float, float]) -> tuple[Array, Array]:
    """Return points (p, 3) and targets (t, 3), m, up to a time (s), magnified and of the rigid arm."""
    rows = np.unique(np.linspace(0, min(round(end / episode.period), len(episode.time) - 1), VIEW_STATES).astype(int))
    bases, states = episode.base_positions[rows], episode.states[rows]
    drawn = np.stack([curves(episode.model, states, LINK_POINTS, *each).positions for each in (gains, (0.0, 0.0))])
    targets = episode.targets[rows] + bases
    return (drawn + bases[:, None, None]).reshape(-1, 3), targets[np.isfinite(targets).all(axis=1)]


def _outermost_bases(episode: Episode, end: float) -> Array:
    """Return the positions of the base (2, 3), m, farthest from each other up to a time, s; (1, 3) of a fixed base."""
    bases = episode.base_positions[: round(end / episode.period) + 1]
    if episode.bases is None:
        return bases[:1]
    along = bases @ (bases[np.linalg.norm(bases - bases[0], axis=1).argmax()] - bases[0])
    return bases[[along.argmin(), along.argmax()]]


class _ErrorStrip:
    """Strip chart of tip errors over time, of which the part up to a time is shown.

    Args:
        episodes: the episodes.
        end: last time, s.
        size: width and height, pixels.
        letters: height of the letters, pixels.
    """

    def __init__(self, episodes: Sequence[Episode], end: float, size: tuple[int, int], letters: int) -> None:
        self._end = end
        figure = new_figure((size[0] / DPI, size[1] / DPI), DPI, facecolor=PAPER)
        font = 72.0 / DPI * letters  # points
        left, bottom, right, top = 5.0 * letters, 1.5 * letters, 2.0 * letters, 0.4 * letters  # margins, pixels
        width, height = size[0] - left - right, size[1] - bottom - top
        axes = figure.add_axes((left / size[0], bottom / size[1], width / size[0], height / size[1]))
        self._empty = _axes_picture(figure, axes, episodes, end, font)
        for episode, colour in zip(episodes, COLOURS, strict=False):
            axes.plot(episode.time, episode.errors, color=colour, linewidth=0.16 * font)
        figure.canvas.draw()
        self._full = np.array(figure.canvas.buffer_rgba())[..., :3]
        self._columns = axes.transData.transform([(0.0, 0.0), (end, 0.0)])[:, 0]

    def at(self, time: float) -> Picture:
        """Return the strip (height, width, 3) with the curves up to a time, s."""
        first, last = self._columns
        column = round(first + (last - first) * time / self._end) + 1
        return np.concatenate([self._full[:, :column], self._empty[:, column:]], axis=1)


def _axes_picture(figure: Any, axes: Any, episodes: Sequence[Episode], end: float, font: float) -> Picture:
    """Prepare the axes of a strip chart for tip errors (m), and return them as a picture without curves."""
    largest = max(float(np.nanmax(each.errors[each.time <= end])) for each in episodes)
    unit, factor = ("m", 1.0) if largest >= 1.0 else ("mm", 1e3)
    axes.set(xlim=(0.0, end), ylim=(-0.03 * largest, 1.05 * largest))
    axes.xaxis.set_major_formatter(lambda value, _: f"{value:g} s" if value else "")
    axes.yaxis.set_major_formatter(lambda value, _: f"{factor * value:g} {unit}" if value else "0")
    axes.yaxis.get_major_locator().set_params(nbins=3)
    axes.tick_params(labelsize=font, length=2.0, color=MIDDLE, labelcolor=DARK, pad=2.0)
    axes.set_facecolor(PAPER)
    axes.grid(color=LIGHT, linewidth=0.6)
    axes.spines[["top", "right"]].set_visible(False)
    axes.spines[["left", "bottom"]].set_color(MIDDLE)
    axes.text(0.995, 0.98, "tip error", transform=axes.transAxes, fontsize=font, color=DARK, ha="right", va="top")
    figure.canvas.draw()
    return np.array(figure.canvas.buffer_rgba())[..., :3]

"""Overlay of a frame: title, numbers, torque bars and colour scale of the strain."""

from functools import lru_cache
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from flexman_gym.common.arrays import Array
from flexman_gym.common.plot_style import LINK_COLOURS, VIOLET, rgb

GLYPHS = Path(__file__).parent / "glyphs.npz"  # shapes of letters, written by scripts/glyphs.py
FONT_SIZES = (10, 12, 14, 18, 24, 32)  # pixels; heights of the letters in GLYPHS
TIMES = "\N{MULTIPLICATION SIGN}"
TORQUE_ROWS = 6.1  # heights of letters; label, bars and numbers of the torques
TEXT_GAP, MAX_MARGIN = 0.02, 0.25  # fractions of the height; gap of text and arm, largest margin
INK, GREY, WARNING = "#1f2937", "#6b7280", "#b91c1c"
Picture = NDArray[np.uint8]


class Caption(NamedTuple):
    """Text and numbers in a frame; entries that are None or "" are not shown.

    Attributes:
        title: title of the frame.
        time: time since the reset, s.
        error: distance of the tip from its target, m.
        reward: reward of the last environment step.
        torques: commanded motor torques (n,) as fractions of their limits.
        strain: largest strain as a fraction of its limit, which the ends of the colour scale then stand for.
    """

    title: str = ""
    time: float | None = None
    error: float | None = None
    reward: float | None = None
    torques: Array | None = None
    strain: float | None = None

    @staticmethod
    def margins(height: int) -> Array:
        """Return the margins (4,) at the left, right, top and bottom that the overlay of a frame needs.

        Args:
            height: height of the frame, pixels.

        Returns:
            Fractions of the picture; at most MAX_MARGIN, as a small picture would have no room for the arm.
        """
        size, small = font_size(height), font_size(int(0.82 * height))
        top, bottom = size // 2 + 2 * round(1.45 * size), size // 2 + round(TORQUE_ROWS * small)
        return np.minimum([0.06, 0.06, top / height + TEXT_GAP, bottom / height + TEXT_GAP], MAX_MARGIN)

    def draw(self, picture: Picture, gains: tuple[float, float], scale: float, grid: float) -> None:
        """Draw the overlay of a frame: title, time and error at the top, strain scale and torques at the bottom.

        Args:
            picture: frame (height, width, 3), changed in place.
            gains: magnifications of the deflection of the links and of the twist of the joints, shown unless they are
                1.
            scale: strain at the ends of the colour scale; 0 for a rigid arm.
            grid: spacing of the floor grid, m.
        """
        height, width = picture.shape[:2]
        size, small = font_size(height), font_size(int(0.82 * height))
        edge, line = size, round(1.45 * size)
        if self.title:
            write_text(picture, self.title, (size, size // 2), size)
        row = edge // 2 + line * bool(self.title)
        error = "tip error {:.2f} m" if (self.error or 0.0) >= 1.0 else "tip error {:.1f} mm"
        entries = (
            (0.0, self.time, "t {:.2f} s", 1.0),
            (6.5, self.error, error, 1e3 if error.endswith("mm") else 1.0),
            (18.0, self.reward, "reward {:.2f}", 1.0),
        )
        for column, value, form, factor in entries:  # fixed columns: the text does not move while numbers change
            if value is not None:
                write_text(picture, form.format(factor * value), (edge + round(column * small), row), small)
        magnified, line_text = describe_frame(gains, scale, grid)
        if magnified:
            write_text(picture, magnified, (-edge, edge // 2), size, WARNING)
            _write_dot_legend(picture, (-edge, edge // 2 + line), small)
        if scale > 0.0:
            _draw_colour_bar(picture, (edge, height - edge), small)
        if self.strain is not None:
            line_text = f"{describe_frame(gains, 0.0, grid)[1]}   strain {self.strain:.0%} of its limit"
        colour = WARNING if (self.strain or 0.0) > 1.0 else INK
        write_text(picture, line_text, (edge, height - edge - max(small // 2, 5) - round(1.4 * small)), small, colour)
        if self.torques is not None:
            _draw_torque_bars(picture, self.torques, (width - edge, height - edge // 2), small)


@lru_cache(maxsize=len(FONT_SIZES))
def _font(size: int) -> tuple[dict[str, int], NDArray[np.uint8], list[int]]:
    with np.load(GLYPHS) as data:
        letters = {chr(letter): place for place, letter in enumerate(data["letters"].tolist())}
        return letters, data[f"shape_{size}"], data[f"start_{size}"].tolist()


@lru_cache(maxsize=256)
def _text_mask(text: str, size: int) -> NDArray[np.float32]:
    """Return the coverage (h, w), 0 to 1, of each pixel by the letters; "?" replaces letters without a shape."""
    letters, shapes, starts = _font(size)
    places = [letters.get(letter, letters["?"]) for letter in text]
    parts = [shapes[:, starts[place] : starts[place + 1]] for place in places]
    return np.concatenate([shapes[:, :0], *parts], axis=1).astype(np.float32) / np.float32(255.0)


def font_size(height: int) -> int:
    """Return the size of the letters for a picture with `height` rows."""
    return max(size for size in FONT_SIZES if size <= max(height / 33.0, FONT_SIZES[0]))


def write_text(picture: Picture, text: str, place: tuple[int, int], size: int, colour: str = INK) -> None:
    """Write text with its upper left corner at (column, row) = place.

    With a column < 0, the right end of the text is -column pixels from the right edge of the picture.
    """
    shape = _text_mask(text, size)
    column, row = place
    if column < 0:
        column += picture.shape[1] - shape.shape[1]
    top, left = max(-row, 0), max(-column, 0)
    part = picture[max(row, 0) : max(row + shape.shape[0], 0), max(column, 0) : max(column + shape.shape[1], 0)]
    _blend(part, colour, shape[top : top + part.shape[0], left : left + part.shape[1], None])


def _blend(part: Picture, colour: str, opacity: "NDArray[np.float32] | float") -> None:
    """Blend a colour into a part of a picture with an opacity from 0 to 1."""
    base = part.astype(np.float32)
    part[:] = (base + np.float32(opacity) * (rgb(colour).astype(np.float32) - base) + np.float32(0.5)).astype(np.uint8)


def _fill_rectangle(
    picture: Picture, columns: tuple[int, int], rows: tuple[int, int], colour: str, opacity: float = 1.0
) -> None:
    """Fill a rectangle with an opacity from 0 to 1; the ends of the ranges are excluded."""
    _blend(picture[rows[0] : rows[1], columns[0] : columns[1]], colour, opacity)


def describe_frame(gains: tuple[float, float], scale: float, grid: float) -> tuple[str, str]:
    """Return the texts on the magnification ("" at true scale) and on the scales of a frame.

    Args:
        gains: magnifications of the deflection of the links and of the twist of the joints.
        scale: strain at the ends of the colour scale; 0 for a rigid arm.
        grid: spacing of the floor grid, m.
    """
    words = zip(("link deflection", "joint twist"), gains, strict=True)
    magnified = ", ".join(f"{word} {TIMES} {gain:g}" for word, gain in words if gain != 1.0)
    unit, factor = ("µε", 1e6) if scale < 1e-3 else ("%", 1e2)
    return magnified, (f"strain ±{factor * scale:g} {unit}   " if scale > 0.0 else "") + f"grid {grid:g} m"


def _write_dot_legend(picture: Picture, place: tuple[int, int], size: int) -> None:
    """Write the meaning of the violet dot, with the right end at -column, as in `write_text`."""
    text = "true tip"
    left = picture.shape[1] + place[0] - _text_mask(text, size).shape[1] - size
    rows, columns = np.ogrid[: picture.shape[0], : picture.shape[1]]
    dot = (rows - place[1] - 0.75 * size) ** 2 + (columns - left) ** 2 <= (0.35 * size) ** 2
    picture[dot] = rgb(VIOLET)
    write_text(picture, text, place, size)


def _draw_colour_bar(picture: Picture, place: tuple[int, int], size: int) -> None:
    """Draw the colour scale of the strain with its lower left corner at a pixel."""
    column, row = place
    wide, high = min(9 * size, picture.shape[1] - 2 * column), max(size // 2, 5)
    share = np.linspace(-1.0, 1.0, wide)
    picture[row - high : row, column : column + wide] = np.rint(strain_colours(share))


def _draw_torque_bars(picture: Picture, torques: Array, place: tuple[int, int], size: int) -> None:
    """Draw a numbered bar for each motor, up or down from the middle, with the lower right corner at a pixel."""
    wide, half, gap = size, round(1.5 * size), size // 2
    column, middle = place[0] - len(torques) * (wide + gap) + gap, place[1] - half - round(1.4 * size)
    write_text(picture, "torque / limit", (place[0] - picture.shape[1], middle - half - round(1.5 * size)), size)
    for i, torque in enumerate(np.clip(torques, -1.0, 1.0)):
        first = column + i * (wide + gap)
        _fill_rectangle(picture, (first, first + wide), (middle - half, middle + half), GREY, 0.8)
        _fill_rectangle(picture, (first + 1, first + wide - 1), (middle - half + 1, middle + half - 1), "#ffffff", 0.9)
        rows = sorted((middle, middle - round(half * torque)))
        _fill_rectangle(picture, (first + 1, first + wide - 1), (rows[0], rows[1]), LINK_COLOURS[i % len(LINK_COLOURS)])
        _fill_rectangle(picture, (first - 2, first + wide + 2), (middle, middle + 1), GREY)
        number = str(i + 1)
        inset = (wide - _text_mask(number, size).shape[1]) // 2
        write_text(picture, number, (first + inset, middle + half + max(size // 10, 1)), size)


def strain_colours(share: Array) -> Array:
    """Return colours (..., 3), 0 to 255, of strains relative to the scale: -1 is blue, 0 grey, 1 red."""
    ends = np.where(share[..., None] < 0.0, (47.0, 87.0, 200.0), (192.0, 32.0, 44.0))
    return np.array([205.0, 208.0, 212.0]) + np.clip(np.abs(share), 0.0, 1.0)[..., None] * (ends - (205, 208, 212))

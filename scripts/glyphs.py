"""Render the letters of video frames into `glyphs.npz` of `flexman_gym/toolbox/view`, from DejaVu Sans (free font)."""

from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
from PIL import Image, ImageDraw, ImageFont

from flexman_gym.toolbox.view.overlay import FONT_SIZES, GLYPHS

LETTERS = "".join(map(chr, range(32, 127))) + "".join(
    map(chr, (0xB0, 0xB1, 0xB2, 0xB5, 0xB7, 0xD7, 0xE4, 0xF6, 0xFC, 0xDF, 0xE9, 0xF1, 0x3B5, 0x2026))
)
FONT = Path(matplotlib.get_data_path()) / "fonts" / "ttf" / "DejaVuSans.ttf"


def main() -> None:
    """Write the coverage (0 to 255) of all letters of each font size side by side, and their start columns."""
    data: dict[str, Any] = {"letters": np.array([ord(letter) for letter in LETTERS])}
    for size in FONT_SIZES:
        font = ImageFont.truetype(str(FONT), size)
        height = sum(font.getmetrics())
        ends = np.cumsum([0, *(round(font.getlength(letter)) for letter in LETTERS)])
        image = Image.new("L", (int(ends[-1]), height))
        for letter, start, end in zip(LETTERS, ends[:-1], ends[1:], strict=True):
            cell = Image.new("L", (int(end - start), height))  # its own picture, as letters reach into their neighbours
            ImageDraw.Draw(cell).text((0, 0), letter, fill=255, font=font)
            image.paste(cell, (int(start), 0))
        data |= {f"shape_{size}": np.asarray(image), f"start_{size}": ends}
    np.savez_compressed(GLYPHS, **data)


if __name__ == "__main__":
    main()

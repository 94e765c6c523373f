"""Video: frames as a picture, a film or a moving picture, in a file."""

import struct
import zlib
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from flexman_gym.checks import positive, refusal

STILL = 6  # levels by which a colour of a GIF may be off before it is drawn anew
COLOURS, GRAIN = 64, 4  # of a GIF; levels of a channel that count as one when they are chosen
SUFFIXES = (".mp4", ".gif")


def write_video(frames: Sequence[NDArray[np.uint8]], path: str | Path, fps: float = 50.0) -> Path:
    """Writes frames (height, width, 3) of one size as an MP4 (H.264) or as a GIF of 64 colours that repeats.

    An MP4 needs the package imageio-ffmpeg, a GIF Pillow. Of an MP4 the sides are even: an odd last row or column goes.

    Args:
        frames: at least one.
        path: of the file, whose suffix says what it is; its folder is created where it does not exist.
        fps: frames a second.

    Returns:
        The path.

    Raises:
        ImportError: without the package.
        ValueError: for no frames, another suffix and a rate that is not > 0.
    """
    path, rate = Path(path), positive("fps", fps)
    if path.suffix not in SUFFIXES:
        raise refusal("path", str(path), f"a file that ends in {' or '.join(SUFFIXES)}")
    if not len(frames):
        raise refusal("frames", frames, "at least one")
    path.parent.mkdir(parents=True, exist_ok=True)
    try:
        (_write_mp4 if path.suffix == ".mp4" else _write_gif)(frames, path, rate)
    except ModuleNotFoundError as error:
        raise ImportError(f"a {path.suffix} file needs {error.name}: pip install 'flexman_gym[render]'") from error
    return path


def write_picture(frame: NDArray[np.uint8], path: str | Path) -> Path:
    """Writes a frame (height, width, 3) as a PNG, for which no other package is needed; returns the path.

    Args:
        frame: the picture.
        path: of the file; its folder is created where it does not exist.

    Raises:
        OSError: where it cannot be written.
    """
    path, (height, width, _) = Path(path), frame.shape
    rows = np.concatenate([np.zeros((height, 1), dtype=np.uint8), frame.reshape(height, -1)], axis=1)  # unfiltered
    parts = (b"IHDR", struct.pack(">2I5B", width, height, 8, 2, 0, 0, 0)), (b"IDAT", zlib.compress(rows.tobytes(), 9))
    path.parent.mkdir(parents=True, exist_ok=True)
    with path.open("wb") as file:
        file.write(b"\x89PNG\r\n\x1a\n")
        for name, data in (*parts, (b"IEND", b"")):
            file.write(struct.pack(">I", len(data)) + name + data + struct.pack(">I", zlib.crc32(name + data)))
    return path


def _write_mp4(frames: Sequence[NDArray[np.uint8]], path: Path, rate: float) -> None:
    import imageio_ffmpeg

    height, width = (side // 2 * 2 for side in frames[0].shape[:2])
    writer = imageio_ffmpeg.write_frames(
        str(path),
        (width, height),
        fps=rate,
        codec="libx264",
        quality=None,
        macro_block_size=2,
        output_params=["-crf", "23"],
    )
    writer.send(None)
    for frame in frames:
        writer.send(np.ascontiguousarray(frame[:height, :width]))
    writer.close()


def _write_gif(frames: Sequence[NDArray[np.uint8]], path: Path, rate: float) -> None:
    from PIL import Image

    some = np.concatenate([frame.reshape(-1, 3) for frame in frames[:: max(1, len(frames) // 8)]])
    coarse, counts = np.unique(some // GRAIN * GRAIN + GRAIN // 2, axis=0, return_counts=True)
    # by the root of how often they are: else a large background leaves no colours for what is small and matters
    known = np.repeat(coarse, np.ceil(np.sqrt(counts)).astype(int), axis=0)[None].astype(np.uint8)
    palette = Image.fromarray(known).quantize(COLOURS - 1, Image.Quantize.MEDIANCUT)  # and one for what stays
    numbers = (palette.getpalette() or [])[: 3 * (COLOURS - 1)]
    colours = np.array(numbers, dtype=np.int16).reshape(-1, 3)
    shown: list[NDArray[np.uint8]] = []
    for frame in frames:
        now = np.array(Image.fromarray(frame).quantize(palette=palette, dither=Image.Dither.NONE))
        if shown:  # what has hardly changed stays, and needs no bytes
            still = np.abs(colours[shown[-1]] - frame).max(axis=2) <= STILL
            now[still] = shown[-1][still]
        shown.append(now)
    first, *rest = images = [Image.fromarray(now) for now in shown]
    for image in images:
        image.putpalette(numbers)  # its numbers are now those of colours
    first.save(path, save_all=True, append_images=rest, duration=round(1e3 / rate), loop=0, optimize=True)

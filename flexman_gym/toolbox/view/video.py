"""Videos and pictures: frames in files."""

import struct
import subprocess
import zlib
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from typing import BinaryIO

import numpy as np
from numpy.typing import NDArray

from flexman_gym.common.checks import positive
from flexman_gym.common.errors import value_error
from flexman_gym.common.files import write_file

COLOUR_TOLERANCE = 6  # levels of 255; largest colour error for which a pixel of a GIF stays as in the previous frame
COLOURS, COLOUR_STEP = 128, 4  # number of colours of a GIF; levels of a channel merged for their selection
SUFFIXES = (".mp4", ".gif")


def write_video(frames: Sequence[NDArray[np.uint8]], path: str | Path, fps: float = 50.0) -> Path:
    """Write frames of one size as an MP4 (H.264) or as a repeating GIF of 128 colours; return the path.

    An MP4 needs the package imageio-ffmpeg, a GIF needs Pillow. MP4 has even widths and heights: an odd last row or
    column is dropped.

    Args:
        frames: frames (height, width, 3), at least one.
        path: path of the file with the suffix .mp4 or .gif; its folder is created if it does not exist.
        fps: frames per second.

    Raises:
        ImportError: without the package.
    """
    path, rate = Path(path), positive("fps", fps)
    if path.suffix not in SUFFIXES:
        raise value_error("path", str(path), f"a file that ends in {' or '.join(SUFFIXES)}")
    if not len(frames):
        raise value_error("frames", frames, "at least one")
    write = _write_mp4 if path.suffix == ".mp4" else _write_gif
    try:
        write_file(path, lambda file: write(frames, file, rate))
    except ModuleNotFoundError as error:
        raise ImportError(f"a {path.suffix} file needs {error.name}: pip install 'flexman_gym[render]'") from error
    return path


def write_picture(frame: NDArray[np.uint8], path: str | Path) -> Path:
    """Write a frame as a PNG, without any further package; return the path.

    Args:
        frame: frame (height, width, 3).
        path: path of the file; its folder is created if it does not exist.

    Raises:
        OSError: if the file cannot be written.
    """
    path = Path(path)
    write_file(path, encode_picture(frame))
    return path


def encode_picture(frame: NDArray[np.uint8]) -> bytes:
    """Return the bytes of a PNG file with a frame (height, width, 3)."""
    height, width, _ = frame.shape
    rows = np.concatenate([np.zeros((height, 1), dtype=np.uint8), frame.reshape(height, -1)], axis=1)  # unfiltered
    parts = (b"IHDR", struct.pack(">2I5B", width, height, 8, 2, 0, 0, 0)), (b"IDAT", zlib.compress(rows.tobytes(), 9))
    return b"\x89PNG\r\n\x1a\n" + b"".join(
        struct.pack(">I", len(data)) + name + data + struct.pack(">I", zlib.crc32(name + data))
        for name, data in (*parts, (b"IEND", b""))
    )


def _write_mp4(frames: Sequence[NDArray[np.uint8]], file: BinaryIO, rate: float) -> None:
    """Encode frames by FFmpeg; its exit status, which `imageio_ffmpeg.write_frames` omits, tells a full disk."""
    import imageio_ffmpeg

    height, width = (side // 2 * 2 for side in frames[0].shape[:2])
    given = ["-f", "rawvideo", "-pix_fmt", "rgb24", "-s", f"{width}x{height}", "-r", f"{rate:g}", "-i", "-"]
    written = ["-an", "-vcodec", "libx264", "-pix_fmt", "yuv420p", "-crf", "23", "-f", "mp4", file.name]
    command = [imageio_ffmpeg.get_ffmpeg_exe(), "-y", "-v", "error", *given, *written]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stderr=subprocess.PIPE) as process:
        assert process.stdin is not None
        with suppress(BrokenPipeError):
            for frame in frames:
                process.stdin.write(frame[:height, :width].tobytes())
        lines = process.communicate()[1].decode(errors="replace").split("\n")
    if process.returncode:
        reason = " ".join(lines[0].split()) or f"exit status {process.returncode}"
        raise OSError(f"FFmpeg could not write the video: {reason}")


def _write_gif(frames: Sequence[NDArray[np.uint8]], file: BinaryIO, rate: float) -> None:
    from PIL import Image

    some = np.concatenate([frame.reshape(-1, 3) for frame in frames[:: max(1, len(frames) // 8)]])
    coarse, counts = np.unique(some // COLOUR_STEP * COLOUR_STEP + COLOUR_STEP // 2, axis=0, return_counts=True)
    # weights: root of the frequency of a colour, because a large background would leave no colours for small details
    weighted = np.repeat(coarse, np.ceil(np.sqrt(counts)).astype(int), axis=0)[None].astype(np.uint8)
    palette = Image.fromarray(weighted).quantize(
        COLOURS - 1, Image.Quantize.MEDIANCUT
    )  # one more colour of the palette is reserved for unchanged pixels
    numbers = (palette.getpalette() or [])[: 3 * (COLOURS - 1)]
    colours = np.array(numbers, dtype=np.int16).reshape(-1, 3)
    shown: list[NDArray[np.uint8]] = []
    for frame in frames:
        now = np.array(Image.fromarray(frame).quantize(palette=palette, dither=Image.Dither.NONE))
        if shown:  # pixels that hardly change keep their colour, which saves bytes
            unchanged = np.abs(colours[shown[-1]] - frame).max(axis=2) <= COLOUR_TOLERANCE
            now[unchanged] = shown[-1][unchanged]
        shown.append(now)
    first, *rest = images = [Image.fromarray(now) for now in shown]
    for image in images:
        image.putpalette(numbers)
    first.save(file, "GIF", save_all=True, append_images=rest, duration=round(1e3 / rate), loop=0, optimize=True)

"""Video: films and moving pictures have the frames that they are given."""

import numpy as np
import pytest

from flexman_gym.toolbox.view.video import write_video

FRAMES = [np.full((36, 48, 3), (250, 25 * i, 10), dtype=np.uint8) for i in range(10)]


def test_a_gif_has_its_frames_and_repeats(tmp_path):
    image = pytest.importorskip("PIL.Image")
    with image.open(write_video(FRAMES, tmp_path / "new" / "a.gif", 10.0)) as read:
        assert (read.n_frames, read.size, read.info["duration"], read.info["loop"]) == (10, (48, 36), 100, 0)
        read.seek(9)
        assert np.abs(np.asarray(read.convert("RGB"))[0, 0].astype(int) - FRAMES[9][0, 0]).max() < 25


def test_a_film_has_its_frames(tmp_path):
    ffmpeg = pytest.importorskip("imageio_ffmpeg")
    path = write_video([frame[:35] for frame in FRAMES], tmp_path / "a.mp4", 25.0)
    assert ffmpeg.count_frames_and_secs(str(path)) == (10, pytest.approx(0.4))
    assert next(ffmpeg.read_frames(str(path)))["size"] == (48, 34)


@pytest.mark.parametrize(
    ("arguments", "field"), [((FRAMES, "a.avi"), "path"), (([], "a.gif"), "frames"), ((FRAMES, "a.gif", 0.0), "fps")]
)
def test_bad_input_is_refused_in_one_line(arguments, field, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(ValueError, match=rf"^{field}: "):
        write_video(*arguments)
    assert not list(tmp_path.iterdir())

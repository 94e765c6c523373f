"""Pictures of episodes: they show errors and torques of every policy, and one episode has one picture."""

import numpy as np
import pytest

pytest.importorskip("matplotlib")
pytest.importorskip("rich")

from matplotlib.image import imread

from flexman_agents.evaluation import Record
from flexman_agents.pictures import draw_episodes


def record(error, action):
    """An episode of 1 s whose error fades and whose action stays."""
    times = np.linspace(0.0, 1.0, 51)
    return Record(np.zeros((51, 3)), error * np.exp(-5.0 * times), np.full((50, 2), action), np.zeros(50), "")


def test_a_picture_shows_errors_and_actions_of_every_policy(tmp_path):
    def picture(**records):
        draw_episodes(records, 0.02, tmp_path / "folder" / "a.png")
        return imread(tmp_path / "folder" / "a.png")

    first = picture(a=record(1.0, 0.5), b=record(0.5, -0.5))
    assert np.array_equal(first, picture(a=record(1.0, 0.5), b=record(0.5, -0.5)))
    for other in (
        {"a": record(0.9, 0.5), "b": record(0.5, -0.5)},
        {"a": record(1.0, 0.5), "b": record(0.5, -0.4)},
        {"a": record(1.0, 0.5), "c": record(0.5, -0.5)},
    ):
        assert not np.array_equal(first, picture(**other))


def test_no_error_at_all_can_be_drawn(tmp_path):
    draw_episodes({"still": record(0.0, 0.0)}, 0.02, tmp_path / "a.png")
    assert (tmp_path / "a.png").stat().st_size > 5_000

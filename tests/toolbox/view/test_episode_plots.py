"""Plots of episodes: tip errors and torques of every agent, and equal plots of equal episodes."""

import numpy as np
import pytest

pytest.importorskip("matplotlib")

from matplotlib.cbook import STEP_LOOKUP_MAP
from matplotlib.image import imread

from flexman_gym.evaluation.rollouts import EpisodeRecord
from flexman_gym.toolbox.view.trajectories import draw_episodes


def record(error, action):
    """An episode of 1 s whose error fades and whose action stays."""
    times = np.linspace(0.0, 1.0, 51)
    errors, actions = error * np.exp(-5.0 * times), np.full((50, 2), action)
    return EpisodeRecord(np.zeros((51, 3)), errors, actions, np.zeros(50), "", 0.02, 0.005)


@pytest.mark.slow
def test_a_picture_shows_errors_and_actions_of_every_policy(tmp_path):
    def picture(**records):
        draw_episodes(records, tmp_path / "folder" / "a.png")
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
    draw_episodes({"still": record(0.0, 0.0)}, tmp_path / "a.png")
    assert (tmp_path / "a.png").stat().st_size > 5_000


def test_a_torque_is_drawn_over_the_period_in_which_it_acts(drawn, tmp_path):
    actions = np.random.default_rng(0).uniform(-1.0, 1.0, (50, 2))
    made = EpisodeRecord(np.zeros((51, 3)), np.ones(51), actions, np.zeros(50), "", 0.02, 0.02)
    draw_episodes({"a": made}, tmp_path / "a.png")
    middles = 0.02 * (np.arange(50) + 0.5)
    for motor in range(2):
        curve = drawn[-1].axes[1 + motor].get_lines()[0]
        result = np.interp(middles, *STEP_LOOKUP_MAP[curve.get_drawstyle()](*curve.get_data()))
        assert result[1:] == pytest.approx(actions[1:, motor]), "the first has no width"


def test_the_line_of_the_band_is_at_the_band_and_says_so(drawn, tmp_path):
    draw_episodes({"a": record(1.0, 0.5)}, tmp_path / "a.png")
    (line,) = (line for line in drawn[-1].axes[0].get_lines() if line.get_linestyle() == "--")
    assert set(line.get_ydata()) == {0.005} and [text.get_text() for text in drawn[-1].axes[0].texts] == ["5 mm"]

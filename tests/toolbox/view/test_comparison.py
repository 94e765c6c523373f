"""Episodes side by side: names, arms and strip chart have places of their own, and the chart shows the past only."""

from dataclasses import replace

import numpy as np
import pytest

import flexman_gym as fm
from flexman_gym.common.plot_style import BLUE, RED, rgb
from flexman_gym.simulation.episode import Episode
from flexman_gym.toolbox.view.comparison import MAX_GAIN, VISIBLE_SAG, side_by_side, suggested_gain

from oracles.sags import largest_sag

pytest.importorskip("matplotlib")
ROWS, SIZE = 101, (480, 360)
HEAD, STRIP, LINE = 61, 360 - 94, 26  # rows; end of the names, start of the chart, line of text


def episode(name, bend=0.02):
    """Return an episode of 2 s in which the tip nears its target while the second link vibrates."""
    model = fm.build_model(fm.catalog.paper_rrr(joint_stiffness=5000.0), 1, modes=4)
    time = 0.02 * np.arange(ROWS)
    states = np.tile(model.initial_state((0.3, 0.4, -0.6)), (ROWS, 1))
    states[:, model.elastic_columns(1)] = bend * np.sin(6.0 * time)[:, None]
    tips = fm.curves(model, states, 2).positions[:, -1, -1]
    targets = np.tile(tips[0] + (0.0, 1.0, 0.0), (ROWS, 1))
    about = Episode.metadata(model, name=name, seed=1, environment="FlexRRR-v0", units={})
    actions = np.zeros((ROWS - 1, 3))
    return Episode(time, states, tips, targets, 3.0 * np.exp(-2.0 * time), actions, actions, actions[:, 0], {}, about)


def coloured(picture, colour):
    """Return the columns of the pixels of a colour."""
    return np.unique(np.nonzero(np.abs(picture.astype(int) - rgb(colour)).max(axis=2) < 40)[1])


@pytest.fixture(scope="module")
def frames():
    return side_by_side([episode("one"), episode("two", 0.0)], SIZE, rate=5.0, hold=1.0)


def test_the_chart_shows_the_tip_errors_up_to_the_time_of_the_frame(frames):
    ends = [coloured(frame[STRIP:], RED).max(initial=0) for frame in frames[:11]]
    assert ends[0] < 60 and np.allclose(np.diff(ends[1:]), np.diff(ends[1:]).mean(), atol=2.0)
    assert 440 < ends[-1] < 480 and (frames[3][STRIP:, ends[3] + 3 :] == frames[0][STRIP:, ends[3] + 3 :]).all()


def test_names_have_the_colours_of_their_curves_and_stand_above_the_arms(frames):
    for colour, half in ((BLUE, slice(0, 240)), (RED, slice(240, 480))):
        assert len(coloured(frames[5][:HEAD, half], colour)) > 5
        assert not len(coloured(np.delete(frames[5], np.r_[half], axis=1)[:HEAD], colour))


def test_the_last_frame_is_held_and_the_others_move(frames):
    assert len(frames) == 11 + 5 and all(np.array_equal(frame, frames[10]) for frame in frames[11:])
    assert len({frame.tobytes() for frame in frames}) == 11


def test_a_gain_bends_the_drawn_links_says_so_and_keeps_the_arm_in_the_picture():
    arms = [episode("one")]
    plain, large = (side_by_side(arms, SIZE, rate=5.0, gain=gain) for gain in (1.0, 20.0))
    note = np.s_[STRIP - LINE : STRIP, 240:]
    reddish = [
        ((frames[0][note][..., 0].astype(int) - frames[0][note][..., 1]) > 60).any() for frames in (plain, large)
    ]
    assert reddish == [False, True]
    for frame in large:
        room = frame[HEAD + 2 : STRIP - LINE].astype(int)
        dark = np.nonzero(room.max(axis=2) < 70)
        assert all(each.min() > 3 and each.max() < size - 3 for each, size in zip(dark, room.shape, strict=False))


def test_no_band_of_the_picture_is_white(frames):
    """The arms have the whole picture above the chart, and the chart has the colour of the floor."""
    white = (frames[5] == 255).all(axis=2).mean(axis=1)
    assert white[: STRIP // 2].max() < 0.6 and white[STRIP // 2 :].max() < 0.05


def test_the_suggested_gain_makes_the_largest_sag_of_a_link_visible():
    """The sag drawn is at most VISIBLE_SAG of the length, and would be more with the next of the gains 1, 2, 5, 10."""
    for bend in (0.1, 2.0):
        one = episode("one", bend)
        gain, sag = suggested_gain([one, episode("still", 0.0)]), largest_sag(one)
        assert gain < MAX_GAIN and gain * sag <= VISIBLE_SAG < 2.5 * gain * sag
    assert suggested_gain([episode("still", 0.0)]) == MAX_GAIN


def test_episodes_without_targets_have_no_chart():
    arm = episode("scene")
    bare = replace(arm, errors=np.full(ROWS, np.nan), targets=np.full((ROWS, 3), np.nan))
    (frame, *_) = side_by_side([bare], SIZE, rate=1.0)
    assert frame.shape == (360, 480, 3) and not len(coloured(frame[STRIP:], BLUE))
    for wrong in ([], 5 * [bare]):
        with pytest.raises(ValueError, match=r"^episodes: .* give 1 to 4 of them$"):
            side_by_side(wrong)

"""Sizes of results: a period far below a duration is refused in one line before arrays are made."""

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import flexman_gym as fm
from flexman_gym.common.checks import sample_count
from flexman_gym.envs.config.configuration import Configuration
from flexman_gym.evaluation.rollouts import RolloutLoop
from flexman_gym.toolbox.controllers.arm_scales import SlewBounds
from flexman_gym.toolbox.controllers.input_shaping import shaped_motion
from flexman_gym.toolbox.controllers.input_shaping.motion import Motion
from flexman_gym.toolbox.controllers.input_shaping.shaped_motion import ShapedMotion
from flexman_gym.toolbox.controllers.input_shaping.shapers import design_shaper
from flexman_gym.toolbox.controllers.references import trajectories
from flexman_gym.toolbox.view.comparison import MAX_FRAMES, side_by_side

pytestmark = pytest.mark.slow

PATH = 3.0 * np.linspace(0.0, 1.0, 12) ** 2 - 2.0 * np.linspace(0.0, 1.0, 12) ** 3


def test_a_number_of_samples_covers_the_duration_and_is_bounded():
    assert [sample_count("period", 0.25, each) for each in (0.0, 0.25, 0.26, 1.0)] == [0, 1, 2, 4]
    assert sample_count("period", 1e-6, 1.0) == 10**6
    for period, words in ((1e-7, "at least 1e-06 (s), at most 1000000 times in 1 s"), (1e-320, "at least 1e-06 (s)"),
                          (0.0, "a finite number > 0"), (np.nan, "a finite number > 0")):  # fmt: skip
        with pytest.raises(ValueError, match=re.escape(f"period: {period} is not allowed; give {words}")):
            sample_count("period", period, 1.0)


@pytest.mark.parametrize("frequencies", [(3.0,), (2.0, 7.0)], ids=len)
@pytest.mark.parametrize("shaper", ["auto", "zvd"])
def test_a_shaped_motion_has_at_most_the_samples_of_its_bound(frequencies, shaper):
    """At the shortest period that is allowed it is shaped, and below it refused with the rate that is allowed."""
    ringing = fm.Ringing(frequencies, (0.02,) * len(frequencies))
    delay = sum((1.5 if shaper == "auto" else 1.0) / each for each in frequencies)  # s; two-hump EI, ZVD
    for factor, allowed in ((0.9, False), (1e-3, False), (1.1, True)):
        period = factor * delay / shaped_motion.MAX_SAMPLES
        motion = Motion(0.0, period, PATH[:, None], (0,), Path("motion.csv"), {})
        if allowed:
            found = ShapedMotion.find(motion, ringing, shaper=shaper)
            assert len(found.motion.values) <= shaped_motion.MAX_SAMPLES
            assert found.motion.duration >= 0.5 / frequencies[0], "a shaper of half a period at least"
        else:
            words = f"motion.csv: '{1.0 / period:.4g} samples per s' is not allowed; give at most "
            with pytest.raises(ValueError, match=re.escape(words)):
                ShapedMotion.find(motion, ringing, shaper=shaper)


def test_a_sampled_shaper_is_refused_beyond_a_million_periods():
    shaper = design_shaper("zv", 1.0)
    assert len(shaper.sample(0.5e-6)) == 10**6 + 2
    with pytest.raises(ValueError, match=re.escape("period: 1e-07 is not allowed; give at least 5e-07 (s)")):
        shaper.sample(1e-7)


@pytest.mark.parametrize(("agent", "environment"), [
    ("pd-shaped", "FlexOne-v0"), ("lqr-tracking", "FlexOne-v0"), ("mpc", "FlexOne-v0"),
    ("lqr-tracking", "FlexRRR-Track-v0"),
])  # fmt: skip
def test_a_command_of_too_many_control_periods_is_refused_at_the_reset(agent, environment):
    tiny = Configuration.find(environment).replace(control_period=1e-7)
    with pytest.raises(ValueError, match=r"period: 1e-07 is not allowed; give at least \S+ \(s\), at most 10+ times"):
        RolloutLoop(agent, tiny, [9000])


def test_a_planned_slew_is_refused_beyond_its_bound_of_control_periods(monkeypatch):
    """With a bound of one period less than the fastest slew has; with just as many it is planned."""
    model = fm.build_model(fm.catalog.one_joint(), 1)
    given = model, np.zeros(1), np.ones(1), SlewBounds(np.full(1, 0.5), 0.8), 0.02, "quintic"
    count = len(trajectories.plan_slew(*given).torques)
    monkeypatch.setattr(trajectories, "MAX_PERIODS", count)
    assert len(trajectories.plan_slew(*given).torques) == count
    monkeypatch.setattr(trajectories, "MAX_PERIODS", count - 1)
    with pytest.raises(ValueError, match=r"control_period: 0\.02 is not allowed; give at least"):
        trajectories.plan_slew(*given)


def test_a_rollout_of_too_many_control_periods_is_refused_before_the_first():
    tiny = Configuration.find("FlexOne-v0").replace(control_period=1e-8)
    with pytest.raises(ValueError, match=re.escape("horizon: 10.0 is not allowed; give at most 0.5 (s): 2 x 50000000")):
        fm.rollout("pd", tiny, [9000, 9001])


def test_a_video_of_too_many_frames_is_refused_before_the_first():
    pytest.importorskip("matplotlib")
    episode = fm.rollout("zero", "FlexOne-v0", [0]).episode(0)
    long = replace(episode, time=100.0 * episode.time)
    words = f"seconds: 1000.0 is not allowed; give at most 60 (s), {MAX_FRAMES} frames"
    with pytest.raises(ValueError, match=re.escape(words)):
        side_by_side([long], rate=50.0)
    assert len(side_by_side([long], (480, 360), rate=1.0, seconds=2.0)) == 3

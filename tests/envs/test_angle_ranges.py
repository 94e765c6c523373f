"""Angle ranges of joints: starts, goals and derived settings lie within them, around their middle."""

from dataclasses import replace

import gymnasium as gym
import numpy as np
import pytest

import flexman_gym as fm
from flexman_gym.envs.config.arm_description import describe
from flexman_gym.envs.config.arm_settings import ANGLE_MARGIN, LIMIT_FACTOR, arm_facts, derived_settings
from flexman_gym.envs.config.configuration import Configuration
from flexman_gym.envs.postures import PostureRanges
from flexman_gym.toolbox.league.worst_case import Box

from oracles.assertions import refusal

RANGES = ((0.5, 2.1), (-4.0, -3.0))


def ranged_arm(ranges=RANGES, **changes):
    """Return the planar arm with angle ranges of its joints and other changes of them."""
    arm = fm.catalog.planar_2r()
    joints = [replace(joint, angle_range=each, torque_limit=20.0, **changes)
              for joint, each in zip(arm.joints, ranges, strict=True)]  # fmt: skip
    return replace(arm, joints=joints)


def inside(postures, ranges=RANGES):
    """Return True if postures (..., n) are within the ranges."""
    low, high = np.array(ranges).T
    return bool(np.all((postures >= low) & (postures <= high)))


@pytest.mark.parametrize("task", ["slew", "hold", {"kind": "track", "size": 0.05, "middle": 0.3}])
def test_episodes_start_and_end_within_the_ranges(task):
    envs = gym.make_vec("FlexPlanar-v0", 40, "vector_entry_point", arm=ranged_arm(), task=task)
    envs.reset(seed=0)
    view = envs.unwrapped.episodes.view
    assert inside(view.motor_angles) and inside(view.goal_angles)
    assert np.abs(view.motor_angles - np.mean(RANGES, axis=1)).max() <= 0.8
    envs.close()


def test_slews_of_a_wide_range_are_those_around_zero_moved_to_its_middle():
    wide = ((1.0, 9.0), (-6.0, 2.0))
    named = {"settings": "named", "limits": {"angle": 10.0}}
    drawn = [gym.make("FlexPlanar-v0", arm=ranged_arm(each), **named) for each in (wide, (None, None))]
    for env in drawn:
        env.reset(seed=3)
    views = [env.unwrapped.episodes.view for env in drawn]
    for name in ("motor_angles", "goal_angles"):
        moved, plain = (getattr(view, name)[0] for view in views)
        assert moved == pytest.approx(plain + np.array([5.0, -2.0]), abs=1e-12)


def test_changes_end_at_the_range_and_not_beyond():
    ranges = PostureRanges.of(ranged_arm())
    starts = ranges.draw_starts(np.random.default_rng(0), 10.0, (500,))
    changes = ranges.draw_changes(np.random.default_rng(1), starts, 0.4)
    assert inside(starts) and inside(starts + changes) and np.abs(changes).max() <= 0.4
    # a start is uniform in the whole range where it is narrower than the largest start
    assert np.ptp(starts, axis=0) == pytest.approx([1.6, 1.0], rel=0.02)


def test_the_worst_case_is_searched_within_the_ranges():
    environment = Configuration("FlexPlanar-v0", {"arm": ranged_arm()})
    box = Box(environment)
    corners = np.random.default_rng(0).choice([-1.0, 1.0], (50, box.size))
    options = box.options(corners)
    assert inside(options["start"]) and inside(options["goal_angles"])
    assert inside(box.options(np.zeros((1, box.size)))["start"] - np.mean(RANGES, axis=1) + [1.3, -3.5])


def test_a_goal_of_the_tip_is_reached_within_the_ranges_or_refused():
    arm = ranged_arm(((-2.0, 2.0), (0.2, 2.5)))
    env = gym.make("FlexPlanar-v0", arm=arm)
    view = env.unwrapped.episodes.view
    up, down = (view.rest_tips(np.array([[0.4, bend]]))[0] for bend in (0.9, -0.9))
    for tip in (up, down):  # the second posture has a mirror image with a positive angle of the elbow
        env.reset(seed=0, options={"goal_tip": tip})
        goal = env.unwrapped.episodes.view.goal_angles
        assert inside(goal, ((-2.0, 2.0), (0.2, 2.5))) and view.rest_tips(goal)[0] == pytest.approx(tip, abs=1e-6)
    narrow = gym.make("FlexPlanar-v0", arm=ranged_arm(((-0.1, 0.1), (0.2, 0.3))))
    line = refusal(lambda: narrow.reset(seed=0, options={"goal_tip": down}))
    assert line.startswith("options['goal_tip']: ") and line.endswith("within the angle ranges of its joints")


def test_a_goal_beyond_the_limit_of_the_angles_is_refused():
    env = gym.make("FlexPlanar-v0", limits={"angle": 1.0})
    line = refusal(lambda: env.reset(seed=0, options={"start": [0.0, 0.0], "goal_angles": [0.2, -1.2]}))
    assert "goal of motor_angles -1.2 rad beyond limits.angle, 1" in line


def test_frequencies_are_those_at_the_middle_of_the_ranges():
    arm = ranged_arm()
    facts = arm_facts(arm, [20.0, 20.0])
    model = fm.build_model(arm, elements=2)
    assert arm.home == facts.home == pytest.approx((1.3, -3.5))
    assert facts.held == pytest.approx(fm.modes(model, arm.home).frequencies[:4])
    assert facts.held[0] > 1.5 * arm_facts(ranged_arm((None, None)), [20.0, 20.0]).held[0]
    assert all(inside(posture) for posture in facts.postures)
    assert "at [1.3, -3.5] rad" in describe(arm).lines[1]


def test_the_limit_of_the_angles_includes_the_ranges():
    settings = derived_settings(ranged_arm(((3.0, 7.0), None)), (20.0, 20.0), (0.8, 0.8))
    assert settings["limits"].angle == 7.0 + ANGLE_MARGIN
    assert derived_settings(ranged_arm(), (20.0, 20.0), (0.8, 0.8))["limits"].angle == 4.0 + ANGLE_MARGIN
    assert derived_settings(ranged_arm((None, None)), (20.0, 20.0), (0.8, 0.8))["limits"].angle == fm.Limits().angle


def test_speed_limits_lengthen_slews_and_do_not_end_episodes():
    """A controller without planned motions is tested as without speed limits, which a warning names."""
    slow, free = ranged_arm(speed_limit=0.05), ranged_arm()
    found = [arm_facts(arm, (20.0, 20.0)) for arm in (slow, free)]
    assert found[0].rate <= 0.05 / 0.85 * 1.001 < found[1].rate == found[1].torque_rate == found[0].torque_rate
    limits = [derived_settings(arm, (20.0, 20.0), (0.8, 0.8))["limits"].rate for arm in (slow, free)]
    assert limits[0] == limits[1] >= LIMIT_FACTOR * found[1].rate * (1.0 - 1e-6)
    (line,) = (line for line in describe(slow).warnings if "speed limits" in line)
    assert f"reach {found[1].torque_rate:.3g} rad/s, joint 1 allows 0.05 rad/s" in line
    assert not any("speed limits" in line for line in describe(free).warnings)


def test_a_rotor_without_its_gear_ratio_is_named():
    """Rotors of geared arms have at least a ten-thousandth of the inertia about their joint."""
    arm = fm.catalog.planar_2r(joint_stiffness=20.0)
    light = replace(arm, joints=[replace(joint, rotor_inertia=1e-8, torque_limit=20.0) for joint in arm.joints])
    (line,) = (line for line in describe(light).warnings if "the rotor of" in line)
    assert line.startswith("the rotor of joint 1 has 1e-08 kg m^2, ") and line.endswith("square of the gear ratio")
    assert not any("rotor of" in line for line in describe(arm, torque_limit=20.0).warnings)
    facts = arm_facts(arm, (20.0, 20.0))
    rigid = fm.build_model(arm, flexible_links=False, flexible_joints=False)
    assert facts.inertia == pytest.approx(np.diag(fm.mass_matrix(rigid, np.zeros(4))), rel=1e-3)

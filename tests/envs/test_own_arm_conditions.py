"""Conditions for an arm of the user: payloads, friction and ripple in proportion to the arm."""

from dataclasses import replace

import pytest

import flexman_gym as fm
from flexman_gym.envs.config.conditions import condition_for_arm
from flexman_gym.envs.config.configuration import Configuration
from flexman_gym.envs.config.named_environments import NAMED_ENVIRONMENTS, condition_names, condition_settings

ID = "FlexPlanar-v0"


def named_like(payload=0.1, factor=1.0):
    """Return the named arm with a payload (kg) and thicker walls, and torques and inertias times a factor."""
    arm = NAMED_ENVIRONMENTS[ID].arm
    joints = [replace(each, torque_limit=factor * each.torque_limit) for each in arm.joints]
    links = [replace(each, area=1.01 * each.area) for each in arm.links]
    return replace(arm, links=links, joints=joints, payload=fm.Payload(payload))


def test_an_arm_like_the_named_one_has_the_ranges_of_the_condition():
    for condition in condition_names(ID)[1:]:
        found = condition_for_arm(ID, condition, named_like())
        usual = condition_settings(ID, condition).get("randomisation", {})
        for name, span in usual.items():
            assert found["randomisation"][name] == pytest.approx(span, rel=0.02), name


def test_payloads_are_in_proportion_to_that_of_the_arm():
    light, heavy = (
        condition_for_arm(ID, "payload", named_like(mass))["randomisation"]["payload_mass"] for mass in (0.1, 0.7)
    )
    assert heavy == pytest.approx([7.0 * each for each in light]) and light == [0.0, 0.2]


def test_friction_is_the_same_share_of_the_torque_limits():
    usual, strong = (condition_for_arm(ID, "friction", named_like(factor=factor))["arm"] for factor in (1.0, 3.0))
    for a, b in zip(usual.joints, strong.joints, strict=True):
        assert b.coulomb_friction == pytest.approx(3.0 * a.coulomb_friction) and a.coulomb_friction > 0.0


def test_joints_with_friction_keep_their_own():
    arm = named_like()
    rubbing = replace(arm, joints=[replace(each, coulomb_friction=0.05) for each in arm.joints])
    found = condition_for_arm(ID, "friction", rubbing)["arm"]
    assert [each.coulomb_friction for each in found.joints] == [0.05, 0.05]


def test_ranges_of_springs_are_left_out_for_an_arm_without_springs():
    arm = named_like()
    rigid = replace(arm, joints=[replace(each, stiffness=None, damping=0.0) for each in arm.joints])
    ranges = condition_for_arm(ID, "unmodelled", rigid)["randomisation"]
    assert "backlash" not in ranges and "soft_stiffness" not in ranges and "ripple_torque" in ranges


def test_a_configuration_applies_them_and_given_settings_take_precedence():
    arm = named_like(0.3)
    found = Configuration(ID, {"condition": "unknown-lab", "arm": arm, "horizon": 3.0})
    assert found.randomised_ranges["payload_mass"] == pytest.approx([0.0, 0.6]) and found.horizon == 3.0
    assert found.derived.keys() == {"control_period", "limits", "slew_time"} and "gains" not in found.given


@pytest.mark.parametrize("condition", ["unknown-lab", "payload", "friction"])
def test_a_condition_as_a_change_of_a_setting_is_that_of_the_arm(condition, tmp_path):
    """In a mapping, as a change, and as a change of a file."""
    arm = named_like(0.3)
    path = str(tmp_path / "own.yaml")
    Configuration(ID, {"arm": arm}).save(path)
    given = Configuration(ID, {"arm": arm, "condition": condition})
    for found in (Configuration(ID, {"arm": arm}), Configuration.find(path)):
        changed = found.changed([f"condition={condition}"])
        assert (changed.arm, changed.randomised_ranges) == (given.arm, given.randomised_ranges)
    assert given.randomised_ranges != Configuration(ID, {"condition": condition}).randomised_ranges or not (
        given.randomised_ranges
    )

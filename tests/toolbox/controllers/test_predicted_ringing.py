"""Ringing predicted from a model: closed form of one elastic joint, and the range of payloads."""

import numpy as np
import pytest

import flexman_gym as fm
from flexman_gym.toolbox.controllers.input_shaping.predicted_ringing import predicted_ringing
from flexman_gym.toolbox.identification.ringing import FREQUENCY_DEVIATION

STIFFNESS = 90.0


def one_link(payload=0.0):
    """Return a rigid link behind an elastic joint, and its moment of inertia about the joint, kg m^2."""
    arm = fm.catalog.one_link(rotor_inertia=0.4, joint_stiffness=STIFFNESS)
    link = arm.links[0]
    inertia = link.mass * link.length**2 / 3 + link.density * link.length * link.second_moment_z
    return fm.build_model(arm, flexible_links=False), inertia + payload * link.length**2


def test_of_one_elastic_joint_it_is_the_closed_form():
    model, inertia = one_link()
    found = predicted_ringing(model, [0.3])
    assert found.frequencies == pytest.approx([np.sqrt(STIFFNESS / inertia) / (2 * np.pi)], rel=1e-6)


def test_its_deviation_covers_the_payloads():
    model = one_link()[0]
    found = predicted_ringing(model, [0.3], payloads=(0.2, 0.8))
    light, heavy = (np.sqrt(STIFFNESS / one_link(mass)[1]) / (2 * np.pi) for mass in (0.2, 0.8))
    middle = np.sqrt(STIFFNESS / one_link(0.5)[1]) / (2 * np.pi)
    assert found.frequencies == pytest.approx([middle], rel=1e-6)
    expected = np.hypot((light - heavy) / (2.0 * middle), FREQUENCY_DEVIATION)
    assert found.deviation == pytest.approx([expected], rel=1e-3)


def test_an_arm_without_springs_has_nothing_to_shape():
    arm = fm.catalog.one_link(joint_stiffness=None)
    with pytest.raises(ValueError, match="the motors excite no vibration"):
        predicted_ringing(fm.build_model(arm, flexible_links=False, flexible_joints=False), [0.3])

"""Machines: published arms have the numbers of their sources."""

import numpy as np
import pytest

import flexman_gym as fm
from flexman_gym.verification.machines import published_rows

from oracles.refusals import refusal


def test_the_quanser_has_the_numbers_of_its_data_file():
    """The table of scripts/studies/machine/data: EI, torque per current, inertia at the joints, and masses."""
    arm = fm.catalog.quanser_2dsfl()
    strips = [link.sections[0] for link in arm.links]
    assert [each.youngs_modulus * each.second_moment_z for each in strips] == pytest.approx([2.690, 0.4614], rel=3e-4)
    motors = [joint.motor for joint in arm.joints]
    assert [motor.torque_per_ampere for motor in motors] == pytest.approx([8.925, 0.870])
    assert [joint.rotor_inertia for joint in arm.joints] == pytest.approx([0.06354, 0.00302])
    assert [motor.joint_resolution for motor in motors] == pytest.approx([1.534e-5, 3.068e-5])
    assert [joint.torque_limit for joint in arm.joints] == pytest.approx([0.94 * 8.925, 0.94 * 0.870])
    carried = arm.links[0].sections[1].mass + arm.links[1].mass + arm.payload.mass
    assert carried == pytest.approx(1.578, abs=5e-4)
    model = fm.build_model(arm, 1, flexible_links=False)
    inertia = fm.mass_matrix(model, np.zeros(4))
    strip = strips[0].mass * strips[0].length ** 2 / 3.0
    assert inertia[0, 0] - arm.joints[0].rotor_inertia - strip == pytest.approx(0.17043, rel=0.01)
    assert inertia[1, 1] - arm.joints[1].rotor_inertia == pytest.approx(
        0.00644 + strips[1].mass * 0.20185**2 / 3.0, rel=1e-3
    )


def test_one_stage_is_both_with_the_second_locked():
    one, both = fm.catalog.quanser_2dsfl(1), fm.catalog.quanser_2dsfl()
    expected = fm.frequencies(fm.build_model(both, 1, flexible_links=(True, False)), lock_joints=True)
    result = fm.frequencies(fm.build_model(one, 1), lock_joints=True)
    assert result[0] == pytest.approx(expected[0], rel=1e-6)  # in the plane; across it the strip has other inertia
    assert "1 to 2" in refusal(fm.catalog.quanser_2dsfl, 3)


def test_published_frequencies_are_those_of_the_catalog():
    rows = list(published_rows())
    assert len(rows) == 12
    assert [row.case for row in rows if row.verdict == "fail"] == []
    shown = [row for row in rows if row.tolerance is None]
    assert len(shown) == 1 and shown[0].error < 0.03

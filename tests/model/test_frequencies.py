"""Frequencies: those of beams, hubs, springs and of the paper's arm, against values from elsewhere."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings

import flexman_gym as fm

from oracles.chains import QUICK, samples, slender_link
from oracles.ritz import beam_eigenvalues


@pytest.mark.parametrize("ratio", [0.0, 0.1, 1.0])
def test_a_beam_on_a_free_hub_has_its_frequencies(ratio):
    link = slender_link(1.0, 1.0, 1.0)
    hub = fm.Joint((0.0, 0.0, 1.0), rotor_inertia=ratio)
    result = 2 * np.pi * fm.frequencies(fm.build_model(fm.Arm([link], [hub]), elements=32))
    assert result[0] == 0.0
    expected = beam_eigenvalues(3, hub_inertia_ratio=ratio)
    assert result[1:4] == pytest.approx(expected, rel=2e-5)  # (b h)^4 / 1440: 7e-6 at the third


@pytest.mark.parametrize(
    ("tip", "clamped", "expected"),
    [  # Hz, verification.md: closed form of this arm
        (0.0, False, (0.521729, 2.741455, 7.643182, 14.97638)),
        (0.0, True, (0.434903, 2.726788, 7.638233)),
        (2.0, False, (0.340285, 2.065477, 6.349101)),
        (2.0, True, (0.220297, 2.046225, 6.343135)),
    ],
)
def test_a_flexible_link_on_an_elastic_joint_has_its_frequencies(tip, clamped, expected):
    joint = fm.Joint((0.0, 0.0, 1.0), rotor_inertia=1.0, stiffness=100.0)
    model = fm.build_model(fm.Arm([slender_link()], [joint], fm.Payload(tip)), elements=32)
    result = fm.frequencies(model, lock_joints=clamped)
    assert result[0 if clamped else 1 :][: len(expected)] == pytest.approx(expected, rel=2e-5)


@settings(QUICK)
@given(samples(most_links=1, flexible_links=False, flexible_joints=True))
def test_two_masses_and_a_spring_have_their_frequency(sample):
    """Spong, Modeling and control of elastic joint robots, 1987."""
    joint, model = sample.arm.joints[0], sample.model
    link = fm.mass_matrix(model, np.zeros(4))[0, 0]
    free = np.sqrt(joint.stiffness * (1 / joint.rotor_inertia + 1 / link)) / (2 * np.pi)
    assert fm.frequencies(model) == pytest.approx([0.0, free])
    locked = np.sqrt(joint.stiffness / link) / (2 * np.pi)
    assert fm.frequencies(model, lock_joints=True) == pytest.approx([locked])
    rigid = fm.build_model(sample.arm, flexible_links=False, flexible_joints=False)
    assert fm.mass_matrix(rigid, np.zeros(2))[0, 0] == pytest.approx(link + joint.rotor_inertia)


def test_stiff_joints_approach_rigid_ones_as_one_over_stiffness():
    angles = (0.0, 0.3, -0.5)
    rigid = fm.frequencies(fm.build_model(fm.catalog.paper_rrr(joint_stiffness=None)), angles)[3:8]
    gap = []
    for stiffness in (1e8, 1e9):
        result = fm.frequencies(fm.build_model(fm.catalog.paper_rrr(joint_stiffness=stiffness)), angles)[3:8]
        gap.append(np.abs(result / rigid - 1).max())
    assert gap[0] < 1e-2
    assert gap[0] / gap[1] == pytest.approx(10.0, rel=0.1)


def test_the_paper_arm_has_its_first_elastic_frequencies():
    """4.5 and 9.5 Hz (verification.md) for motors that are free and weigh nothing, so that their springs do nothing."""
    result = fm.frequencies(fm.build_model(fm.catalog.paper_rrr(rotor_inertia=0.0, joint_stiffness=None)))
    assert (result[:3] == 0.0).all()
    assert np.round(result[3:5], 1).tolist() == [4.5, 9.5]


@settings(QUICK, max_examples=15)
@given(samples(most_links=3))
def test_frequencies_are_those_of_the_dense_mass_matrix_and_stiffness(sample):
    """The eigenvalues of differences of the accelerations about rest are minus the squares of the frequencies."""
    sample = replace(sample, arm=replace(sample.arm, gravity=(0.0, 0.0, 0.0)))
    angles = sample.state()[0][: sample.model.n_joints]
    rest = sample.model.initial_state(angles)
    d, torque = sample.model.n_dof, np.zeros(sample.model.n_joints)
    mass = sample.chain.mass_matrix(rest[:d])
    scale = np.sqrt(np.diag(mass))
    h = 1e-6
    columns = [sample.chain.acceleration(rest[:d] + h * u, rest[d:], torque) / h for u in np.eye(d)]
    flexibility = -scale[:, None] * np.transpose(columns) / scale
    squares = np.sort(np.linalg.eigvals(flexibility).real)[sample.model.n_joints :]
    expected = np.sqrt(np.maximum(squares, 0.0)) / (2 * np.pi)
    result = fm.frequencies(sample.model, angles)
    assert (result[: sample.model.n_joints] == 0.0).all() and (np.diff(result) >= 0.0).all()
    assert np.allclose(result[sample.model.n_joints :], expected, rtol=1e-4, atol=1e-5 * expected.max(initial=0.0))


# Bad input


@pytest.mark.parametrize("lock_joints", [False, True])
def test_many_postures_have_the_frequencies_of_each(lock_joints):
    model = fm.build_model(fm.catalog.paper_rrr(), elements=1)
    postures = np.random.default_rng(0).uniform(-1.0, 1.0, (3, 3))
    expected = [fm.frequencies(model, posture, lock_joints) for posture in postures]
    assert np.array_equal(fm.frequencies(model, postures, lock_joints), expected)
    with pytest.raises(ValueError, match=r"^joint_angles: .*; give numbers \(3,\) or \(k, 3\), rad$"):
        fm.frequencies(model, postures[:, :2], lock_joints)
